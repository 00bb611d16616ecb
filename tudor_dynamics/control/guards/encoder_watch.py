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

"""Encoders that cannot be believed: frozen while commanded, jumping, or out of any range."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.typing import FloatArray

FROZEN_TIME = 0.015
"""A reading that stands still is frozen where the joint should have gone on for so long at its
speed limit [s]: 1.8 deg at 120 deg/s."""
FROZEN_SAMPLES = 3
"""Readings that must be the same: slow joints give the same count twice."""
JUMP_SPEED = 3.0
"""A reading may change by so many times the speed limit..."""
JUMP_TIME = 0.02
"""... and by what the speed limit makes of this time besides [s]."""
RANGE_TIME = 0.2
"""Further beyond a position limit than the speed limit goes in this time is no pose [s]."""


class EncoderWatch:
    """
    Judges the readings of encoders against the commands that the joints were given.

    owed (joints,) [rad or m].
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._speed = limits.velocity
        n = len(self._speed)
        self._last: FloatArray | None = None
        self._same = np.zeros(n, dtype=np.intp)
        self.owed = np.zeros(n)
        self._stood, self._jumped = np.zeros(n), np.zeros(n)

    def reset(self) -> None:
        """Take the next reading for a first one."""
        self._last = None
        self._same[:] = 0
        self.owed[:] = 0.0
        self._stood[:] = 0.0
        self._jumped[:] = 0.0

    def step(self, dt: float, q: FloatArray, commanded: FloatArray) -> list[tuple[int, str]]:
        """
        Judge one reading.

        dt [s], q (joints,) [rad or m], commanded (joints,) [rad/s or m/s].
        """
        found: list[tuple[int, str]] = []
        far = self._speed * RANGE_TIME
        for j in np.flatnonzero((q < self._limits.lower - far) | (q > self._limits.upper + far)):
            found.append((int(j), f'its position {q[j]:.4g} is no pose of the arm, with limits of '
                          f'{self._limits.lower[j]:.4g} .. {self._limits.upper[j]:.4g}'))
        if self._last is not None:
            change = q - self._last
            allowed = self._speed * (JUMP_SPEED * dt + JUMP_TIME)
            for j in np.flatnonzero(np.abs(change) > allowed):
                found.append((int(j), f'its position jumped by {change[j]:.4g} within '
                              f'{1e3 * dt:.3g} ms'))
                self._jumped[j] -= change[j] - dt * commanded[j]
            still = change == 0.0
            self._same = np.where(still, self._same + 1, 0)
            self._stood = np.where(still, self._stood + dt * commanded, 0.0)
            self.owed = self._stood + self._jumped
            frozen = (self._same >= FROZEN_SAMPLES) & (
                np.abs(self._stood) > self._speed * FROZEN_TIME)
            for j in np.flatnonzero(frozen):
                found.append((int(j), 'it does not move although it is commanded to: encoder '
                              'frozen, brake on, or a driver that does not listen'))
        self._last = q.copy()
        return found
