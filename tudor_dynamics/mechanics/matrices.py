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

"""Mass, stiffness and damping matrices of a mechanism."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import (
    add, Chain, cross, dot, put_vector, rotation_at, sub, times, turn, turn_back, turn_symmetric,
    Vector, vector_at)
from tudor_dynamics.mechanics.equations import (
    along, Four, hermite_mass, hermite_slope, hermite_stiffness, inner, node_values,
    shape_function)


# -- Mass matrix by composite bodies, from the tips inwards

class Composite(NamedTuple):
    """Working memory of the mass matrix."""

    columns: NDArray  # force and moment of a unit acceleration of each coordinate, (n, 6)
    owner: NDArray  # body in whose frame a column stands, (n,)
    inertias: NDArray  # inertia of each composite body, (bodies + 1, 10)


@compiled
def unit(i: int) -> Vector:
    """Give a unit vector."""
    return (1.0 if i == 0 else 0.0, 1.0 if i == 1 else 0.0, 1.0 if i == 2 else 0.0)


@compiled
def times_inertia(inertia: NDArray, linear: Vector, angular: Vector) -> tuple[Vector, Vector]:
    """Give force and moment of a composite body: mass, first moment (3), second moment (6)."""
    mass, s = inertia[0], (inertia[1], inertia[2], inertia[3])
    push = add(times(mass, linear), cross(angular, s))
    return push, add(cross(s, linear), turn_symmetric(inertia, 4, angular))


@compiled
def put_basis(column: NDArray, x: tuple, y: tuple, z: tuple, axis: int, h: tuple) -> None:
    """Add force and moment of a unit acceleration field along one axis to a column."""
    total = h[0] + h[2]
    column[axis] += total
    if axis == 0:
        column[4] += inner(z, h)
        column[5] -= inner(y, h)
    elif axis == 1:
        column[3] -= inner(z, h)
        column[5] += inner(x, h)
    else:
        column[3] += inner(y, h)
        column[4] -= inner(x, h)


@compiled
def own_beam(
    z: NDArray, ints: NDArray, floats: NDArray, inertia: NDArray, columns: NDArray,
    matrix: NDArray,
) -> None:
    """Fill mass matrix, force columns and inertia of one beam by itself."""
    first, length, density = ints[at.FIRST], floats[at.LENGTH], floats[at.DENSITY]
    polar = floats[at.POLAR] * length
    for e in range(ints[at.ELEMENTS]):
        u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
        x = along(e * length + u1[0], (e + 1) * length + u2[0], length)
        y = (u1[1], u1[5], u2[1], u2[5])
        s = (u1[2], -u1[4], u2[2], -u2[4])
        hx, hy = hermite_mass(x, length, density), hermite_mass(y, length, density)
        hz = hermite_mass(s, length, density)
        xx, yy, zz = inner(x, hx), inner(y, hy), inner(s, hz)
        xy, xz, yz = inner(x, hy), inner(x, hz), inner(y, hz)
        inertia[0] += density * length
        inertia[1] += hx[0] + hx[2]
        inertia[2] += hy[0] + hy[2]
        inertia[3] += hz[0] + hz[2]
        inertia[4] += yy + zz + polar
        inertia[5] += xx + zz
        inertia[6] += xx + yy
        inertia[7] -= xy
        inertia[8] -= xz
        inertia[9] -= yz
        for side in range(2):
            if e + side == 0:
                continue
            k = first + 6 * (e + side - 1)
            other = e + 1 - side
            value = 1.0 if side == 0 else 0.0
            h = hermite_mass(along(value, 1.0 - value, length), length, density)
            put_basis(columns[k], x, y, s, 0, h)
            matrix[k, k] += density * length / 3.0
            columns[k + 3, 3] += 0.5 * polar
            matrix[k + 3, k + 3] += polar / 3.0
            if other > 0:
                m = first + 6 * (other - 1)
                matrix[k, m] += density * length / 6.0
                matrix[k + 3, m + 3] += polar / 6.0
            for slope in range(2):
                j = 2 * side + slope
                h = hermite_mass(shape_function(j), length, density)
                sign = -1.0 if slope == 1 else 1.0
                row_y, row_z = k + 1 + 4 * slope, k + 2 + 2 * slope
                put_basis(columns[row_y], x, y, s, 1, h)
                put_basis(columns[row_z], x, y, s, 2,
                          (sign * h[0], sign * h[1], sign * h[2], sign * h[3]))
                for end in range(2):
                    if e + end > 0:
                        n = first + 6 * (e + end - 1)
                        matrix[row_y, n + 1] += h[2 * end]
                        matrix[row_y, n + 5] += h[2 * end + 1]
                        matrix[row_z, n + 2] += sign * h[2 * end]
                        matrix[row_z, n + 4] -= sign * h[2 * end + 1]


@compiled
def turned_inertia(frame: tuple, inertia: NDArray, turned: NDArray) -> None:
    """Give the inertia of a composite body in the axes of its carrier, same origin."""
    turned[0] = inertia[0]
    put_vector(turned, 1, turn(frame, vector_at(inertia, 1)))
    x = turn(frame, turn_symmetric(inertia, 4, (frame[0], frame[1], frame[2])))
    y = turn(frame, turn_symmetric(inertia, 4, (frame[3], frame[4], frame[5])))
    z = turn(frame, turn_symmetric(inertia, 4, (frame[6], frame[7], frame[8])))
    turned[4], turned[5], turned[6] = x[0], y[1], z[2]
    turned[7], turned[8], turned[9] = x[1], x[2], y[2]


@compiled
def shifted_inertia(inertia: NDArray, place: Vector, target: NDArray) -> None:
    """Add a composite body that stands at ``place`` to another one."""
    mass, s = inertia[0], vector_at(inertia, 1)
    cross_term = 2.0 * dot(place, s) + mass * dot(place, place)
    target[0] += mass
    for i in range(3):
        target[1 + i] += s[i] + mass * place[i]
        target[4 + i] += (inertia[4 + i] + cross_term - 2.0 * place[i] * s[i]
                          - mass * place[i] * place[i])
    target[7] += inertia[7] - place[0] * s[1] - place[1] * s[0] - mass * place[0] * place[1]
    target[8] += inertia[8] - place[0] * s[2] - place[2] * s[0] - mass * place[0] * place[2]
    target[9] += inertia[9] - place[1] * s[2] - place[2] * s[1] - mass * place[1] * place[2]


@compiled
def mass_matrix(z: NDArray, chain: Chain, composite: Composite, matrix: NDArray) -> None:
    """Write the mass matrix (n, n) by composite bodies, from the tips inwards."""
    body_int, body_float, moving = chain.body_int, chain.body_float, chain.moving
    columns, owner, inertias = composite.columns, composite.owner, composite.inertias
    n, bodies = z.shape[0], body_int.shape[0]
    matrix[:] = 0.0
    columns[:] = 0.0
    inertias[:] = 0.0
    owner[:] = -2
    turned = inertias[bodies]
    for i in range(n):
        matrix[i, i] = chain.coordinate[i, at.HUB]
    for b in range(bodies - 1, -1, -1):
        ints, floats, here = body_int[b], body_float[b], moving[b]
        if ints[at.FLEXIBLE] == 1:
            own_beam(z, ints, floats, inertias[b], columns, matrix)
            for i in range(6 * ints[at.ELEMENTS]):
                owner[ints[at.FIRST] + i] = b
        else:
            turned[:] = 0.0
            turned[0] = floats[at.MASS]
            for i in range(6):
                turned[4 + i] = floats[at.INERTIA + i]
            shifted_inertia(turned, vector_at(floats, at.CENTER), inertias[b])
        frame = rotation_at(here, at.TO_PARENT)
        place, joint_at = vector_at(here, at.PLACE), vector_at(here, at.JOINT_AT)
        node_at, axis = vector_at(here, at.NODE_AT), vector_at(here, at.AXIS_AT)
        turned_inertia(frame, inertias[b], turned)
        parent, node = ints[at.PARENT], ints[at.NODE]
        kind, q, spring = ints[at.JOINT], ints[at.Q], ints[at.SPRING]
        lever = sub(place, joint_at)
        elastic = body_int[parent, at.FIRST] + 6 * (node - 1) if parent >= 0 and node > 0 else -1
        jacobian = rotation_at(here, at.JACOBIAN)
        for j in range(n):  # columns of this body and of all it carries, into the carrier's axes
            if owner[j] != b:
                continue
            push = turn(frame, vector_at(columns[j], 0))
            moment = turn(frame, vector_at(columns[j], 3))
            if kind != at.WELD:
                about = add(moment, cross(lever, push))
                share = dot(axis, about if kind == at.REVOLUTE else push)
                if q >= 0:
                    matrix[q, j] += share
                    matrix[j, q] += share
                if spring >= 0:
                    matrix[spring, j] += share
                    matrix[j, spring] += share
            put_vector(columns[j], 0, push)
            put_vector(columns[j], 3, moment)
        if kind == at.REVOLUTE:
            push, moment = times_inertia(turned, cross(axis, lever), axis)
            share = dot(axis, add(moment, cross(lever, push)))
        elif kind == at.PRISMATIC:
            push, moment = times_inertia(turned, axis, (0.0, 0.0, 0.0))
            share = dot(axis, push)
        if kind != at.WELD:
            for j in (q, spring):
                if j >= 0:
                    put_vector(columns[j], 0, push)
                    put_vector(columns[j], 3, moment)
                    owner[j] = b
                    matrix[j, j] += share
            if q >= 0 and spring >= 0:
                matrix[q, spring] += share
                matrix[spring, q] += share
        if parent < 0:
            continue
        arm = sub(place, node_at)
        for j in range(n):
            if owner[j] != b:
                continue
            owner[j] = parent
            push, moment = vector_at(columns[j], 0), vector_at(columns[j], 3)
            if elastic >= 0:
                twist = turn_back(jacobian, add(moment, cross(arm, push)))
                for i in range(3):
                    matrix[elastic + i, j] += push[i]
                    matrix[j, elastic + i] += push[i]
                    matrix[elastic + 3 + i, j] += twist[i]
                    matrix[j, elastic + 3 + i] += twist[i]
            put_vector(columns[j], 3, add(moment, cross(place, push)))
        if elastic >= 0:
            for j in range(6):
                linear, angular = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
                if j < 3:
                    linear = unit(j)
                else:
                    angular = turn(jacobian, unit(j - 3))
                    linear = cross(angular, arm)
                push, moment = times_inertia(turned, linear, angular)
                twist = turn_back(jacobian, add(moment, cross(arm, push)))
                outer = add(moment, cross(place, push))
                for i in range(3):
                    matrix[elastic + i, elastic + j] += push[i]
                    matrix[elastic + 3 + i, elastic + j] += twist[i]
                    columns[elastic + j, i] += push[i]
                    columns[elastic + j, 3 + i] += outer[i]
        shifted_inertia(turned, place, inertias[parent])


# -- Elastic stiffness, straight and bent, and the damping that goes with it

@compiled
def add_column(
    matrix: NDArray, first: int, e: int, j: int, scale: float, y: Four, z: Four,
) -> None:
    """Add what function j of element e makes of its bending along y and z; node 0 is clamped."""
    if e + j // 2 == 0:
        return
    column, slope = first + 6 * (e + j // 2 - 1), j % 2
    for i in range(4):
        if e + i // 2 > 0:
            row, rise = first + 6 * (e + i // 2 - 1), i % 2
            sign = 1.0 if rise == slope else -1.0
            matrix[row + 1 + 4 * rise, column + 1 + 4 * slope] += scale * y[i]
            matrix[row + 2 + 2 * rise, column + 2 + 2 * slope] += sign * scale * z[i]


@compiled
def stiffness_matrix(
    body_int: NDArray, body_float: NDArray, coordinate: NDArray, stiffness: NDArray,
    damping: NDArray,
) -> None:
    """Write the elastic stiffness, and the damping by stiffness and joints, (n, n)."""
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
                c = shape_function(j)
                ky = hermite_stiffness(c, length, floats[at.EIZ])
                kz = hermite_stiffness(c, length, floats[at.EIY])
                add_column(stiffness, ints[at.FIRST], e, j, 1.0, ky, kz)
                add_column(damping, ints[at.FIRST], e, j, beta, ky, kz)
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
    """Add the tangent stiffness of bending that shortens a beam; the lower triangle alone."""
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
            normal = floats[at.EA] / length * (u2[0] - u1[0] + 0.5 * (inner(y, gy) + inner(s, gz)))
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
                h = hermite_slope(shape_function(j), length)
                add_column(matrix, first, e, j, gain * normal, h, h)


@compiled
def stretch_energy(z: NDArray, body_int: NDArray, body_float: NDArray) -> float:
    """Give the elastic energy [J] of the shortening by bending, beyond that of straight beams."""
    total = 0.0
    for b in range(body_int.shape[0]):
        ints, floats = body_int[b], body_float[b]
        if ints[at.FLEXIBLE] == 1 and floats[at.STRETCH] > 0.0:
            first, length = ints[at.FIRST], floats[at.LENGTH]
            for e in range(ints[at.ELEMENTS]):
                u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
                y, s = (u1[1], u1[5], u2[1], u2[5]), (u1[2], -u1[4], u2[2], -u2[4])
                shorter = 0.5 * (inner(y, hermite_slope(y, length))
                                 + inner(s, hermite_slope(s, length)))
                total += 0.5 * floats[at.EA] / length * shorter * (2.0 * (u2[0] - u1[0]) + shorter)
    return total
