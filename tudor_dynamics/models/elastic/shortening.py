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
Beams of one element that keep their length: bending draws the end in, and pressure bends on.

The axial coordinate is no freedom of its own but follows from bending, in motion, forces and mass
matrix alike. A beam whose STRETCH is below zero is linear, and nothing draws it in.
"""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.equations import hermite_slope


@compiled
def shortening_rows(v: NDArray, first: int, length: float) -> tuple[float, float, float, float]:
    """Give what bending does along a beam of one element, by coordinates 1, 5, 2, 4 of its end."""
    gy = hermite_slope((0.0, 0.0, v[first + 1], v[first + 5]), length)
    gz = hermite_slope((0.0, 0.0, v[first + 2], -v[first + 4]), length)
    return gy[2], gy[3], gz[2], -gz[3]


@compiled
def shorten(
    z: NDArray, dz: NDArray, ddz: NDArray, body_int: NDArray, body_float: NDArray,
) -> None:
    """
    Draw the ends of bent beams in, before ``inverse_dynamics``.

    A beam keeps its length, so bending by w draws its end in by s = w' G w / 2: the axial
    coordinate is no freedom but -s, its rates those of -s.
    """
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k, length = body_int[b, at.FIRST], body_float[b, at.LENGTH]
        g1, g5, g2, g4 = shortening_rows(z, k, length)
        r1, r5, r2, r4 = shortening_rows(dz, k, length)
        z[k] = -0.5 * (g1 * z[k + 1] + g5 * z[k + 5] + g2 * z[k + 2] + g4 * z[k + 4])
        dz[k] = -(g1 * dz[k + 1] + g5 * dz[k + 5] + g2 * dz[k + 2] + g4 * dz[k + 4])
        ddz[k] = -(g1 * ddz[k + 1] + g5 * ddz[k + 5] + g2 * ddz[k + 2] + g4 * ddz[k + 4]
                   + r1 * dz[k + 1] + r5 * dz[k + 5] + r2 * dz[k + 2] + r4 * dz[k + 4])


@compiled
def add_shortening(
    z: NDArray, body_int: NDArray, body_float: NDArray, force: NDArray,
) -> None:
    """
    Add what a beam's normal force does to its bending, after ``inverse_dynamics``.

    The row of the axial displacement holds the force that the end needs along the beam; by
    virtual work it acts on each bending coordinate times the rate at which that draws the end in.
    """
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k = body_int[b, at.FIRST]
        pressure = -force[k]
        g1, g5, g2, g4 = shortening_rows(z, k, body_float[b, at.LENGTH])
        force[k + 1] += pressure * g1
        force[k + 5] += pressure * g5
        force[k + 2] += pressure * g2
        force[k + 4] += pressure * g4


@compiled
def shorten_mass(z: NDArray, body_int: NDArray, body_float: NDArray, mass: NDArray) -> None:
    """
    Turn the mass matrix into that of beams which keep their length.

    A congruence, so it stays positive: with the shortening in the forces alone, the corrections
    of a strongly bent arm would not converge.
    """
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k = body_int[b, at.FIRST]
        g1, g5, g2, g4 = shortening_rows(z, k, body_float[b, at.LENGTH])
        for j in range(mass.shape[0]):
            along = mass[k, j]
            mass[k + 1, j] -= g1 * along
            mass[k + 5, j] -= g5 * along
            mass[k + 2, j] -= g2 * along
            mass[k + 4, j] -= g4 * along
        for j in range(mass.shape[0]):
            along = mass[j, k]
            mass[j, k + 1] -= g1 * along
            mass[j, k + 5] -= g5 * along
            mass[j, k + 2] -= g2 * along
            mass[j, k + 4] -= g4 * along
