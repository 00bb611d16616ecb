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
Coupled drives in the rows: what is measured at motors, and what each effort feels of them.

With the speeds of the motors ``w = C dq`` (those of uncoupled drives, behind their gears, are
``dq``), friction and rotor inertia f(w) of the motors reach the joints as ``C' f(w)``, since both
sides do the same work; a motor feels ``C^-T`` of what the bodies ask of the joints.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.typing import FloatArray


class Coupling:
    """From what is measured to joints and motors, and back: speeds, reach (joints, joints)."""

    def __init__(self, arm: Arm) -> None:
        matrix, spec = arm.coupling, arm.spec.couplings
        n = len(arm.active_joints)
        self.speeds = np.eye(n) if matrix is None else matrix
        self.reach = np.eye(n)
        self._mixture: FloatArray | None = None
        self._joints: FloatArray | None = None
        self._alone = matrix is None
        if spec is None or matrix is None:
            return
        if spec.positions == 'motors':
            self._joints = np.asarray(np.linalg.inv(matrix))
        if spec.efforts == 'joints':
            self.reach = np.ascontiguousarray(matrix.T)
        else:
            self._mixture = np.asarray(np.linalg.inv(matrix).T)

    def of_joints(self, motion: FloatArray) -> FloatArray:
        """
        Give the motion of the joints.

        motion (samples, 3 joints): ``[q, dq, ddq]`` as measured
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        if self._joints is None:
            return motion
        n = len(self._joints)
        return np.hstack([motion[:, i * n:(i + 1) * n] @ self._joints.T for i in range(3)])

    def drive_places(self, q: FloatArray) -> FloatArray:
        """
        Give what the motors have turned by, behind their gears.

        q (samples, joints) [rad or m].
        """
        if self._alone:
            return q
        joints = q if self._joints is None else q @ self._joints.T
        return joints @ self.speeds.T

    def mix(self, rows: FloatArray) -> None:
        """
        Turn rows of the joints into rows of what is measured, in place.

        rows (samples, joints, columns).
        """
        if self._mixture is not None:
            rows[:] = np.einsum('ij,kjp->kip', self._mixture, rows)

    def body_efforts(
        self, bodies: RigidBodies, motion: FloatArray, parameters: FloatArray,
    ) -> FloatArray:
        """
        Evaluate what the bodies ask of each effort.

        parameters (joints, columns); motion (samples, 3 joints): ``[q, dq, ddq]`` of the joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (samples, joints) [N m or N].
        """
        out = np.empty((len(motion), len(parameters)))
        bodies.outputs(motion, parameters, out)
        if self._mixture is None:
            return out
        mixed = out * np.diag(self._mixture)
        for i, j in np.argwhere((self._mixture != 0.0) & ~np.eye(len(out.T), dtype=bool)):
            # an effort has parameters of its own: those of i, at the joint j
            bodies.outputs(motion, np.tile(parameters[i], (len(parameters), 1)), out)
            mixed[:, i] += self._mixture[i, j] * out[:, j]
        return mixed
