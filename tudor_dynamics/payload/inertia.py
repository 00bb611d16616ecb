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
Inertial parameters of a rigid body: linear forms, change of frame, physical consistency.

The ten parameters (mass, first moments, inertia about the origin, in Pinocchio's order) are those
of a body that can exist if the pseudo-inertia ``[[S, h], [h', m]]``, ``S = tr(I) 1 / 2 - I``, is
positive semidefinite (Wensing, Kim, Slotine, "Linear matrix inequalities for physically consistent
inertial parameter identification", IEEE RA-L 3(1), 2018, Theorem 1).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tudor_dynamics.models.consistent.bodies import parameters_from, pseudo_inertia
from tudor_dynamics.typing import FloatArray

COUNT = 10
_LOWER = np.tril_indices(4)


def reframed(placement: pin.SE3) -> FloatArray:
    """
    Give the matrix that takes parameters about one frame to those about another.

    Returns (10, 10).
    """
    into = placement.inverse().homogeneous
    return np.column_stack([parameters_from(into @ pseudo_inertia(unit) @ into.T)
                            for unit in np.eye(COUNT)])


def point_mass(place: FloatArray) -> FloatArray:
    """Give the parameters of one kilogram at a place: place (3,) [m]."""
    lever = np.append(place, 1.0)
    return parameters_from(np.outer(lever, lever))


def consistent(parameters: FloatArray, information: FloatArray, size: float) -> FloatArray:
    """
    Find the body that can exist and explains an estimate best.

    What the estimate does not know is that of a small body: each kilogram is drawn into a sphere
    of the given size, by so little that no direction that is known moves.

    parameters (10,), information (10, 10), size [m]; returns (10,).
    """
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    mass = max(float(parameters[0]), 1e-6)
    # a thousandth of what one standard deviation of a body of this size would weigh
    shy = 1e-3 / np.array([mass, *3 * [mass * size], *6 * [mass * size ** 2]])

    def body(x: FloatArray) -> FloatArray:
        lower = np.zeros((4, 4))
        lower[_LOWER] = x
        return parameters_from(lower @ lower.T)

    def left(x: FloatArray) -> FloatArray:
        found = body(x)
        return np.concatenate([root @ (found - parameters), shy * found])

    def slope(x: FloatArray) -> FloatArray:
        lower = np.zeros((4, 4))
        lower[_LOWER] = x
        columns = []
        for row, column in zip(*_LOWER, strict=True):
            turned = np.zeros((4, 4))
            turned[row] = lower[:, column]
            columns.append(parameters_from(turned + turned.T))
        change = np.column_stack(columns)
        return np.vstack([root @ change, shy[:, None] * change])

    w, v = np.linalg.eigh(pseudo_inertia(parameters))
    scale = np.array([size, size, size, 1.0])
    start = (v * np.maximum(w, 0.0)) @ v.T + 1e-6 * mass * np.diag(scale ** 2)
    from scipy.optimize import least_squares  # slow to import, and few loads need it

    found = least_squares(left, np.linalg.cholesky(start)[_LOWER], slope, method='lm',
                          x_scale='jac', ftol=1e-14, xtol=1e-14, gtol=1e-14, max_nfev=500)
    return body(found.x)
