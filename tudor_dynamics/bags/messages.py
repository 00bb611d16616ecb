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

"""Messages as bytes: bulk decoding and encoding of CDR, checked against their definitions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field as dataclass_field
import re
import struct
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray


# -- Where things stand in CDR messages: JointState, WrenchStamped, Imu, JointTrajectory of one
#    point.
#
# The format is plain CDR (XCDR1) as in the OMG DDS-RTPS specification: alignment counts from
# behind the encapsulation header of four bytes.

JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH_STAMPED = 'geometry_msgs/msg/WrenchStamped'
IMU = 'sensor_msgs/msg/Imu'

HEADER = 4
"""Bytes of the encapsulation header."""
MAX_PADDING = 3
"""Bytes that a middleware may append to fill up to four."""
FIELDS = ('position', 'velocity', 'effort')
POINT_FIELDS = ('positions', 'velocities', 'accelerations', 'effort')
MAX_NAMES = 1000
"""Names in a message; a hundred joints are described at most."""


class CdrError(ValueError):
    """A buffer that is not a message of the type expected."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Where everything stands in messages of one shape."""

    length: int  # bytes of a message
    order: str  # byte order of the numbers
    frame_id: str  # of the header
    names: tuple[str, ...]  # of a JointState; empty for other types
    fields: dict[str, tuple[int, int]]  # offset and number of float64 values of each array
    dtype: np.dtype[Any]  # structured type: `sec`, `nanosec` and the fields that are not empty
    # (length,): 255 where a byte belongs to the structure, 0 where it is a number or padding.
    significant: NDArray[np.uint8]
    stamped: bool = True  # whether the messages have a header with a stamp
    # Of fields whose values stand apart: for each name the part of the structured type and the
    # place in it; None where the name lacks the field.
    scattered: Mapping[str, tuple[tuple[str, int] | None, ...]] = dataclass_field(
        default_factory=dict)

    def size(self, name: str) -> int:
        """Give the number of values in a field; none of a field that such messages lack."""
        return self.fields.get(name, (0, 0))[1]


class Cursor:
    """Walks one buffer, checks every bound, and marks the structural bytes."""

    def __init__(self, buffer: bytes) -> None:
        if len(buffer) < HEADER or bytes(buffer[:2]) not in (b'\x00\x00', b'\x00\x01'):
            raise CdrError('no plain CDR encapsulation')
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
            raise CdrError(f'ends within byte {start} + {size}, has {len(self.buffer)} bytes')
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
            raise CdrError(f'string at byte {start} has no terminator')
        try:
            return raw[:-1].decode()
        except UnicodeDecodeError:
            raise CdrError(f'string at byte {start} is no UTF-8') from None

    def names(self) -> tuple[str, ...]:
        """Read a sequence of strings."""
        count = self.count()
        if count > min(len(self.buffer) // 5, MAX_NAMES):  # a string takes five bytes at least
            raise CdrError(f'announces {count} names in {len(self.buffer)} bytes; at most '
                           f'{MAX_NAMES} are read')
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
        scattered: Mapping[str, tuple[tuple[str, int] | None, ...]] | None = None,
    ) -> Layout:
        """Check that nothing is left, and make the layout."""
        left = len(self.buffer) - self.position
        if left > spare:
            raise CdrError(f'has {left} bytes too many')
        present = {name: place for name, place in fields.items() if place[1]}
        parts: list[tuple[str, Any, int]] = [] if not stamped else [
            ('sec', self.order + 'i4', HEADER), ('nanosec', self.order + 'u4', HEADER + 4)]
        parts += [(name, (self.order + 'f8', (size,)), start)
                  for name, (start, size) in present.items()]
        dtype = np.dtype({
            'names': [name for name, _, _ in parts], 'formats': [kind for _, kind, _ in parts],
            'offsets': [start for _, _, start in parts], 'itemsize': len(self.buffer)})
        if scattered is not None:
            fields = {name: (HEADER, len(names)) for name in scattered}
        return Layout(len(self.buffer), self.order, frame_id, names, fields, dtype,
                      self.significant, stamped, scattered or {})


