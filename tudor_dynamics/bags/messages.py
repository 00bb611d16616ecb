# Copyright 2026 tudor_dynamics contributors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Messages as arrays: bulk decoding of CDR, checked against the definitions that a bag carries.

The format is plain CDR (XCDR1) as in the OMG DDS-RTPS specification: alignment counts from the end
of the encapsulation header of four bytes. Messages of one topic nearly always share one layout:
the same names, the same fields, the same frame, hence every number at the same place. The layout
is parsed once, all messages that agree with it in every structural byte are laid over each other,
and their numbers are viewed as columns. A bag with several layouts is decoded group by group.
rosbags, message by message, takes five to ten times as long (bench/read_bags.py).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field as dataclass_field, replace
from functools import partial
import re
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.storage import Bag, RawMessages
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray, Shown

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH_STAMPED = 'geometry_msgs/msg/WrenchStamped'
IMU = 'sensor_msgs/msg/Imu'
FLOAT64_MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
DYNAMIC_JOINT_STATE = 'control_msgs/msg/DynamicJointState'

HEADER = 4  # bytes of the encapsulation header
MAX_PADDING = 3  # bytes that a middleware may append to fill up to four
FIELDS = ('position', 'velocity', 'effort')
POINT_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')
MAX_NAMES = 1000  # names in a message; a hundred joints are described at most


class CdrError(ValueError):
    """A buffer that is not a message of the type expected."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Where everything stands in messages of one shape."""

    order: str  # byte order of the numbers
    frame_id: str  # of the header
    names: tuple[str, ...]  # of a JointState; empty for other types
    fields: dict[str, tuple[int, int]]  # offset and number of float64 values of each array
    significant: NDArray[np.uint8]  # (bytes,): 255 where a byte is structure, 0 for numbers
    stamped: bool = True  # whether the messages have a header with a stamp
    # Of fields whose values stand apart: offset of that of each name; None where it lacks one.
    scattered: Mapping[str, Sequence[int | None]] = dataclass_field(default_factory=dict)

    def size(self, name: str) -> int:
        """Give the number of values in a field; none of a field that such messages lack."""
        return self.fields.get(name, (0, 0))[1]

    def numbers(self, rows: NDArray[np.uint8], start: int, count: int) -> FloatArray:
        """View float64 values of messages of this shape: rows (n, bytes)."""
        return rows[:, start:start + 8 * count].view(self.order + 'f8')

    def times(self, rows: NDArray[np.uint8]) -> NDArray[np.int32]:
        """View the stamps of messages of this shape (n, 2) [s, ns]: rows (n, bytes)."""
        return rows[:, HEADER:HEADER + 8].view(self.order + 'i4')


