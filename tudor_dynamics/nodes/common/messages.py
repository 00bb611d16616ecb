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

"""Between messages and arrays: by name, never by place; errors are counted."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
import struct
import time
from typing import Any, Generic, TypeVar

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, WrenchStamped
import numpy as np
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tudor_dynamics.bags.messages import (
    array_layout, CdrError, DATA, HEADER, joint_state_layout, Layout, MAX_PADDING, motion_layout)
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.compiled import all_finite
from tudor_dynamics.nodes.settings import SUBSCRIPTIONS_LOOK
from tudor_dynamics.online.contact import ContactEstimate
from tudor_dynamics.online.settings import CLOCK_JUMP
from tudor_dynamics.online.streams import Losses, Motion
from tudor_dynamics.typing import FloatArray
from visualization_msgs.msg import Marker


def nanoseconds(stamp: Any) -> int:
    """Give a Time or Duration as one number [ns]."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def time_message(stamp: int) -> Time:
    """Give a stamp [ns] as Time."""
    seconds, rest = divmod(stamp, 1_000_000_000)
    return Time(sec=seconds, nanosec=rest)


def floats(x: FloatArray) -> array:
    """Give an array as the sequence that messages hold; ndarrays are refused in checked builds."""
    return array('d', np.ascontiguousarray(x, dtype=np.float64).tobytes())


def set_vector(vector: Any, values: FloatArray) -> None:
    """Write values (3,) into a Vector3 or Point."""
    vector.x, vector.y, vector.z = values.tolist()


def wrench_stamped(
    stamp: Time, frame: str, force: FloatArray | None = None, torque: FloatArray | None = None,
) -> WrenchStamped:
    """Make a wrench; zero where none is given: force (3,) [N], torque (3,) [N m]."""
    message = WrenchStamped()
    message.header.stamp, message.header.frame_id = stamp, frame
    for vector, values in ((message.wrench.force, force), (message.wrench.torque, torque)):
        if values is not None:
            set_vector(vector, values)
    return message


def force_marker(header: Header, contact: ContactEstimate) -> Marker:
    """Make an arrow of 10 mm/N whose head is the place of a contact; without one, it goes."""
    marker = Marker(header=header, ns='contact', type=Marker.ARROW, action=Marker.DELETE)
    if contact.felt and np.isfinite([*contact.point, *contact.force]).all():
        marker.action = Marker.ADD
        for values in (contact.point - 0.01 * contact.force, contact.point):
            marker.points.append(Point(**dict(zip('xyz', values.tolist(), strict=True))))
        marker.scale.x, marker.scale.y = 0.01, 0.02
        marker.color.r = marker.color.a = 1.0
    return marker


MOTION = ('positions', 'velocities', 'accelerations')  # fields of a point that make up a motion


class NamedReader:
    """Reads the values of certain names from messages with names."""

    def __init__(self, names: Sequence[str], drops: Counter[str]) -> None:
        self.names = tuple(names)
        self.drops = drops
        self._seen: list[str] | None = None
        self._index: list[int] | None = None
        self._plain = False

    def read(
        self, message: JointState | JointSample | PointSample, field: str, *,
        optional: bool = False,
    ) -> FloatArray | None:
        """Read one field; returns (names,), None where the message cannot be used."""
        if message.name != self._seen:
            self._seen = seen = list(message.name)
            known = all(seen.count(name) == 1 for name in self.names)
            self._index = [seen.index(name) for name in self.names] if known else None
            self._plain = self._index == list(range(len(seen)))
        if self._index is None:
            self.drops['unknown_names' if {*self.names} & {*message.name} else 'other_names'] += 1
            return None
        values = getattr(message, field)
        if len(values) != len(message.name):
            if not (optional and not len(values)):
                self.drops['short_array'] += 1
            return None
        x = np.array(values, dtype=np.float64)
        return x if self._plain else x[self._index]


def joint_state(stamp: Time, names: list[str], **fields: FloatArray) -> JointState:
    """Make a JointState: ``**fields`` (names,)."""
    message = JointState()
    message.header.stamp = stamp
    message.name = names
    for field, values in fields.items():
        setattr(message, field, floats(values))
    return message


def trajectory_of(message: JointTrajectory) -> Trajectory:
    """Read the points of a trajectory; SignalError where they are none."""
    points = message.points
    return Trajectory.from_points(
        tuple(message.joint_names),
        np.array([1e-9 * nanoseconds(point.time_from_start) for point in points]),
        [point.positions for point in points], [point.velocities for point in points],
        [point.accelerations for point in points])


def put_trajectory(message: JointTrajectory, found: Trajectory) -> JointTrajectory:
    """Write all that a trajectory has into a message; its points stay if there are as many."""
    message.joint_names = list(found.joints)
    if len(found.t) != len(message.points):
        message.points = [JointTrajectoryPoint(time_from_start=Duration(seconds=t).to_msg())
                          for t in found.t.tolist()]
    for k, point in enumerate(message.points):
        for name, values in (('positions', found.q), ('velocities', found.dq),
                             ('accelerations', found.ddq), ('effort', found.effort)):
            setattr(point, name, [] if values is None else floats(values[k]))
    return message


