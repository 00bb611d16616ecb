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

"""A driven arm linearised where it rests: what small vibrations about a pose are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.simulation.compiled import compiled
from tudor_dynamics.simulation.driven_kernel import add_lean, DDZ, DZ, FORCE, gear, Z
from tudor_dynamics.simulation.equations import inverse_dynamics

FloatArray = NDArray[np.float64]

NUDGE = 1e-6
"""Of coordinates and rates, for the differences: far below the rounding of a play [SI units]."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """
    Small motion about an equilibrium, drives held.

    Attributes
    ----------
    mass, damping, stiffness : ndarray of shape (m, m)
        Of the coordinates that move; with weight, and with the gears as they stand there.

    """

    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray


@compiled
def tangents(
    vectors: NDArray, free: NDArray, aim: NDArray, springs: NDArray, spring_at: NDArray,
    base: NDArray, wrench: NDArray, loaded: bool, body_int: NDArray, body_float: NDArray,
    coordinate: NDArray, moving: NDArray, reaction: NDArray, result: NDArray,
) -> None:
    """
    Differentiate the missing forces by coordinates, rates and accelerations, from rest.

    Parameters
    ----------
    vectors : ndarray of shape (VECTORS, n)
        State at rest; the same afterwards, but for the forces.
    free : ndarray of int, shape (m,)
        Coordinates that move.
    aim, springs, spring_at, base, wrench, loaded, body_int, body_float, coordinate
        As in ``driven_kernel.advance``.
    moving, reaction
        As in ``driven_kernel.advance``.
    result : ndarray of shape (3, m, m)
        Result: stiffness, damping, mass.

    """
    z, dz, ddz, force = vectors[Z], vectors[DZ], vectors[DDZ], vectors[FORCE]
    for kind in range(3):
        # linear in the accelerations: there a large nudge is as exact, and rounds less
        nudge = 1.0 if kind == 2 else NUDGE
        for c in range(free.shape[0]):
            row = z if kind == 0 else (dz if kind == 1 else ddz)
            here = row[free[c]]
            for side in range(2):
                sign = 1.0 - 2.0 * side
                row[free[c]] = here + sign * nudge
                inverse_dynamics(z, dz, ddz, base, wrench, loaded, 1.0, body_int, body_float,
                                 coordinate, moving, reaction, force)
                add_lean(z, body_int, body_float, force)
                for s in range(springs.shape[0]):
                    i = spring_at[s]
                    force[i] += gear(springs[s], z[i] - aim[s], dz[i])[0]
                for a in range(free.shape[0]):
                    result[kind, a, c] += sign * force[free[a]] / (2.0 * nudge)
            row[free[c]] = here
