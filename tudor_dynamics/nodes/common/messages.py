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

"""Between messages and arrays: by name, never by place; whatever is wrong is counted."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time
import numpy as np
from sensor_msgs.msg import JointState

from tudor_dynamics.monitoring.stamps import Losses
from tudor_dynamics.monitoring.state_filter import Motion
from tudor_dynamics.nodes.common.wire import JointSample, PointSample
from tudor_dynamics.small_arrays import all_finite
from tudor_dynamics.typing import FloatArray


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


class NamedReader:
    """Reads the values of certain names from JointStates."""

    def __init__(self, names: Sequence[str], drops: Counter[str]) -> None:
        self.names = tuple(names)
        self.drops = drops
        self._seen: list[str] | None = None
        self._index: list[int] | None = None
        self._plain = False

    def read(
        self, message: JointState | JointSample, field: str, *, optional: bool = False,
    ) -> FloatArray | None:
        """Read one field; returns (names,), None where the message cannot be used."""
        if message.name != self._seen:
            self._arrange(list(message.name))
        if self._index is None:
            self.drops['unknown_names'] += 1
            return None
        values = getattr(message, field)
        if len(values) != len(message.name):
            if not (optional and not len(values)):
                self.drops['short_array'] += 1
            return None
        x = np.array(values, dtype=np.float64)
        return x if self._plain else x[self._index]

    def _arrange(self, seen: list[str]) -> None:
        self._seen = seen
        if all(seen.count(name) == 1 for name in self.names):
            self._index = [seen.index(name) for name in self.names]
            self._plain = self._index == list(range(len(seen)))
        else:
            self._index = None


def joint_state(stamp: Time, names: list[str], **fields: FloatArray) -> JointState:
    """Make a JointState: ``**fields`` (names,)."""
    message = JointState()
    message.header.stamp = stamp
    message.name = names
    for field, values in fields.items():
        setattr(message, field, floats(values))
    return message


class MotionReader:
    """Reads motions from one-point trajectories."""

    def __init__(self, names: Sequence[str], drops: Counter[str]) -> None:
        self.names = tuple(names)
        self.drops = drops
        self._losses = Losses()
        self._last: int | None = None
        self._seen: list[str] | None = None
        self._index: list[int] | None = None
        self._plain = False

    def read(self, message: PointSample) -> Motion | None:
        """Read one message; None where it cannot be used."""
        if message.name != self._seen:
            self._seen = list(message.name)
            known = all(self._seen.count(name) == 1 for name in self.names)
            self._index = [self._seen.index(name) for name in self.names] if known else None
            self._plain = self._index == list(range(len(self._seen)))
        if self._index is None:
            self.drops['unknown_names'] += 1
            return None
        parts = (message.positions, message.velocities, message.accelerations)
        if any(len(part) != len(message.name) for part in parts):
            self.drops['short_array'] += 1
            return None
        n = len(self.names)
        row = np.empty(3 * n)
        for i, part in enumerate(parts):
            row[i * n:(i + 1) * n] = part if self._plain else part[self._index]
        if not all_finite(row):
            self.drops['not_finite'] += 1
            self._losses.unusable()
            return None
        stamp, elapsed = message.stamp, message.elapsed * 1e-9
        last, self._last = self._last, stamp
        if last is not None and stamp > last:
            lost = self._losses.step(stamp - last)
            if lost:
                self.drops['gap'] += lost
        if elapsed == 0.0 or last is None:
            return Motion(stamp, elapsed, 0.0, row)
        if stamp <= last:
            if (last - stamp) * 1e-9 <= 1.0:
                self._last = last
                self.drops['duplicate_stamp' if stamp == last else 'backward_stamp'] += 1
                return None
            return Motion(stamp, elapsed, 0.0, row)
        return Motion(stamp, elapsed, (stamp - last) * 1e-9, row)