def joint_state_layout(buffer: bytes, spare: int = MAX_PADDING) -> Layout:
    """Parse the structure of a JointState."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    names = cursor.names()
    fields = {field: cursor.doubles() for field in FIELDS}
    return cursor.finish(frame_id, names, fields, spare)


def wrench_layout(buffer: bytes) -> Layout:
    """
    Parse the structure of a WrenchStamped.

    Returns place of ``wrench``: force [N] and torque [N m].
    """
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    return cursor.finish(frame_id, (), {'wrench': (cursor.skip(48, 8), 6)})


def imu_layout(buffer: bytes) -> Layout:
    """
    Parse the structure of an Imu.

    Returns places of ``orientation`` (x, y, z, w), ``angular_velocity`` [rad/s] and
    ``linear_acceleration`` [m/s^2]; of their covariances, which lie between, none.
    """
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    fields = {}
    for field, size in (('orientation', 4), ('angular_velocity', 3), ('linear_acceleration', 3)):
        fields[field] = cursor.skip(8 * size, 8), size
        cursor.skip(8 * 9, 8)
    return cursor.finish(frame_id, (), fields)


def motion_layout(buffer: bytes, spare: int = MAX_PADDING) -> Layout:
    """Parse the structure of a JointTrajectory of exactly one point."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    names = cursor.names()
    points = cursor.count()
    if points != 1:
        raise CdrError(f'has {points} points')
    fields = {field: cursor.doubles() for field in POINT_FIELDS}
    fields['time_from_start'] = (cursor.skip(8, 4), 0)
    return cursor.finish(frame_id, names, fields, spare)


# -- Bulk decoding of CDR messages as arrays: JointState, WrenchStamped, arrays and interfaces.
#
# Messages of one topic nearly always share one layout: the same names, the same fields, the same
# frame, hence every number at the same place. The layout is parsed once, all messages that agree
# with it in every structural byte are laid over each other, and their numbers are read as columns
# of a structured array. A bag with several layouts is decoded group by group.

MAX_LAYOUTS = 256
"""Layouts in one topic; more are no recording of one arm, but would take for ever."""


