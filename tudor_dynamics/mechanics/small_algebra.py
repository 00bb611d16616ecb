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

"""Vectors, rotations and small dense systems in compiled code."""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled


# -- Vectors and rotations of three dimensions as tuples, for compiled code.
#
# A vector is (x, y, z), a rotation its nine entries row by row. Tuples live in registers: no
# memory is allocated.

Vector = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """Give a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def sub(a: Vector, b: Vector) -> Vector:
    """Give a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def times(s: float, a: Vector) -> Vector:
    """Give s a."""
    return (s * a[0], s * a[1], s * a[2])


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Give the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Give the vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def turn(r: Rotation | NDArray, a: Vector) -> Vector:
    """Give R a."""
    return (r[0] * a[0] + r[1] * a[1] + r[2] * a[2],
            r[3] * a[0] + r[4] * a[1] + r[5] * a[2],
            r[6] * a[0] + r[7] * a[1] + r[8] * a[2])


@compiled
def turn_back(r: Rotation | NDArray, a: Vector) -> Vector:
    """Give R^T a."""
    return (r[0] * a[0] + r[3] * a[1] + r[6] * a[2],
            r[1] * a[0] + r[4] * a[1] + r[7] * a[2],
            r[2] * a[0] + r[5] * a[1] + r[8] * a[2])


@compiled
def product(a: Rotation, b: Rotation) -> Rotation:
    """Give A B."""
    return (a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
            a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
            a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
            a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
            a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
            a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
            a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
            a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
            a[6] * b[2] + a[7] * b[5] + a[8] * b[8])


@compiled
def turn_symmetric(row: NDArray, k: int, a: Vector) -> Vector:
    """Give S a; the entries xx, yy, zz, xy, xz, yz of S stand in a row from k on."""
    xx, yy, zz, xy, xz, yz = row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4], row[k + 5]
    return (xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2],
            xz * a[0] + yz * a[1] + zz * a[2])


@compiled
def about_axis(axis: Vector, angle: float) -> Rotation:
    """Give the rotation about a unit vector by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis
    d = 1.0 - c
    return (c + x * x * d, x * y * d - z * s, x * z * d + y * s,
            y * x * d + z * s, c + y * y * d, y * z * d - x * s,
            z * x * d - y * s, z * y * d + x * s, c + z * z * d)


@compiled
def coefficients(x: float) -> tuple[float, float, float, float, float]:
    """
    Give sin(f)/f, (1 - cos f)/f^2, (f - sin f)/f^3 and the last two's derivatives by f^2.

    Taylor series in x = f^2: no division at zero, and exact to 1e-12 for angles below 1 rad, far
    above what a beam of small displacements allows.
    """
    s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (
        1.0 - x / 110.0))))
    a = 0.5 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0 * (1.0 - x / 90.0 * (
        1.0 - x / 132.0)))))
    b = (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (1.0 - x / 110.0 * (
        1.0 - x / 156.0))))) / 6.0
    da = -1.0 / 24.0 + x / 360.0 - x * x / 13440.0 + x * x * x / 907200.0
    db = -1.0 / 120.0 + x / 2520.0 - x * x / 120960.0 + x * x * x / 9979200.0
    return (s, a, b, da, db)


@compiled
def skewed(t: Vector, s: float, a: float) -> Rotation:
    """Give I + s S(t) + a S(t)^2, S(t) being the vector product with t."""
    x, y, z = t
    return (1.0 - a * (y * y + z * z), a * x * y - s * z, a * x * z + s * y,
            a * x * y + s * z, 1.0 - a * (x * x + z * z), a * y * z - s * x,
            a * x * z - s * y, a * y * z + s * x, 1.0 - a * (x * x + y * y))


@compiled
def exponential(t: Vector) -> Rotation:
    """Give the rotation of a rotation vector [rad]."""
    s, a, _, _, _ = coefficients(dot(t, t))
    return skewed(t, s, a)


@compiled
def left_jacobian(t: Vector) -> Rotation:
    """Give the matrix from the rate of a rotation vector to the angular velocity."""
    _, a, b, _, _ = coefficients(dot(t, t))
    return skewed(t, a, b)


@compiled
def left_jacobian_rate(t: Vector, dt: Vector) -> Vector:
    """Give (d/dt left_jacobian) dt: the part of the angular acceleration due to rates."""
    _, _, b, da, db = coefficients(dot(t, t))
    rate = 2.0 * dot(t, dt)
    first = cross(t, dt)
    return add(times(da * rate, first),
               add(times(db * rate, cross(t, first)), times(b, cross(dt, first))))


# -- Small dense systems in compiled code: a call of LAPACK costs more than the work

@compiled
def cholesky(a: NDArray) -> bool:
    """Factorise a symmetric matrix in place (lower triangle); False if it is not definite."""
    n = a.shape[0]
    for j in range(n):
        row = a[j]
        for k in range(j):
            other = a[k]
            total = row[k]
            for i in range(k):
                total -= row[i] * other[i]
            row[k] = total * other[k]
        total = row[j]
        for i in range(j):
            total -= row[i] * row[i]
        if not total > 0.0:
            return False
        row[j] = 1.0 / math.sqrt(total)  # the inverse saves divisions later
    return True


@compiled
def solve(a: NDArray, b: NDArray) -> None:
    """Solve with the factors of ``cholesky``, in place."""
    n = a.shape[0]
    for j in range(n):
        total = b[j]
        row = a[j]
        for i in range(j):
            total -= row[i] * b[i]
        b[j] = total * row[j]
    for j in range(n - 1, -1, -1):
        row = a[j]
        value = b[j] * row[j]
        b[j] = value
        for i in range(j):
            b[i] -= row[i] * value


@compiled
def factor_norm(a: NDArray, v: NDArray) -> float:
    """Give v^T A v from the factors of A."""
    n = a.shape[0]
    total = 0.0
    for j in range(n):
        part = v[j] / a[j, j]
        for i in range(j + 1, n):
            part += a[i, j] * v[i]
        total += part * part
    return total
