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

"""Position loop with strain feedback for joints that take velocities."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.control.damper import arm_damping, Damper
from tudor_dynamics.errors import ArmError

FloatArray = NDArray[np.float64]


class VelocityController:
    """
    Velocity commands from reference, position and strain.

    ``dq_ref + K_p (q_ref - q) + damper``, bounded by 1.5 times the joint's speed limit.

    Parameters
    ----------
    arm : Arm
        Description with a damper.
    share : float, default=1.0
        Part of the damper's gains.

    Raises
    ------
    ArmError
        If there is no damper.

    """

    def __init__(self, arm: Arm, share: float = 1.0) -> None:
        if arm.spec.damper is None:
            msg = f'{arm.source}: there is no damper; add damper: with the gains of its joints'
            raise ArmError(msg)
        self.joints = arm.active_joints
        self.gauges = arm.gauge_names
        self.position_gain = arm.spec.damper.position_gain
        self.damper = Damper([item for item in arm_damping(arm) if item.joint in self.joints],
                             1.0 / arm.spec.damper.rate)
        self.share = share
        self._to = [self.joints.index(name) for name in self.damper.joints]
        self._from = [self.gauges.index(name) for name in self.damper.gauges]
        self._limit = np.array([
            1.5 * ((joint.limits.velocity if joint.limits else None) or math.inf)
            for joint in arm.joints])
        self._limited = np.zeros(len(self.joints), dtype=bool)

    def reset(self) -> None:
        """Begin anew; the damper fades in once its gauges were well for a while."""
        self.damper.reset()
        self._limited[:] = False

    def step(
        self,
        dt: float,
        q: FloatArray,
        q_ref: FloatArray,
        dq_ref: FloatArray,
        strain: FloatArray,
        fresh: ArrayLike,
    ) -> FloatArray:
        """
        Give the commands for one sample.

        Parameters
        ----------
        dt : float
            Time since the sample before [s].
        q : ndarray of shape (n_joints,)
            Positions [rad or m].
        q_ref, dq_ref : ndarray of shape (n_joints,)
            Reference [rad, rad/s or m, m/s].
        strain : ndarray of shape (n_gauges,)
            Readings in units of the gauges; not a number where missing.
        fresh : array of bool, shape (n_gauges,)
            Whether each reading is new.

        Returns
        -------
        ndarray of shape (n_joints,)
            Commanded speeds [rad/s or m/s].

        """
        self.damper.dt = dt
        new = np.broadcast_to(np.asarray(fresh, dtype=bool), strain.shape)
        wanted = dq_ref + self.position_gain * (q_ref - q)
        wanted[self._to] += self.share * self.damper.step(
            strain[self._from], new[self._from], self._limited[self._to])
        command = np.clip(wanted, -self._limit, self._limit)
        self._limited = command != wanted
        return np.asarray(command)
