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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.envelope_law import (
    BY_ACCELERATION, BY_POSITION, BY_SPEED, COMMAND, CUT, envelope_law, LAG, ROW, SATURATING,
    STATES)

FloatArray = NDArray[np.float64]

CUTS = {BY_SPEED: 'speed', BY_POSITION: 'position', BY_ACCELERATION: 'acceleration'}
"""What the envelope cuts by."""

ROOM = 0.0005
"""A position limit is kept off by what the speed limit goes in this time, for readings that are
rounded [s]: 0.05 deg at 105 deg/s."""


def envelope_rows(limits: Limits, lag: float) -> FloatArray:
    """
    Lay out limits for ``envelope_law``.

    Parameters
    ----------
    limits : Limits
        What nothing exceeds.
    lag : float
        From a command until the joints move so [s].

    Returns
    -------
    ndarray of shape (n_joints, ROW)
        [rad, rad, rad/s, rad/s^2, s]

    """
    room = np.where(np.isfinite(limits.velocity), ROOM * limits.velocity, 0.0)
    rows = np.column_stack([limits.lower + room, limits.upper - room, limits.velocity,
                            limits.acceleration, np.full(len(limits.lower), lag)])
    assert rows.shape[1] == ROW
    return np.ascontiguousarray(rows, dtype=float)


class Envelope:
    """
    Envelope of several joints, step by step.

    Parameters
    ----------
    limits : Limits
        What nothing exceeds.
    lag : float
        From a command until the joints move so [s].

    """

    def __init__(self, limits: Limits, lag: float) -> None:
        self.rows = envelope_rows(limits, lag)
        self.state = np.zeros((len(self.rows), STATES))

    @property
    def command(self) -> FloatArray:
        """Last command [rad/s]."""
        return np.asarray(self.state[:, COMMAND].copy())

    @property
    def cuts(self) -> NDArray[np.intp]:
        """Sum of what cut the last command of each joint, see ``CUTS``."""
        return np.asarray(self.state[:, CUT].astype(np.intp))

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Which joints had speed or position at a limit in the last step."""
        return np.asarray((self.cuts & SATURATING) > 0)

    def set_lag(self, lag: float) -> None:
        """
        Take another time from command to motion into use [s].

        Parameters
        ----------
        lag : float
            Time from command to motion [s].

        """
        self.rows[:, LAG] = lag

    def begin(self, command: ArrayLike) -> None:
        """
        Begin anew at the speeds that the joints have [rad/s].

        Parameters
        ----------
        command : array of shape (n_joints,)
            Speeds that the joints have [rad/s].

        """
        self.state[:] = 0.0
        self.state[:, COMMAND] = command

    def reset(self) -> None:
        """Begin anew at standstill."""
        self.begin(0.0)

    def step(self, dt: float, wanted: ArrayLike, q: ArrayLike) -> FloatArray:
        """
        Bound the wanted speeds.

        Parameters
        ----------
        dt : float
            Time since the commands before [s].
        wanted : array of shape (n_joints,)
            Speeds that are asked for [rad/s].
        q : array of shape (n_joints,)
            Measured positions [rad].

        Returns
        -------
        ndarray of shape (n_joints,)
            Commands [rad/s].

        """
        wanted, q = np.asarray(wanted, dtype=float), np.asarray(q, dtype=float)
        return np.array([envelope_law(self.rows[j], self.state[j], dt, float(wanted[j]),
                                      float(q[j])) for j in range(len(self.rows))])
