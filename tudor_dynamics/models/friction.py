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
Friction as regressor columns, continuous at standstill.

Malzahn et al., Eq. (2), prints k_v+ as a constant, which makes two columns equal. What is meant is
a viscous and a Coulomb coefficient for each direction: columns ``dq s+``, ``dq s-``, ``s+``,
``s-``. The switches are smoothed, ``s+ = (1 + tanh(dq / v0)) / 2``, because at standstill a plain
sign chatters between the two directions with the encoder's last bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.schema import JointSpec

FloatArray = NDArray[np.float64]


def friction_names(joint: JointSpec) -> tuple[str, ...]:
    """
    Name the friction parameters of a joint.

    Parameters
    ----------
    joint : JointSpec
        Description with its friction terms.

    Returns
    -------
    tuple of str
        One name a column, such as ``viscous+(joint2)``.

    """
    names: list[str] = []
    for term in joint.friction:
        if joint.asymmetric and term in ('viscous', 'coulomb'):
            names += [f'{term}+({joint.name})', f'{term}-({joint.name})']
        else:
            names.append(f'{term}({joint.name})')
    return tuple(names)


def friction_columns(joint: JointSpec, dq: FloatArray) -> FloatArray:
    """
    Evaluate the friction columns of a joint.

    Parameters
    ----------
    joint : JointSpec
        Description with its friction terms.
    dq : ndarray of shape (n_samples,)
        Velocity [rad/s or m/s].

    Returns
    -------
    ndarray of shape (n_samples, n_terms)
        Columns in the order of `friction_names`. Coefficients come out in effort units per
        velocity unit (viscous), effort units (coulomb, offset, stribeck), and effort units per
        root or square of the velocity unit (cube_root, square). In the asymmetric case the
        negative direction's Coulomb coefficient comes out negative.

    """
    smooth = np.tanh(dq / joint.friction_velocity)
    forward, backward = 0.5 * (1.0 + smooth), 0.5 * (1.0 - smooth)
    columns: list[FloatArray] = []
    for term in joint.friction:
        if term == 'viscous':
            columns += [dq * forward, dq * backward] if joint.asymmetric else [dq]
        elif term == 'coulomb':
            columns += [forward, backward] if joint.asymmetric else [smooth]
        elif term == 'offset':
            columns.append(np.ones_like(dq))
        elif term == 'stribeck':
            columns.append(smooth * np.exp(-(dq / joint.stribeck_velocity) ** 2))
        elif term == 'cube_root':
            # smoothed as the sign is: the root's slope at zero is infinite
            columns.append(dq / np.cbrt(dq * dq + joint.friction_velocity ** 2))
        else:
            columns.append(dq * np.abs(dq))
    if not columns:
        return np.zeros((len(dq), 0))
    return np.stack(columns, axis=1)