@dataclass(frozen=True, eq=False)
class MessageBatch:
    """Messages of one layout."""

    index: NDArray[np.intp]  # their places among the messages of the topic, increasing, (n,)
    layout: Layout  # what they share
    records: NDArray[np.void]  # their numbers, one record a message, (n,)

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Header stamps, zero where the messages have none [ns]."""
        if not self.layout.stamped:
            return np.zeros(len(self.index), dtype=np.int64)
        seconds = self.records['sec'].astype(np.int64)
        return seconds * 1_000_000_000 + self.records['nanosec'].astype(np.int64)

    def values(self, field: str) -> FloatArray:
        """Give the values of a field; returns (n, length of the field)."""
        if self.layout.size(field) == 0:
            return np.empty((len(self.index), 0))
        if field in self.layout.scattered:
            values = np.full((len(self.index), len(self.layout.names)), np.nan)
            for column, place in enumerate(self.layout.scattered[field]):
                if place is not None:
                    values[:, column] = self.records[place[0]][:, place[1]]
            return values
        return np.ascontiguousarray(self.records[field], dtype=np.float64)


def _same_layout(rows: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    """Say which rows agree with the first one in every structural byte."""
    word: Any = np.uint32 if layout.length % 4 == 0 else np.uint8
    words = rows.view(word)
    mask = layout.significant.view(word)
    same = np.ones(len(rows), dtype=bool)
    places = np.flatnonzero(mask)
    for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1):
        part = slice(int(run[0]), int(run[-1]) + 1)
        same &= ~np.any((words[:, part] ^ words[0, part]) & mask[part], axis=1)
    return same


def decode(
    messages: Sequence[bytes],
    parse: Callable[[bytes], Layout],
    topic: str,
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
                msg = (f'topic {topic}, message {index[0]}: {err}; the bag is damaged or '
                       'announces the wrong type')
                raise BagError(msg) from None
            if len(blocks) == MAX_LAYOUTS:
                msg = (f'topic {topic}: names, fields or frames change more than {MAX_LAYOUTS} '
                       'times; record the joints of one arm on one topic')
                raise BagError(msg)
            same = _same_layout(rows, layout)
            group = rows if same.all() else rows[same]
            blocks.append(MessageBatch(index[same], layout, group.view(layout.dtype).reshape(-1)))
            index, rows = index[~same], rows[~same]
    return sorted(blocks, key=lambda block: int(block.index[0]))


# -- Bulk encoding of JointState, WrenchStamped and Imu: the inverse of ``cdr``.
#
# All messages of a series have one layout. One template is put together by hand, its numbers are
# found by the parser that also reads bags, and the columns are written over copies of it.

LITTLE_ENDIAN = b'\x00\x01\x00\x00'


@dataclass(frozen=True, eq=False)
class JointStateSeries:
    """Messages of one JointState topic."""

    # Full name, e.g. `/joint_states`.
    topic: str
    stamp: NDArray[np.int64]  # header stamps, (n,) [ns]
    names: Sequence[str]  # joints, or gauges
    # (n, names): values; a field that is None stays empty.
    position: FloatArray | None = None
    velocity: FloatArray | None = None
    effort: FloatArray | None = None
    frame_id: str = ''  # of the header
    msgtype: str = JOINT_STATE  # type of the messages

    def encode(self) -> list[bytes]:
        """Encode the messages."""
        buffer = _header(self.frame_id)
        _put(buffer, 4, struct.pack('<I', len(self.names)))
        for name in self.names:
            _put_text(buffer, name)
        columns: dict[str, FloatArray] = {}
        for field in FIELDS:
            values = getattr(self, field)
            size = 0 if values is None else len(self.names)
            _put(buffer, 4, struct.pack('<I', size))
            if size:
                _put(buffer, 8, bytes(8 * size))
                columns[field] = values
        layout = joint_state_layout(bytes(buffer))
        return _fill(bytes(buffer), layout, self.topic, self.stamp, columns)


@dataclass(frozen=True, eq=False)
class WrenchSeries:
    """Messages of one WrenchStamped topic."""

    # Full name, e.g. `/applied_wrench`.
    topic: str
    stamp: NDArray[np.int64]  # header stamps, (n,) [ns]
    # Components in the frame, (n, 3) [N, N m].
    force: FloatArray
    torque: FloatArray
    frame_id: str | Sequence[str] = ''  # frame, of all messages or of each
    msgtype: str = WRENCH_STAMPED  # type of the messages

    def encode(self) -> list[bytes]:
        """Encode the messages."""
        if isinstance(self.frame_id, str):
            return self._encode(self.frame_id, slice(None))
        frames = np.asarray(self.frame_id)
        result = [b''] * len(self.stamp)
        for frame in np.unique(frames):
            rows = np.flatnonzero(frames == frame)
            for row, message in zip(rows, self._encode(str(frame), rows), strict=True):
                result[row] = message
        return result

    def _encode(self, frame: str, rows: slice | NDArray[np.intp]) -> list[bytes]:
        buffer = _header(frame)
        _put(buffer, 8, bytes(48))
        layout = wrench_layout(bytes(buffer))
        columns = {'wrench': np.hstack([self.force[rows], self.torque[rows]])}
        return _fill(bytes(buffer), layout, self.topic, self.stamp[rows], columns)


@dataclass(frozen=True, eq=False)
class ImuSeries:
    """Messages of one Imu topic, their covariances unknown (zero)."""

    # Full name, e.g. `/imu/tip`.
    topic: str
    stamp: NDArray[np.int64]  # header stamps, (n,) [ns]
    orientation: FloatArray  # of the sensor in the base frame, quaternion x, y, z, w, (n, 4)
    # In the axes of the sensor; at rest the acceleration points upwards, (n, 3) [rad/s, m/s^2].
    angular_velocity: FloatArray
    linear_acceleration: FloatArray
    frame_id: str = ''  # frame of the sensor
    msgtype: str = IMU  # type of the messages, `sensor_msgs/msg/Imu`

    def encode(self) -> list[bytes]:
        """Encode the messages."""
        buffer = _header(self.frame_id)
        _put(buffer, 8, bytes(8 * (4 + 9 + 3 + 9 + 3 + 9)))
        layout = imu_layout(bytes(buffer))
        columns = {field: getattr(self, field) for field in layout.fields}
        return _fill(bytes(buffer), layout, self.topic, self.stamp, columns)


class Series(Protocol):
    """Messages of one topic: what a bag is written of."""

    @property
    def topic(self) -> str:
        """Give its full name."""

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Give the stamp of each message [ns]."""

    @property
    def msgtype(self) -> str:
        """Give the type of its messages."""

    def encode(self) -> list[bytes]:
        """Encode them as CDR."""


def _put(buffer: bytearray, alignment: int, content: bytes) -> None:
    buffer.extend(bytes((HEADER - len(buffer)) % alignment))
    buffer.extend(content)