class Cursor:
    """Walks one buffer, checks every bound, and marks the structural bytes."""

    def __init__(self, buffer: bytes) -> None:
        if len(buffer) < HEADER or bytes(buffer[:2]) not in (b'\x00\x00', b'\x00\x01'):
            raise CdrError(f'begins with {bytes(buffer[:4])!r}, not with the header of plain CDR')
        self.buffer = buffer
        self.order = '<' if buffer[1] else '>'
        self.position = HEADER
        self.significant = np.zeros(len(buffer), dtype=np.uint8)
        self.significant[:2] = 255
        self._u32 = struct.Struct(self.order + 'I')

    def skip(self, size: int, alignment: int) -> int:
        """Skip numbers; return where they begin."""
        start = self.position + (HEADER - self.position) % alignment
        if start + size > len(self.buffer):
            raise CdrError(f'is cut off: {len(self.buffer)} bytes, needs {start + size} or more')
        self.position = start + size
        return start

    def count(self) -> int:
        """Read a structural number."""
        start = self.skip(4, 4)
        self.significant[start:start + 4] = 255
        return int(self._u32.unpack_from(self.buffer, start)[0])

    def header(self) -> str:
        """Read a Header: skip its stamp, return its frame."""
        self.skip(8, 4)
        return self.text()

    def text(self) -> str:
        """Read a string, which must end with a NUL."""
        size = self.count()
        start = self.skip(size, 1)
        self.significant[start:start + size] = 255
        raw = bytes(self.buffer[start:start + size])
        if not raw.endswith(b'\x00'):
            raise CdrError(f'the string at byte {start} does not end with a zero byte')
        try:
            return raw[:-1].decode()
        except UnicodeDecodeError:
            raise CdrError(f'the string at byte {start} is not UTF-8') from None

    def names(self) -> tuple[str, ...]:
        """Read a sequence of strings."""
        count = self.count()
        if count > min(len(self.buffer) // 5, MAX_NAMES):  # a string takes five bytes at least
            raise CdrError(f'claims {count} names; its {len(self.buffer)} bytes can hold '
                           f'{len(self.buffer) // 5}, and the limit is {MAX_NAMES}')
        return tuple(self.text() for _ in range(count))

    def doubles(self) -> tuple[int, int]:
        """Read the length of a sequence of float64 and skip it; offset and length."""
        size = self.count()
        if size == 0:
            return self.position, 0
        return self.skip(8 * size, 8), size

    def finish(
        self, frame_id: str, names: tuple[str, ...], fields: dict[str, tuple[int, int]],
        spare: int = MAX_PADDING, *, stamped: bool = True,
        scattered: Mapping[str, Sequence[int | None]] | None = None,
    ) -> Layout:
        """Check that nothing is left, and make the layout."""
        left = len(self.buffer) - self.position
        if left > spare:
            raise CdrError(f'has {left} bytes after its end, expected at most {spare}')
        return Layout(self.order, frame_id, names, fields, self.significant, stamped,
                      scattered or {})


def joint_state_layout(buffer: bytes, spare: int = MAX_PADDING) -> Layout:
    """Parse the structure of a JointState."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    names = cursor.names()
    fields = {field: cursor.doubles() for field in FIELDS}
    return cursor.finish(frame_id, names, fields, spare)


FIXED: Mapping[str, tuple[tuple[str, int], ...]] = {
    WRENCH_STAMPED: (('force', 3), ('torque', 3)),
    IMU: (('orientation', 4), ('', 9), ('angular_velocity', 3), ('', 9),
          ('linear_acceleration', 3), ('', 9))}
"""What follows the header of messages without arrays; covariances have no name, and no place."""


def fixed_layout(buffer: bytes, parts: Sequence[tuple[str, int]]) -> Layout:
    """Parse the structure of a message of some fields and their sizes."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    places = [(field, (cursor.skip(8 * size, 8), size)) for field, size in parts]
    return cursor.finish(frame_id, (), {field: place for field, place in places if field})


def motion_layout(buffer: bytes, spare: int = MAX_PADDING) -> Layout:
    """Parse the structure of a JointTrajectory of exactly one point."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    names = cursor.names()
    points = cursor.count()
    if points != 1:
        raise CdrError(f'has {points} points, expected 1')
    fields = {field: cursor.doubles() for field in POINT_FIELDS}
    fields['time_from_start'] = (cursor.skip(8, 4), 0)
    return cursor.finish(frame_id, names, fields, spare)


DATA = 'data'  # name of the only field of a Float64MultiArray


def array_layout(buffer: bytes, spare: int = MAX_PADDING) -> Layout:
    """Parse the structure of a Float64MultiArray."""
    cursor = Cursor(buffer)
    dimensions = cursor.count()
    if dimensions > min(len(buffer) // 12, MAX_NAMES):  # label, size and stride take twelve bytes
        raise CdrError(f'claims {dimensions} dimensions; its {len(buffer)} bytes can hold '
                       f'{len(buffer) // 12}, and the limit is {MAX_NAMES}')
    for _ in range(dimensions):
        cursor.text()
        cursor.count()
        cursor.count()
    cursor.count()  # data_offset
    place = cursor.doubles()
    if place[1] > MAX_NAMES:
        raise CdrError(f'has {place[1]} values in data, more than the limit of {MAX_NAMES}')
    names = tuple(map(str, range(place[1])))
    return cursor.finish('', names, {DATA: place}, spare, stamped=False)


def dynamic_layout(buffer: bytes) -> Layout:
    """Parse the structure of a DynamicJointState."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    joints = cursor.names()
    count = cursor.count()
    if count != len(joints):
        raise CdrError(f'has {count} interface_values for {len(joints)} joint_names')
    scattered: dict[str, list[int | None]] = {}
    for number, joint in enumerate(joints):
        interfaces = cursor.names()
        start, size = cursor.doubles()
        if size != len(interfaces):
            raise CdrError(f'{joint!r} has {size} values, but {len(interfaces)} interfaces')
        for column, interface in enumerate(interfaces):
            where = scattered.setdefault(interface, [None] * len(joints))
            if where[number] is not None:
                raise CdrError(f'joint {joint!r} has the interface {interface!r} twice')
            where[number] = start + 8 * column
        if len(scattered) > MAX_NAMES:
            raise CdrError(f'has more than {MAX_NAMES} different interfaces')
    fields = {interface: (HEADER, len(joints)) for interface in scattered}
    return cursor.finish(frame_id, joints, fields, scattered=scattered)


MAX_LAYOUTS = 256
"""Layouts in one topic; more are no recording of one arm, but would take for ever."""


@dataclass(frozen=True, eq=False)
class MessageBatch:
    """Messages of one layout."""

    index: NDArray[np.intp]  # their places among the messages of the topic, increasing, (n,)
    layout: Layout  # what they share
    rows: NDArray[np.uint8]  # their bytes, (n, bytes)

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Header stamps, zero where the messages have none [ns]."""
        if not self.layout.stamped:
            return np.zeros(len(self.index), dtype=np.int64)
        seconds, rest = self.layout.times(self.rows).astype(np.int64).T
        return seconds * 1_000_000_000 + rest % 2**32  # which has no sign in the message

    def values(self, field: str) -> FloatArray:
        """Give the values of a field; returns (n, length of the field)."""
        numbers = self.layout.numbers
        if field in self.layout.scattered:
            values = np.full((len(self.index), len(self.layout.names)), np.nan)
            for column, start in enumerate(self.layout.scattered[field]):
                if start is not None:
                    values[:, [column]] = numbers(self.rows, start, 1)
            return values
        place = self.layout.fields.get(field, (0, 0))
        return np.ascontiguousarray(numbers(self.rows, *place), dtype=np.float64)


def decode(
    messages: Sequence[bytes], parse: Callable[[bytes], Layout], topic: str,
) -> list[MessageBatch]:
    """Decode the messages of a topic."""
    lengths = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    blocks: list[MessageBatch] = []
    for length in np.unique(lengths).tolist():
        index = np.flatnonzero(lengths == length)
        chosen = messages if len(index) == len(messages) else [messages[i] for i in index.tolist()]
        rows = np.frombuffer(b''.join(chosen), dtype=np.uint8).reshape(len(index), length)
        while len(index):
            try:
                layout = parse(messages[int(index[0])])
            except CdrError as err:
                raise BagError(f'message {index[0] + 1} of {len(messages)} on {topic} {err}; '
                               'correct the publisher, or record a damaged bag again') from None
            if len(blocks) == MAX_LAYOUTS:
                raise BagError(f'names, fields or frame_id of messages on {topic} vary in more '
                               f'than {MAX_LAYOUTS} ways; record one arm on one topic')
            # which agree with the first one in every structural byte
            word: Any = np.uint32 if length % 4 == 0 else np.uint8
            words, mask = rows.view(word), layout.significant.view(word)
            places = np.flatnonzero(mask)
            same = ~np.any((words[:, places] ^ words[0, places]) & mask[places], axis=1)
            blocks.append(MessageBatch(index[same], layout, rows if same.all() else rows[same]))
            index, rows = index[~same], rows[~same]
    return sorted(blocks, key=lambda block: int(block.index[0]))


# Types change between releases under the same name. A bag of MCAP or sqlite3 carries the
# definition that its messages were written by; where it differs from what the numbers are read by
# here, nothing is read.

Fields = tuple[tuple[str, str], ...]

EXPECTED: Mapping[str, Mapping[str, Fields]] = {
    FLOAT64_MULTI_ARRAY: {
        '': (('MultiArrayLayout', 'layout'), ('float64[]', 'data')),
        'MultiArrayLayout': (('MultiArrayDimension[]', 'dim'), ('uint32', 'data_offset')),
        'MultiArrayDimension': (('string', 'label'), ('uint32', 'size'), ('uint32', 'stride'))},
    DYNAMIC_JOINT_STATE: {
        '': (('Header', 'header'), ('string[]', 'joint_names'),
             ('InterfaceValue[]', 'interface_values')),
        'InterfaceValue': (('string[]', 'interface_names'), ('float64[]', 'values'))},
}
"""
Types to their parts (by their short names, the message itself has none) to types and names.

std_msgs and control_msgs as they are in ROS 2 Jazzy.
"""
SECTION = re.compile(r'^=+$', re.MULTILINE)


def parts_of(definition: str) -> dict[str, Fields]:
    """Split a message definition into its parts."""
    found: dict[str, Fields] = {}
    for number, section in enumerate(SECTION.split(definition)):
        lines = [line.partition('#')[0].split() for line in section.splitlines()]
        lines = [words for words in lines if words]
        name = ''
        if number:
            if not lines or lines[0][0] != 'MSG:' or len(lines[0]) != 2:
                continue
            name = lines.pop(0)[1].rpartition('/')[2]
        found[name] = tuple((words[0].rpartition('/')[2], words[1]) for words in lines
                            if len(words) > 1 and '=' not in ''.join(words[1:]))
    return found


def check_definition(msgtype: str, definition: str, topic: str, path: str) -> None:
    """Refuse messages of a definition that is not the one they are read by."""
    found = parts_of(definition)
    for part, fields in EXPECTED[msgtype].items():
        if found.get(part) != fields:
            what = msgtype if not part else f'{part} in {msgtype}'
            shown = ', '.join(' '.join(field) for field in found.get(part, ())) or 'nothing'
            msg = (f'topic {topic}: the definition of {what} in the bag is ({shown[:200]}), '
                   f'expected ({", ".join(" ".join(field) for field in fields)}); record it with '
                   'the messages of ROS 2 Jazzy')
            raise BagError(msg, place=path)


# Those of an array are named by their places.
NAMED = (JOINT_STATE, FLOAT64_MULTI_ARRAY, DYNAMIC_JOINT_STATE)
"""Types of messages with named values."""
LAYOUTS: Mapping[str, Callable[[bytes], Layout]] = {
    JOINT_STATE: joint_state_layout, FLOAT64_MULTI_ARRAY: array_layout,
    DYNAMIC_JOINT_STATE: dynamic_layout,
    **{msgtype: partial(fixed_layout, parts=parts) for msgtype, parts in FIXED.items()}}


@dataclass(frozen=True, eq=False, repr=False)
class Signals(Shown):
    """
    Signals over time of one topic: what its messages hold, or are to hold.

    Fields are those of the messages: ``position``, ``velocity`` and ``effort`` of a JointState,
    ``force`` and ``torque`` of a WrenchStamped [N, N m], ``orientation`` (x, y, z, w),
    ``angular_velocity`` and ``linear_acceleration`` of an Imu [rad/s, m/s^2].
    """

    topic: str  # full name, e.g. `/joint_states`
    stamp: NDArray[np.int64]  # header stamps, (n,) [ns]
    values: Mapping[str, FloatArray]  # by field, (n, columns); what is missing stays empty
    names: Sequence[str] = ()  # of the columns, where messages have names
    frame: str | NDArray[np.object_] = ''  # of all messages, or of each (n,)
    msgtype: str = JOINT_STATE  # type of the messages

    @property
    def what(self) -> str:
        """Field and topic for people, e.g. `effort in /motor_currents`."""
        return f'{", ".join(self.values)} in {self.topic}'

    def at(self, rows: NDArray) -> Signals:
        """Give the signals at a selection of their samples."""
        return replace(
            self, stamp=self.stamp[rows],
            values={field: values[rows] for field, values in self.values.items()},
            frame=self.frame if isinstance(self.frame, str) else self.frame[rows])


def joint_signals(
    topic: str, stamp: NDArray[np.int64], names: Sequence[str], position: FloatArray | None = None,
    velocity: FloatArray | None = None, effort: FloatArray | None = None,
) -> Signals:
    """
    Give what JointStates are to hold, for ``write_bag``.

    Parameters
    ----------
    topic : str
        Absolute name of the topic.
    stamp : ndarray of int64, shape (n_samples,)
        Header stamps [ns].
    names : sequence of str
        Joints or gauges, in the order of the columns.
    position, velocity, effort : ndarray of shape (n_samples, n_names), optional
        Values in SI, or in the units of the arm description; a field that is None stays empty.

    """
    columns = zip(FIELDS, (position, velocity, effort), strict=True)
    return Signals(topic, stamp, {field: values for field, values in columns
                                  if values is not None}, names)


@dataclass(frozen=True, eq=False)
class DecodedTopic:
    """All messages of a topic."""

    topic: str  # name of the topic
    # When each was recorded, and its header stamp, zero where it has none, (n,) [ns].
    log_time: NDArray[np.int64]
    stamp: NDArray[np.int64]
    blocks: list[MessageBatch]  # messages by layout
    msgtype: str  # type of the messages
    stamped: bool  # whether messages of this type have a stamp

    def having(self, field: str) -> Iterator[MessageBatch]:
        """Go through the messages that have values of a field."""
        return (block for block in self.blocks if block.layout.size(field))

    def select(
        self, names: Sequence[str], field: str, path: str,
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Take values of names: places of the messages that have them (n,), values (n, names)."""
        for block in self.blocks:
            self._check_lengths(block, names, path)
        chosen = [block for block in self.having(field) if set(names) <= set(block.layout.names)]
        if not chosen:
            return np.empty(0, np.intp), np.empty((0, len(names)))
        index = np.concatenate([block.index for block in chosen])
        values = np.concatenate([
            block.values(field)[:, [block.layout.names.index(name) for name in names]]
            for block in chosen])
        if len(chosen) > 1:
            order = np.argsort(index)
            index, values = index[order], values[order]
        return index, values

    def signals(self) -> Signals:
        """Give all messages of a type whose fields are always there, such as WrenchStamped."""
        fields = self.blocks[0].layout.fields
        values = {field: np.empty((len(self.stamp), size)) for field, (_, size) in fields.items()}
        frames = np.empty(len(self.stamp), dtype=object)
        for block in self.blocks:
            for field, column in values.items():
                column[block.index] = block.values(field)
            frames[block.index] = block.layout.frame_id
        return Signals(self.topic, self.stamp, values, (), frames, self.msgtype)

    def _check_lengths(self, block: MessageBatch, names: Sequence[str], path: str) -> None:
        """Refuse messages whose arrays do not go with their names."""
        layout = block.layout
        if not set(names) & set(layout.names):
            return
        where = f'message {block.index[0] + 1} on {self.topic}'
        for field, (_, size) in layout.fields.items():
            if size not in (0, len(layout.names)):
                raise BagError(f'{where} has {size} values in {field}, but {len(layout.names)} '
                               'names; correct the publisher, so that each array is empty or as '
                               'long as name, and record again', place=path)
        for name in names:
            if layout.names.count(name) > 1:
                raise BagError(f'{where} has the name {name!r} {layout.names.count(name)} times; '
                               'correct the publisher, and record again', place=path)

    def ranges(self, besides: Collection[str]) -> dict[str, float]:
        """Say how far joints move besides some [rad or m], outermost percents excluded."""
        found: dict[str, float] = {}
        for block in self.having('position'):
            values = block.values('position')
            for i, name in enumerate(block.layout.names[:values.shape[1]]):
                column = values[:, i][np.isfinite(values[:, i])]
                if name not in besides and len(column):
                    low, high = np.percentile(column, [1.0, 99.0])
                    found[name] = max(found.get(name, 0.0), float(high - low))
        return found


def decode_topic(raw: RawMessages, path: str) -> DecodedTopic:
    """Decode a topic."""
    layout = LAYOUTS.get(raw.msgtype)
    if layout is None:
        raise BagError(f'{path}: topic {raw.topic} is of type {raw.msgtype}, not {JOINT_STATE}; '
                       'correct joint_topic, effort.topic or gauges[].topic in the description')
    try:
        blocks = decode(raw.data, layout, raw.topic)
    except BagError as err:
        raise err.at(path) from None
    stamp = np.zeros(len(raw.data), dtype=np.int64)
    for block in blocks:
        stamp[block.index] = block.stamp
    return DecodedTopic(
        raw.topic, raw.log_time, stamp, blocks, raw.msgtype,
        raw.msgtype != FLOAT64_MULTI_ARRAY)


def load_topics(bag: Bag, topics: Collection[str]) -> dict[str, DecodedTopic]:
    """Read and decode topics of a bag."""
    for name in topics:
        msgtype = bag.topics[name].msgtype if name in bag.topics else ''
        if msgtype in EXPECTED:
            for text in bag.definitions(msgtype):
                check_definition(msgtype, text, name, str(bag.path))
    return {name: decode_topic(raw, str(bag.path)) for name, raw in bag.read(topics).items()}
