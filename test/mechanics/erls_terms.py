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

"""Element matrices and the terms of the paper's Eq. (4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.typing import FloatArray


def skew(w: FloatArray) -> FloatArray:
    """Give the matrix of the vector product w x."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def shape_products(length: float) -> FloatArray:
    """
    Give int N_a^T N_b ds for a, b = x, y, z: all that inertia needs.

    Parameters
    ----------
    length : float
        Length of the element [m].

    Returns
    -------
    ndarray of shape (3, 3, 12, 12)
        Integrals; nodal order u, v, w, rx, ry, rz, twice.

    """
    points, weights = np.polynomial.legendre.leggauss(6)
    result = np.zeros((3, 3, 12, 12))
    for point, weight in zip(0.5 * (points + 1.0), 0.5 * length * weights, strict=True):
        xi = float(point)
        h = (1 - 3 * xi**2 + 2 * xi**3, length * (xi - 2 * xi**2 + xi**3),
             3 * xi**2 - 2 * xi**3, length * (xi**3 - xi**2))
        n = np.zeros((3, 12))
        n[0, [0, 6]] = 1 - xi, xi
        n[1, [1, 5, 7, 11]] = h
        n[2, [2, 4, 8, 10]] = h[0], -h[1], h[2], -h[3]
        result += weight * np.einsum('ai,bj->abij', n, n)
    return result


def element_stiffness(length: float, floats: FloatArray) -> FloatArray:
    """
    Give the 12 x 12 stiffness of an Euler-Bernoulli element in its own axes.

    Parameters
    ----------
    length : float
        Length of the element [m].
    floats : ndarray
        Row of its body, see ``layout``.

    """
    k = np.zeros((12, 12))
    for rows, value in (((0, 6), floats[at.EA]), ((3, 9), floats[at.GJ])):
        k[np.ix_(rows, rows)] += value / length * np.array([[1.0, -1.0], [-1.0, 1.0]])
    bending = np.array([[12, 6 * length, -12, 6 * length],
                        [6 * length, 4 * length**2, -6 * length, 2 * length**2],
                        [-12, -6 * length, 12, -6 * length],
                        [6 * length, 2 * length**2, -6 * length, 4 * length**2]]) / length**3
    k[np.ix_((1, 5, 7, 11), (1, 5, 7, 11))] += floats[at.EIZ] * bending
    sign = np.array([1.0, -1.0, 1.0, -1.0])
    k[np.ix_((2, 4, 8, 10), (2, 4, 8, 10))] += floats[at.EIY] * np.outer(sign, sign) * bending
    return k


@dataclass(frozen=True, eq=False)
class Terms:
    """
    Matrices of Eq. (4) at one state, in the base frame, over the nodes of each beam.

    Attributes
    ----------
    mass, stiffness : ndarray of shape (n, n)
        M and K.
    coriolis : ndarray of shape (n, n)
        2 (M_G1 + M_G2).
    centrifugal : ndarray of shape (n, n)
        M_C1 + 2 M_C2 + M_C3 without the part of the joints' acceleration.
    angular : ndarray of shape (n_joints, n, n)
        That part: d(M_C1 + M_C3)/d(q'').
    jacobian : ndarray of shape (n, n_joints)
        J: nodal velocities of the equivalent rigid links.
    bias : ndarray of shape (n,)
        J' q', the part of the accelerations that rates alone make.
    mass_damping, stiffness_damping : ndarray of shape (n, n)
        alpha M and beta K.

    """

    mass: FloatArray
    stiffness: FloatArray
    coriolis: FloatArray
    centrifugal: FloatArray
    angular: FloatArray
    jacobian: FloatArray
    bias: FloatArray
    mass_damping: FloatArray
    stiffness_damping: FloatArray
