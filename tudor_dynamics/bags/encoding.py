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
Arrays as messages: bulk encoding of JointState, WrenchStamped and Imu, the inverse of decoding.

All messages of a series have one layout. One template is put together by hand, its numbers are
found by the parser that also reads bags, and the columns are written over copies of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import struct
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.messages import (
    FIELDS, HEADER, IMU, imu_layout, JOINT_STATE, joint_state_layout, Layout, wrench_layout,
    WRENCH_STAMPED)
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray

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
