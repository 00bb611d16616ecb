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
from tudor_dynamics.simulation.driven_statics import DDZ, DZ, FORCE, residual, Z

FloatArray = NDArray[np.float64]

NUDGE = 1e-6
"""Of coordinates and rates, for the differences: far below a play's rounding [rad, m, 1/s]."""


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


def white_force(
    small: Linearised, pushed: FloatArray, shown: FloatArray, bandwidth: float,
) -> float:
    """
    Give the density of a white force at the tip, for a filter of a given bandwidth.

    An oscillator that a white force of density q drives and white noise of density r hides has a
    filter with the decay sqrt(q / r) lever w / 2 (spectral factorisation).

    Parameters
    ----------
    small : Linearised
        Arm where it starts.
    pushed : ndarray of shape (m, 3)
        Generalised forces of a unit force at the tip.
    shown : ndarray of shape (n_gauges, m)
        Reading of each gauge by coordinate, in standard deviations of its noise.
    bandwidth : float
        Rate at which an error of the slowest vibration dies out [1/s].

    Returns
    -------
    float
        Density of the force over that of the noise [N^2].

    """
    lever = float(np.linalg.norm(shown @ np.linalg.solve(small.stiffness, pushed), 2))
    slowest = float(np.sqrt(np.linalg.eigvals(
        np.linalg.solve(small.mass, small.stiffness)).real.min()))
    return float((2.0 * bandwidth / max(lever * slowest, 1e-12)) ** 2)


@compiled
def tangents(
    vectors: NDArray, free: NDArray, aim: NDArray, aim_rate: NDArray, springs: NDArray,
    spring_at: NDArray, base: NDArray, wrench: NDArray, loaded: bool, body_int: NDArray,
    body_float: NDArray, coordinate: NDArray, moving: NDArray, reaction: NDArray, result: NDArray,
) -> None:
    """
    Differentiate the missing forces by coordinates, rates and accelerations, from rest.

    Parameters
    ----------
    vectors : ndarray of shape (VECTORS, n)
        State at rest; the same afterwards.
    free : ndarray of int, shape (m,)
        Coordinates that move.
    aim, aim_rate, springs, spring_at, base, wrench, loaded
        As in ``driven_kernel.advance``.
    body_int, body_float, coordinate, moving, reaction
        As in ``driven_kernel.advance``.
    result : ndarray of shape (3, m, m)
        Result: stiffness, damping, mass.

    """
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
                residual(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded,
                         body_int, body_float, coordinate, moving, reaction)
                for a in range(free.shape[0]):
                    result[kind, a, c] += sign * force[free[a]] / (2.0 * nudge)
            row[free[c]] = here
    # what follows from the coordinates that move is still that of the last nudge
    residual(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded, body_int,
             body_float, coordinate, moving, reaction)
