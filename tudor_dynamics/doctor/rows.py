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

"""Rows of the rigid bodies for any gravity, and what each channel has to itself."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.coupling import Coupling
from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.typing import FloatArray


class BodyRows:
    """Rows of an output, linear in the parameters of the bodies and in gravity."""

    def __init__(self, arm: Arm, output: str) -> None:
        strain = output == 'strain'
        self.model = pin.Model(arm.gauge_model if strain else arm.model)
        self.gravity = np.array(arm.spec.gravity)
        self.channels = arm.gauge_names if strain else arm.active_joints
        self._bodies = RigidBodies(self.model, self._places(arm.active_joints),
                                   self._places(self.channels))
        alone = [(i,) for i in range(len(self.channels))]
        known = () if strain else tuple(
            i for i, joint in enumerate(arm.joints)
            if joint.effort.unit != 'A' or joint.effort.torque_constant is not None)
        self.groups: tuple[tuple[int, ...], ...] = tuple(
            ([known] if known else []) + [one for one in alone if one[0] not in known])
        self.scale = np.array([1.0] * len(self.channels) if strain else
                              [joint.effort.torque_constant or 1.0 for joint in arm.joints])
        self._own = output == 'effort'
        self._sharp = np.array([joint.friction_velocity for joint in arm.joints])
        self._coupling = Coupling(arm)

    def _places(self, names: tuple[str, ...]) -> np.ndarray:
        return np.array([self.model.joints[self.model.getJointId(name)].idx_v for name in names],
                        dtype=np.intp)

    def rows(self, motion: FloatArray, gravity: FloatArray | None = None) -> FloatArray:
        """
        Evaluate the rows of the bodies.

        gravity (3,) [m/s^2]; motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (n, channels, columns).
        """
        out = np.zeros((len(motion), len(self.channels), 10 * (self.model.njoints - 1)))
        self._bodies.rows(self._coupling.of_joints(motion), out,
                          self.gravity if gravity is None else gravity)
        if self._own:
            self._coupling.mix(out)
        return out / self.scale[None, :, None]

    def of_gravity(self, motion: FloatArray) -> FloatArray:
        """
        Evaluate what gravity along each axis of the base adds to the rows.

        motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints, the positions count; returns
        (3, n, channels, columns).
        """
        still = motion.copy()
        still[:, motion.shape[1] // 3:] = 0.0
        return np.stack([self.rows(still, axis) for axis in np.eye(3)])

    def own(self, motion: FloatArray) -> list[FloatArray]:
        """
        Evaluate what each channel has to itself: rotor, friction and offset, or an offset.

        motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints; returns (n, own).
        """
        ones = np.ones((len(motion), 1))
        if not self._own:
            return [ones] * len(self.channels)
        n = len(self.channels)
        joints, speeds = self._coupling.of_joints(motion), self._coupling.speeds
        terms = []
        for dq, ddq, least in zip((joints[:, n:2 * n] @ speeds.T).T,
                                  (joints[:, 2 * n:] @ speeds.T).T, self._sharp, strict=True):
            sharp = max(float(least), 0.03 * float(np.sqrt(np.mean(dq ** 2))), 1e-9)
            terms.append(np.column_stack([ddq, dq, np.tanh(dq / sharp)]))
        reach = self._coupling.reach != 0.0
        return [np.hstack([terms[i], ones, *(
            terms[k] for k in np.flatnonzero(reach[i]) if k != i)]) for i in range(n)]