class MotionReader:
    """Reads motions from one-point trajectories."""

    def __init__(self, names: Sequence[str], drops: Counter[str]) -> None:
        self._reader = NamedReader(names, drops)
        self._drops = drops
        self._losses = Losses()
        self._last: int | None = None

    def read(self, message: PointSample) -> Motion | None:
        """Read one message; None where it cannot be used."""
        n = len(self._reader.names)
        row = np.empty(3 * n)
        for i, field in enumerate(MOTION):
            part = self._reader.read(message, field)
            if part is None:
                return None
            row[i * n:(i + 1) * n] = part
        if not all_finite(row):
            self._drops['not_finite'] += 1
            self._losses.unusable()
            return None
        stamp, elapsed = message.stamp, message.elapsed * 1e-9
        step = 0 if self._last is None else stamp - self._last
        first = self._last is None or elapsed == 0.0
        if not first and step <= 0 and -step * 1e-9 <= CLOCK_JUMP:
            self._drops['duplicate_stamp' if step == 0 else 'backward_stamp'] += 1
            return None
        self._last = stamp
        lost = self._losses.step(step) if step > 0 else 0
        if lost:
            self._drops['gap'] += lost
        return Motion(stamp, elapsed, 0.0 if first or step <= 0 else step * 1e-9, row)


# JointStates, arrays and motions from the middleware and to it: bytes, layout known before.
#
# rclpy takes 20 us to make a message object of a JointState and 15 us to make bytes of one, most
# of it for names that never change. A robot's messages on one topic share one layout, so here the
# layout is parsed once, compared with the next message, and only the numbers are read or written.
# What is no plain CDR, or no layout that can be parsed, is left to rclpy.

NO_VALUES = np.empty(0)
SECOND = 1_000_000_000
ELAPSED = 'time_from_start'


@dataclass(eq=False, slots=True)
class JointSample:
    """A JointState."""

    stamp: int  # header stamp [ns]
    name: list[str]  # joints or gauges; the same object as long as the names stay
    # Values as they came, of any byte order; empty where the message has none.
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


@dataclass(eq=False, slots=True)
class PointSample:
    """A JointTrajectory of one point."""

    # Header stamp and `time_from_start` [ns].
    stamp: int
    elapsed: int
    name: list[str]  # joints; the same object as long as the names stay
    # Values as they came.
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray


Sample = TypeVar('Sample', JointSample, PointSample)


class _Decoder(Generic[Sample]):
    """Decodes the messages of one topic; what cannot be decoded is counted."""

    kind: Any  # type of the messages
    parse: Callable[[bytes, int], Layout]
    refused = 'malformed'  # cause of a drop, for a message that has no layout

    def __init__(self, drops: Counter[str]) -> None:
        self._drops = drops
        self._length = -1
        self._fixed: list[tuple[slice, bytes]] = []
        self._numbers: dict[str, tuple[np.dtype[np.float64], int, int]] = {}
        self._time = struct.Struct('<iI')
        self._names: list[str] = []

    def decode(self, data: bytes) -> Sample | None:
        """Decode one message; None for bytes that are no message."""
        known = len(data) == self._length
        if known:
            for place, expected in self._fixed:
                if data[place] != expected:
                    known = False
                    break
        understood = data if known else self._understand(data)
        return None if understood is None else self._read(understood)

    def _understand(self, data: bytes) -> bytes | None:
        """Learn the layout of a message, of one that is no plain CDR as rclpy writes it."""
        try:
            self._learn(data, MAX_PADDING)
            return data
        except CdrError:
            cause = 'malformed'
        try:
            data = serialize_message(deserialize_message(data, self.kind))
            cause = self.refused
            self._learn(data, len(data))
            return data
        except Exception:  # rclpy's errors of bytes that are no message are not one family
            self._drops[cause] += 1
            return None

    def _learn(self, data: bytes, spare: int) -> None:
        layout = self.parse(data, spare)
        names = list(layout.names)
        if names != self._names:
            self._names = names
        edges = np.flatnonzero(np.diff(layout.significant, prepend=0, append=0)).tolist()
        self._fixed = [(slice(a, b), data[a:b])
                       for a, b in zip(edges[::2], edges[1::2], strict=True)]
        self._time = struct.Struct(layout.order + 'iI')
        kind = np.dtype(layout.order + 'f8')  # once: to make it takes as long as to read
        self._numbers = {name: (kind, size, start)
                         for name, (start, size) in layout.fields.items()}
        self._length = len(data)

    def _values(self, data: bytes, field: str) -> FloatArray:
        kind, size, start = self._numbers[field]
        return np.frombuffer(data, kind, size, start) if size else NO_VALUES

    def _stamp(self, data: bytes, place: int = HEADER) -> int:
        seconds, rest = self._time.unpack_from(data, place)
        return int(seconds * SECOND + rest)

    def _read(self, data: bytes) -> Sample | None:
        raise NotImplementedError


