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

"""Inertial sensors on a mechanism: at the far end of each beam and at the tip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import (
    Chain, put_rotation, put_vector, rotation_at, vector_at)
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.vector import (
    add, exponential, left_jacobian, product, sub, turn, turn_back)
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.typing import FloatArray

TIP = 'tip'


@compiled
def feel(
    z: NDArray, dz: NDArray, gravity: NDArray, chain: Chain, bodies: NDArray, nodes: NDArray,
    acceleration: NDArray, axes: NDArray, turning: NDArray, force: NDArray,
) -> None:
    """Give axes, angular velocity and specific force of nodes, after ``nodal_motion``."""
    body_int, moving = chain.body_int, chain.moving
    for s in range(bodies.shape[0]):
        here = moving[bodies[s]]
        frame, omega = rotation_at(here, at.WORLD), vector_at(here, at.OMEGA)
        if nodes[s] > 0:
            k = body_int[bodies[s], at.FIRST] + 6 * (nodes[s] - 1) + 3
            theta = vector_at(z, k)
            bent = exponential(theta)
            omega = turn_back(bent, add(omega, turn(left_jacobian(theta), vector_at(dz, k))))
            frame = product(frame, bent)
        point = body_int[bodies[s], at.POINT] + nodes[s]
        put_rotation(axes[s], 0, frame)
        put_vector(turning[s], 0, omega)
        put_vector(force[s], 0, turn_back(
            frame, sub(vector_at(acceleration[point], 0), vector_at(gravity, 0))))


@dataclass(frozen=True, eq=False)
class Felt:
    """
    What the sensors feel, each in its own axes.

    They are those of the beam's end, x along the beam; of the tip frame where no beam ends there.
    """

    axes: FloatArray  # of each sensor in the base frame, as columns, (sensors, 3, 3)
    # Turning of each sensor, as a gyroscope reads it, (sensors, 3) [rad/s].
    angular_velocity: FloatArray
    # Acceleration less gravity, as an accelerometer reads it: at rest it points upwards,
    # (sensors, 3) [m/s^2].
    specific_force: FloatArray


def _tip(mechanism: Mechanism) -> int:
    """Give the point at the tip: the node that carries a payload where it sits right on it."""
    body = int(np.flatnonzero(mechanism.body_int[:, at.POINT] <= mechanism.tip)[-1])
    row, place = mechanism.body_int[body], mechanism.body_float[body, at.JOINT_PLACE:][:3]
    if row[at.JOINT] == at.WELD and row[at.NODE] > 0 and np.linalg.norm(place) < 1e-9:
        return int(mechanism.body_int[row[at.PARENT], at.POINT] + row[at.NODE])
    return mechanism.tip


class InertialSensors:
    """Sensors at the far end of each beam, named by the joint before it, and at the tip."""

    def __init__(self, mechanism: Mechanism) -> None:
        first = mechanism.body_int[:, at.POINT]
        points = {mechanism.point(joint): joint for joint in mechanism.beams}
        points[_tip(mechanism)] = TIP  # in place of the last beam where that ends there
        self.names = tuple(points.values())
        self._bodies = np.array([np.flatnonzero(first <= point)[-1] for point in points])
        self._nodes = np.array(list(points)) - first[self._bodies]
        count = len(self.names)
        self._felt = Felt(np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 3)))

    def feel(self, plant: Plant, acceleration: FloatArray) -> Felt:
        """
        Feel the present motion; to be called after ``Observer.observe``.

        acceleration (points, 3) [m/s^2].
        """
        felt = self._felt
        feel(plant.coordinates, plant.rates, plant.mechanism.gravity, plant.tables.chain,
             self._bodies, self._nodes, acceleration, felt.axes.reshape(len(self.names), 9),
             felt.angular_velocity, felt.specific_force)
        return felt
