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

"""A step as Python calls it: the arrays of a plant by their places, and what its joints do."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.mass import Composite
from tudor_dynamics.simulation.plant.integrator import DDZ, DZ, OK, PlantTables, step, Z
from tudor_dynamics.small_arrays import array_at, places_of, REAL, TRUTH, WHOLE


class Joints(NamedTuple):
    """Where joints stand in a plant, and what they do."""

    # Coordinate of each joint and the body behind it, (joints,).
    q_index: NDArray
    bodies: NDArray
    state: NDArray  # (4, joints): position, velocity, acceleration and effort of each; overwritten


@compiled
def report(plant: PlantTables, joints: Joints) -> None:
    """Write what the joints do; the effort is the reaction where the motion is given."""
    vectors, chain, state = plant.vectors, plant.chain, joints.state
    for number in range(joints.q_index.shape[0]):
        q, b = joints.q_index[number], joints.bodies[number]
        speed, rise = vectors[DZ, q], vectors[DDZ, q]
        state[0, number], state[1, number], state[2, number] = vectors[Z, q], speed, rise
        effort = plant.torque[q]
        if plant.prescribed[q]:
            start = 0 if chain.body_int[b, at.JOINT] == at.PRISMATIC else 3
            effort = chain.coordinate[q, at.HUB] * rise + chain.coordinate[q, at.DAMPING] * speed
            for i in range(3):
                effort += chain.reaction[b, start + i] * chain.moving[b, at.AXIS_AT + i]
        state[3, number] = effort


def reported_places(plant: PlantTables, joints: Joints) -> NDArray[np.int64]:
    """Write down where the arrays of a plant lie, for ``step_and_report``."""
    return places_of((*plant[:6], *plant.chain, *plant.composite, *joints))


@compiled
def step_and_report(loaded: bool, places: NDArray) -> int:
    """Advance one step and report: places (19, 4)."""
    a = places
    chain = Chain(array_at(a, 6, WHOLE, 2), array_at(a, 7, REAL, 2), array_at(a, 8, REAL, 2),
                  array_at(a, 9, REAL, 1), array_at(a, 10, REAL, 2), array_at(a, 11, REAL, 2),
                  array_at(a, 12, REAL, 2))
    composite = Composite(array_at(a, 13, REAL, 2), array_at(a, 14, WHOLE, 1),
                          array_at(a, 15, REAL, 2))
    plant = PlantTables(array_at(a, 0, REAL, 2), array_at(a, 1, REAL, 3), array_at(a, 2, REAL, 1),
                        array_at(a, 3, TRUTH, 1), array_at(a, 4, REAL, 1),
                        array_at(a, 5, REAL, 2), chain, composite)
    status = step(plant, loaded)
    if status == OK:
        report(plant, Joints(array_at(a, 16, WHOLE, 1), array_at(a, 17, WHOLE, 1),
                             array_at(a, 18, REAL, 2)))
    return status
