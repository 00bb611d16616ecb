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

"""Motion envelope: no speed leaves the package that a joint's limits do not allow."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.limits import DriveStop, Limits
from tudor_dynamics.control.envelope_law import (
    ACCELERATION, BRAKE, BY_SPEED, COMMAND, CUT, envelope_law, LOWER,
    ROW, SATURATING, SPEED, STATES, TIME, UPPER)
from tudor_dynamics.typing import FloatArray

ROOM = 0.002
"""A position limit is kept off by what the speed limit goes in this time, for readings that are
rounded and joints that stick and slip [s]: 0.24 deg at 120 deg/s."""
BRAKING = 0.6
"""Part of the acceleration limit with which the arm stops before a position limit: the rest is for
what drive and load make of a command."""
APPROACH = math.e
"""Time of the approach over the lag: a place that is approached by v = way / T through a lag is
not overshot from T = e lag on."""


class Envelope:
    """Envelope of several joints, step by step: lag [s]."""

    def __init__(self, limits: Limits, lag: float, stop: DriveStop | None = None) -> None:
        joints = len(limits.lower)
        self._timeout = 0.0 if stop is None else stop.timeout
        room = np.where(np.isfinite(limits.velocity), ROOM * limits.velocity, 0.0)
        brake = BRAKING * limits.acceleration
        self.rows = np.zeros((joints, ROW))
        self.rows[:, LOWER], self.rows[:, UPPER] = limits.lower + room, limits.upper - room
        self.rows[:, SPEED], self.rows[:, ACCELERATION] = limits.velocity, limits.acceleration
        self.rows[:, BRAKE] = brake if stop is None else np.minimum(brake, stop.acceleration)
        self.set_lag(lag)
        self.state = np.zeros((joints, STATES))

    @property
    def command(self) -> FloatArray:
        """Last command [rad/s]."""
        return np.asarray(self.state[:, COMMAND].copy())

    @property
    def cuts(self) -> NDArray[np.intp]:
        """Sum of what cut the last command of each joint, see `envelope_law`."""
        return np.asarray(self.state[:, CUT].astype(np.intp))

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Which joints had speed or position at a limit in the last step."""
        return np.asarray((self.cuts & SATURATING) > 0)

    @property
    def speeding(self) -> NDArray[np.bool_]:
        """Which joints were to go faster than their speed limit in the last step."""
        return np.asarray((self.cuts & BY_SPEED) > 0)

    def set_lag(self, lag: float) -> None:
        """Take another time from command to motion into use [s]."""
        self.rows[:, TIME] = max(APPROACH * lag, lag + self._timeout)

    def begin(self, command: ArrayLike) -> None:
        """Begin anew at the speeds that the joints have [rad/s]: command (joints,) [rad/s]."""
        self.state[:] = 0.0
        self.state[:, COMMAND] = command

    def reset(self) -> None:
        """Begin anew at standstill."""
        self.begin(0.0)

    def step(self, dt: float, wanted: ArrayLike, q: ArrayLike) -> FloatArray:
        """
        Bound the wanted speeds.

        dt [s], wanted (joints,) [rad/s], q (joints,) [rad]; returns (joints,) [rad/s].
        """
        wanted, q = np.asarray(wanted, dtype=float), np.asarray(q, dtype=float)
        return np.array([envelope_law(self.rows[j], self.state[j], dt, float(wanted[j]),
                                      float(q[j])) for j in range(len(self.rows))])
