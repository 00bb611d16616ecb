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
Where things stand in CDR messages: JointState, WrenchStamped, Imu, JointTrajectory of one point.

The format is plain CDR (XCDR1) as in the OMG DDS-RTPS specification: alignment counts from behind
the encapsulation header of four bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field as dataclass_field
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