class JointStateDecoder(_Decoder[JointSample]):
    """Decodes the JointStates of one topic."""

    kind, parse = JointState, staticmethod(joint_state_layout)

    def _read(self, data: bytes) -> JointSample:
        return JointSample(self._stamp(data), self._names, self._values(data, 'position'),
                           self._values(data, 'velocity'), self._values(data, 'effort'))


class ArrayDecoder(_Decoder[JointSample]):
    """Decodes Float64MultiArrays of one topic into samples with names, stamped as they arrive."""

    kind, parse = Float64MultiArray, staticmethod(array_layout)

    def __init__(
        self, places: Mapping[str, int], now: Callable[[], int], drops: Counter[str],
    ) -> None:
        super().__init__(drops)
        self._channels = list(places)
        self._places = list(places.values())
        self._now = now  # clock of the node [ns]

    def _read(self, data: bytes) -> JointSample | None:
        values = self._values(data, DATA)
        if len(values) <= max(self._places):
            self._drops['short_array'] += 1
            return None
        chosen = np.array(values[self._places], dtype=np.float64)
        return JointSample(self._now(), self._channels, chosen, NO_VALUES, chosen)


class MotionDecoder(_Decoder[PointSample]):
    """Decodes the JointTrajectories of one topic, of which each has one point."""

    kind, parse = JointTrajectory, staticmethod(motion_layout)
    refused = 'not_one_point'

    def _read(self, data: bytes) -> PointSample:
        return PointSample(
            self._stamp(data), self._stamp(data, self._numbers[ELAPSED][2]),
            self._names, self._values(data, 'positions'), self._values(data, 'velocities'),
            self._values(data, 'accelerations'))


class _Encoder:
    """Bytes of messages that differ in numbers alone, by a first one that rclpy has made."""

    def __init__(
        self, template: Any, parse: Callable[[bytes, int], Layout], order: Sequence[str],
    ) -> None:
        data = serialize_message(template)
        layout = parse(data, len(data))  # rclpy appends what it had estimated too much
        self._fields, self._order = layout.fields, tuple(order)
        end = max(start + 8 * (1 if field == ELAPSED else size)
                  for field, (start, size) in self._fields.items())
        self._buffer = bytearray(data[:end])
        self._time = struct.Struct(layout.order + 'iI')
        self._kind = np.dtype(layout.order + 'f8')

    def _encode(self, stamp: int, values: Iterable[FloatArray]) -> bytes:
        self._time.pack_into(self._buffer, HEADER, *divmod(stamp, SECOND))
        for field, x in zip(self._order, values, strict=True):
            start, size = self._fields[field]
            if len(x) != size:
                raise ValueError(f'{len(x)} values for {field}; expected {size}')
            self._buffer[start:start + 8 * size] = x.astype(self._kind, copy=False).tobytes()
        return bytes(self._buffer)


class JointStateEncoder(_Encoder):
    """Encodes the JointStates of one topic."""

    def __init__(self, names: Sequence[str], fields: Sequence[str], frame: str = '') -> None:
        template = JointState(header=Header(frame_id=frame), name=list(names))
        for field in fields:
            setattr(template, field, [0.0] * len(names))
        super().__init__(template, joint_state_layout, fields)

    def encode(self, stamp: int, *values: FloatArray) -> bytes:
        """Encode a message of a stamp [ns] and the values of each field, in their order."""
        return self._encode(stamp, values)


class MotionEncoder(_Encoder):
    """Encodes motions as JointTrajectories; ``time_from_start`` counts from the filter's start."""

    def __init__(self, names: Sequence[str]) -> None:
        point = JointTrajectoryPoint(**dict.fromkeys(MOTION, [0.0] * len(names)))
        super().__init__(JointTrajectory(joint_names=list(names), points=[point]), motion_layout,
                         MOTION)

    def encode(self, stamp: int, elapsed: int, row: FloatArray) -> bytes:
        """Encode a message of a stamp [ns], a time since the beginning [ns], ``[q, dq, ddq]``."""
        self._time.pack_into(self._buffer, self._fields[ELAPSED][0], *divmod(elapsed, SECOND))
        return self._encode(stamp, row.reshape(3, -1))


class ListenedPublisher:
    """A publisher of encoded messages, which are made only where somebody listens."""

    def __init__(self, publisher: Publisher) -> None:
        self.publisher = publisher
        self.encoder: Any = None
        self._heard, self._looked = False, -math.inf

    @property
    def wanted(self) -> bool:
        """Whether somebody listens; counted again where the last count is too old."""
        now = time.perf_counter()
        if now - self._looked >= SUBSCRIPTIONS_LOOK:
            self._heard, self._looked = self.publisher.get_subscription_count() > 0, now
        return self._heard

    def publish(self, *values: Any) -> None:
        """Publish what the encoder makes of values, where it is wanted."""
        if self.wanted:
            self.publisher.publish(self.encoder.encode(*values))
