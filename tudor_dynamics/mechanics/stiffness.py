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

"""Elastic stiffness of a mechanism, straight and bent, and the damping that goes with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.equations import hermite_slope, hermite_stiffness, inner, node_values


@compiled
def stiffness_matrix(
    body_int: NDArray, body_float: NDArray, coordinate: NDArray, stiffness: NDArray,
    damping: NDArray,
) -> None:
    """
    Give the elastic stiffness and the damping by stiffness and joints.

    Writes stiffness, damping (n, n).
    """
    stiffness[:] = 0.0
    damping[:] = 0.0
    for i in range(coordinate.shape[0]):
        stiffness[i, i] = coordinate[i, at.STIFFNESS]
        damping[i, i] = coordinate[i, at.DAMPING]
    for b in range(body_int.shape[0]):
        ints, floats = body_int[b], body_float[b]
        if ints[at.FLEXIBLE] == 0:
            continue
        length, beta = floats[at.LENGTH], floats[at.BETA]
        for e in range(ints[at.ELEMENTS]):
            for j in range(4):
                c = (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0,
                     1.0 if j == 3 else 0.0)
                ky = hermite_stiffness(c, length, floats[at.EIZ])
                kz = hermite_stiffness(c, length, floats[at.EIY])
                column = e + j // 2
                if column == 0:
                    continue
                cj = ints[at.FIRST] + 6 * (column - 1)
                slope = j % 2
                sj = -1.0 if slope == 1 else 1.0
                for i in range(4):
                    row = e + i // 2
                    if row == 0:
                        continue
                    ri = ints[at.FIRST] + 6 * (row - 1)
                    rise = i % 2
                    si = -1.0 if rise == 1 else 1.0
                    pair = ((ri + 1 + 4 * rise, cj + 1 + 4 * slope, ky[i]),
                            (ri + 2 + 2 * rise, cj + 2 + 2 * slope, si * sj * kz[i]))
                    for r, s, value in pair:
                        stiffness[r, s] += value
                        damping[r, s] += beta * value
            for offset, value in ((0, floats[at.EA] / length), (3, floats[at.GJ] / length)):
                k2 = ints[at.FIRST] + 6 * e + offset
                k1 = k2 - 6
                stiffness[k2, k2] += value
                damping[k2, k2] += beta * value
                if e > 0:
                    for r, s, part in ((k1, k1, value), (k1, k2, -value), (k2, k1, -value)):
                        stiffness[r, s] += part
                        damping[r, s] += beta * part


@compiled
def add_stretch(
    z: NDArray, body_int: NDArray, body_float: NDArray, gain: float, rate_gain: float,
    matrix: NDArray,
) -> None:
    """
    Add the tangent stiffness of bending that shortens a beam (lower triangle and diagonal).

    z (n,) [rad, m], matrix (n, n).
    """
    rows = np.empty(10, dtype=np.int64)
    g = np.empty(10)
    for b in range(body_int.shape[0]):
        ints, floats = body_int[b], body_float[b]
        if ints[at.FLEXIBLE] == 0 or floats[at.STRETCH] == 0.0:
            continue
        first, length = ints[at.FIRST], floats[at.LENGTH]
        for e in range(ints[at.ELEMENTS]):
            u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
            y, s = (u1[1], u1[5], u2[1], u2[5]), (u1[2], -u1[4], u2[2], -u2[4])
            gy, gz = hermite_slope(y, length), hermite_slope(s, length)
            normal = floats[at.EA] / length * (
                u2[0] - u1[0] + 0.5 * (inner(y, gy) + inner(s, gz)))
            for side in range(2):
                k = first + 6 * (e + side - 1) if e + side > 0 else -10
                o = 5 * side
                rows[o], rows[o + 1], rows[o + 2], rows[o + 3], rows[o + 4] = (
                    k, k + 1, k + 5, k + 2, k + 4)
                g[o] = 1.0 if side == 1 else -1.0
                g[o + 1], g[o + 2] = gy[2 * side], gy[2 * side + 1]
                g[o + 3], g[o + 4] = gz[2 * side], -gz[2 * side + 1]
            stiff = (gain + rate_gain * floats[at.BETA]) * floats[at.EA] / length
            for i in range(10):
                if rows[i] < 0:
                    continue
                for j in range(10):
                    if 0 <= rows[j] <= rows[i]:
                        value = stiff * g[i] * g[j]
                        if i % 5 == 0 and j % 5 == 0:
                            value = 0.0  # the linear part is in the stiffness matrix
                        matrix[rows[i], rows[j]] += value
            for j in range(4):
                if e + j // 2 == 0:
                    continue
                cj = first + 6 * (e + j // 2 - 1)
                h = hermite_slope((1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0,
                                   1.0 if j == 2 else 0.0, 1.0 if j == 3 else 0.0), length)
                sj = -1.0 if j % 2 == 1 else 1.0
                for i in range(4):
                    if e + i // 2 == 0:
                        continue
                    ri = first + 6 * (e + i // 2 - 1)
                    si = -1.0 if i % 2 == 1 else 1.0
                    r, c = ri + 1 + 4 * (i % 2), cj + 1 + 4 * (j % 2)
                    if c <= r:
                        matrix[r, c] += gain * normal * h[i]
                    r, c = ri + 2 + 2 * (i % 2), cj + 2 + 2 * (j % 2)
                    if c <= r:
                        matrix[r, c] += gain * normal * si * sj * h[i]