def _put_text(buffer: bytearray, text: str) -> None:
    raw = text.encode() + b'\x00'
    _put(buffer, 4, struct.pack('<I', len(raw)) + raw)


def _header(frame_id: str) -> bytearray:
    buffer = bytearray(LITTLE_ENDIAN + bytes(8))
    _put_text(buffer, frame_id)
    return buffer


def _fill(
    template: bytes,
    layout: Layout,
    topic: str,
    stamp: NDArray[np.int64],
    columns: dict[str, FloatArray],
) -> list[bytes]:
    stamp = np.asarray(stamp, dtype=np.int64)
    count, size = len(stamp), len(template)
    if count and not 0 <= int(stamp.min()) <= int(stamp.max()) < 2**31 * 10**9:
        msg = f'{topic}: a stamp is negative or beyond the year 2038, which ROS 2 cannot express'
        raise BagError(msg)
    rows = np.empty((count, size), dtype=np.uint8)
    rows[:] = np.frombuffer(template, dtype=np.uint8)
    records: Any = rows.view(layout.dtype).reshape(count)
    records['sec'], records['nanosec'] = np.divmod(stamp, 1_000_000_000)
    for field, values in columns.items():
        expected = (count, layout.fields[field][1])
        if np.shape(values) != expected:
            msg = f'{topic}: {field} has shape {np.shape(values)}, expected {expected}'
            raise BagError(msg)
        records[field] = values
    joined = rows.tobytes()
    return [joined[start:start + size] for start in range(0, len(joined), size)]


# -- Where things stand in Float64MultiArray and DynamicJointState.
#
# Neither says what it carries as a JointState does: an array has places, and a joint has
# interfaces. The arm description names place or interface.

FLOAT64_MULTI_ARRAY = 'std_msgs/msg/Float64MultiArray'
DYNAMIC_JOINT_STATE = 'control_msgs/msg/DynamicJointState'
DATA = 'data'
"""Name of the only field of a Float64MultiArray."""


def array_layout(buffer: bytes) -> Layout:
    """Parse the structure of a Float64MultiArray."""
    cursor = Cursor(buffer)
    dimensions = cursor.count()
    if dimensions > min(len(buffer) // 12, MAX_NAMES):  # label, size and stride take twelve bytes
        raise CdrError(f'announces {dimensions} dimensions in {len(buffer)} bytes; at most '
                       f'{MAX_NAMES} are read')
    for _ in range(dimensions):
        cursor.text()
        cursor.count()
        cursor.count()
    cursor.count()  # data_offset
    place = cursor.doubles()
    if place[1] > MAX_NAMES:
        raise CdrError(f'has {place[1]} values; at most {MAX_NAMES} are read')
    return cursor.finish('', tuple(map(str, range(place[1]))), {DATA: place}, stamped=False)


def dynamic_layout(buffer: bytes) -> Layout:
    """Parse the structure of a DynamicJointState."""
    cursor = Cursor(buffer)
    frame_id = cursor.header()
    joints = cursor.names()
    count = cursor.count()
    if count != len(joints):
        raise CdrError(f'has interfaces of {count} joints for {len(joints)} names')
    parts: dict[str, tuple[int, int]] = {}
    scattered: dict[str, list[tuple[str, int] | None]] = {}
    for number, joint in enumerate(joints):
        interfaces = cursor.names()
        place = cursor.doubles()
        if place[1] != len(interfaces):
            raise CdrError(f'{joint!r} has {place[1]} values for {len(interfaces)} interfaces')
        key = f'joint {number}'
        parts[key] = place
        for column, interface in enumerate(interfaces):
            where = scattered.setdefault(interface, [None] * len(joints))
            if where[number] is not None:
                raise CdrError(f'{joint!r} has the interface {interface!r} twice')
            where[number] = (key, column)
        if len(scattered) > MAX_NAMES:
            raise CdrError(f'has more than {MAX_NAMES} interfaces')
    return cursor.finish(frame_id, joints, parts,
                         scattered={name: tuple(of) for name, of in scattered.items()})


# -- Is a message what its type says? The definition that the bag carries is compared with ours.
#
# Types change between releases under the same name. A bag of MCAP or sqlite3 carries the
# definition that its messages were written by; where it says otherwise than what the numbers are
# read by here, nothing is read.

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
