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

"""Where the motors of an elastic arm have to be for its links to be where they are wanted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.feedforward.inversion import Inverse, invert
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Bent:
    """What an elastic arm needs point by point."""

    # Positions of the motors, as their encoders show them, (points, joints) [rad or m].
    motor: FloatArray
    torque: FloatArray  # torque (or force) of each gear on the links, (points, joints) [N m or N]


class BentArm:
    """An elastic arm under the load of a wanted motion."""

    def __init__(self, arm: Arm, values: Mapping[str, float]) -> None:
        self._driven = driven_arm(arm, values)
        mechanism, gears = self._driven.mechanism, self._driven.tables.gears
        joint = np.array([mechanism.body_of[name] for name in arm.active_joints], dtype=np.int64)
        springs = set(gears.place.tolist())
        bends = np.array([i for i in self._driven.tables.equations.free.tolist()
                          if i not in springs], dtype=np.int64)
        ends = np.array([*(mechanism.body_of[name] for name in mechanism.beams),
                         len(mechanism.body_int) - 1], dtype=np.int64)
        moved = np.array([[float(body in self._carriers(int(end))) for body in joint.tolist()]
                          for end in ends])
        n, m, e = len(joint), len(bends), len(ends)
        self._tables = tuple(Inverse(
            bends, ends, joint, moved, np.zeros((m, m)), np.zeros(m), np.zeros((n, n)),
            np.zeros(n), np.zeros((e, 3)), np.zeros((n, 3))))
        self._name = arm.name

    def _carriers(self, body: int) -> set[int]:
        """Give a body and all that carry it."""
        found = set()
        while body >= 0:
            found.add(body)
            body = int(self._driven.mechanism.body_int[body, at.PARENT])
        return found

    @property
    def payload(self) -> float:
        """Give the mass at the tip [kg]."""
        return self._driven.parameters['payload']

    def carry(self, payload: float) -> None:
        """Put another mass at the tip: payload [kg]."""
        self._driven.set_parameters({'payload': payload})

    def under(self, motion: FloatArray, *, reach: bool) -> Bent:
        """
        Bend the arm under the load of a motion, each point by itself.

        motion (points, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        q, dq, ddq = (np.ascontiguousarray(part) for part in np.split(motion, 3, axis=1))
        motor, torque = np.zeros_like(q), np.zeros_like(q)
        done = invert(q, dq, ddq, reach, motor, torque, self._tables, *self._driven.arrays)
        if done < len(q):
            msg = (f'{self._name}: links and gears do not come to rest under the load of point '
                   f'{done + 1}, q = {np.round(q[done], 3).tolist()}')
            raise SimulationError(msg, remedy='move it more slowly, or correct the stiffnesses')
        return Bent(motor, torque)
