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

"""What the size of a residual depends on when nothing touches the arm."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

REVERSAL_SPEED = 0.02
"""Slower is no direction of motion [rad/s or m/s]."""
REVERSAL_WINDOW = 0.15
"""Time for which a reversal counts: friction and play do not settle at once [s]."""
RINGING = 0.5
"""Time constant with which an acceleration is forgotten: links ring on behind it [s]."""
STANDING = 2.0 * REVERSAL_SPEED
"""Slower joints may stick; friction has its sign from there on [rad/s or m/s]."""
NEVER = -2**62
"""A stamp before all others [ns]."""


class MotionFeatures:
    """
    Columns of a threshold: constant, speeds, accelerations now and lately, recent reversals.

    direction, reversed_at, lately (joints,): what is remembered: signs of the speeds, stamps of
    the last reversals [ns], decaying maxima of the accelerations [rad/s^2 or m/s^2].
    """

    def __init__(self, n_joints: int) -> None:
        self.n_joints = n_joints
        self.direction, self.lately = np.zeros(n_joints), np.zeros(n_joints)
        self.reversed_at = np.full(n_joints, NEVER)
        self._last = NEVER

    def reset(self) -> None:
        """Forget the past."""
        self.direction[:], self.reversed_at[:], self.lately[:] = 0.0, NEVER, 0.0
        self._last = NEVER

    @property
    def size(self) -> int:
        """Give the number of columns."""
        return 1 + 4 * self.n_joints

    def step(self, stamp: int, row: FloatArray) -> FloatArray:
        """
        Evaluate the columns at one sample, later than those before it.

        stamp [ns]; row (3 joints,): ``[q, dq, ddq]`` of one sample
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (size,).
        """
        columns = np.empty(self.size)
        evaluate_features(stamp, self._last, row, self.direction, self.reversed_at, self.lately,
                          columns)
        self._last = stamp
        return columns


@compiled
def evaluate_features(
    stamp: int, last: int, row: FloatArray, direction: FloatArray, reversed_at: NDArray[np.int64],
    lately: FloatArray, columns: FloatArray,
) -> None:
    """Evaluate the columns: the loop of `MotionFeatures.step`."""
    n = len(direction)
    decay = math.exp((last - stamp) * 1e-9 / RINGING)
    columns[0] = 1.0
    for i in range(n):
        dq, ddq = row[n + i], abs(row[2 * n + i])
        if abs(dq) > REVERSAL_SPEED:
            if dq * direction[i] < 0.0:
                reversed_at[i] = stamp
            direction[i] = 1.0 if dq > 0.0 else -1.0
        lately[i] = max(ddq, decay * lately[i])
        columns[1 + i] = abs(dq)
        columns[1 + n + i] = ddq
        columns[1 + 2 * n + i] = lately[i]
        columns[1 + 3 * n + i] = 1.0 if stamp - reversed_at[i] <= REVERSAL_WINDOW * 1e9 else 0.0
