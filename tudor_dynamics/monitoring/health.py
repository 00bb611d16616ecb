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

"""Sensors that have died: a channel that keeps its value while the arm moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

MOVING = 0.05
"""A joint that is faster moves [rad/s or m/s]."""


class SensorHealth:
    """Watches channels of one sensor: stuck_time [s]."""

    def __init__(self, names: Sequence[str], stuck_time: float) -> None:
        self.names = tuple(names)
        self.stuck_time = stuck_time
        self._values = np.full(len(self.names), np.nan)
        self._still = np.zeros(len(self.names))
        self._last: int | None = None
        self.moving = False

    def step(self, stamp: int, values: FloatArray) -> None:
        """
        Take a reading into account; time counts only while ``moving``.

        stamp [ns], values (channels,) [its unit].
        """
        dt = 0.0 if self._last is None else min(max((stamp - self._last) * 1e-9, 0.0), 1.0)
        self._last = stamp
        _wait(values, self._values, dt if self.moving else 0.0, self._still)

    def dead(self) -> list[str]:
        """Name the channels that count as dead."""
        return [name for name, still in zip(self.names, self._still, strict=True)
                if still > self.stuck_time]


@compiled
def _wait(values: FloatArray, last: FloatArray, dt: float, still: FloatArray) -> None:
    """Add time where a value is the last one, and begin anew where it is not."""
    for i in range(len(values)):
        still[i] = still[i] + dt if values[i] == last[i] else 0.0
        last[i] = values[i]
