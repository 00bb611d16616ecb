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

FloatArray = NDArray[np.float64]

REVERSAL_SPEED = 0.02
"""Slower is no direction of motion [rad/s or m/s]."""
REVERSAL_WINDOW = 0.15
"""Time for which a reversal counts: friction and play do not settle at once [s]."""
RINGING = 0.5
"""Time constant with which an acceleration is forgotten: links ring on behind it [s]."""


class MotionFeatures:
    """
    Columns of a threshold: constant, speeds, accelerations now and lately, recent reversals.

    Parameters
    ----------
    n_joints : int
        Number of active joints.

    """

    def __init__(self, n_joints: int) -> None:
        self.n_joints = n_joints
        self._direction = np.zeros(n_joints)
        self._reversed = np.full(n_joints, -np.inf)
        self._lately = np.zeros(n_joints)
        self._last: int | None = None

    @property
    def size(self) -> int:
        """Number of columns."""
        return 1 + 4 * self.n_joints

    def step(self, stamp: int, row: FloatArray) -> FloatArray:
        """
        Evaluate the columns at one sample, later than those before it.

        Parameters
        ----------
        stamp : int
            Header stamp [ns].
        row : ndarray of shape (3 n_joints,)
            ``[q, dq, ddq]``.

        Returns
        -------
        ndarray of shape (size,)
            1, ``|dq|``, ``|ddq|``, the decaying maximum of ``|ddq|``, and 1 for each joint that
            has just reversed.

        """
        n = self.n_joints
        dq = row[n:2 * n]
        direction = np.where(np.abs(dq) > REVERSAL_SPEED, np.sign(dq), 0.0)
        turned = direction * self._direction < 0
        if turned.any():
            self._reversed[turned] = stamp
        self._direction = np.where(direction != 0, direction, self._direction)
        columns = np.empty(self.size)
        columns[0] = 1.0
        np.abs(row[n:], out=columns[1:1 + 2 * n])
        decay = 0.0 if self._last is None else math.exp((self._last - stamp) * 1e-9 / RINGING)
        self._last = stamp
        np.maximum(columns[1 + n:1 + 2 * n], decay * self._lately, out=self._lately)
        columns[1 + 2 * n:1 + 3 * n] = self._lately
        columns[1 + 3 * n:] = np.abs(stamp - self._reversed) <= REVERSAL_WINDOW * 1e9
        return columns
