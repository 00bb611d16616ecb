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

"""Small motion of a driven arm about an equilibrium: what it is linear in, drives held."""

from __future__ import annotations

from dataclasses import dataclass

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.gear import Gears
from tudor_dynamics.models.elastic.statics import DDZ, DZ, Equations, FORCE, residual, Z
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.typing import FloatArray

NUDGE = 1e-6
"""Of coordinates and rates, for the differences: far below a play's rounding [rad, m, 1/s]."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Small motion about an equilibrium, drives held."""

    # (m, m): of the coordinates that move; with weight, and with the gears as they stand there.
    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray


@compiled
def tangents(
    equations: Equations, gears: Gears, chain: Chain, loaded: bool, result: NDArray,
) -> None:
    """
    Differentiate the missing forces by coordinates, rates and accelerations, from rest.

    Writes result (3, m, m).
    """
    vectors, free = equations.vectors, equations.free
    force = vectors[FORCE]
    for kind in range(3):
        # linear in the accelerations: there a large nudge is as exact, and rounds less
        nudge = 1.0 if kind == 2 else NUDGE
        row = vectors[Z] if kind == 0 else (vectors[DZ] if kind == 1 else vectors[DDZ])
        for c in range(free.shape[0]):
            here = row[free[c]]
            for side in range(2):
                sign = 1.0 - 2.0 * side
                row[free[c]] = here + sign * nudge
                residual(vectors, gears, chain, loaded)
                for a in range(free.shape[0]):
                    result[kind, a, c] += sign * force[free[a]] / (2.0 * nudge)
            row[free[c]] = here
    # what follows from the coordinates that move is still that of the last nudge
    residual(vectors, gears, chain, loaded)
