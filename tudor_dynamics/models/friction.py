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

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.schema import JointSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

(_VISCOUS, _VISCOUS_FORWARD, _VISCOUS_BACKWARD, _COULOMB, _FORWARD, _BACKWARD, _OFFSET, _STRIBECK,
 _CUBE_ROOT, _SQUARE, LOAD, PRESLIDING) = range(12)
_TERMS = {'viscous': (_VISCOUS,), 'coulomb': (_COULOMB,), 'offset': (_OFFSET,),
          'stribeck': (_STRIBECK,), 'cube_root': (_CUBE_ROOT,), 'square': (_SQUARE,),
          'load': (LOAD,), 'presliding': (PRESLIDING,)}
_DIRECTED = {'viscous': (_VISCOUS_FORWARD, _VISCOUS_BACKWARD), 'coulomb': (_FORWARD, _BACKWARD)}


def friction_names(joint: JointSpec) -> tuple[str, ...]:
    """Name the friction parameters of a joint."""
    names: list[str] = []
    for term in joint.friction:
        if joint.asymmetric and term in ('viscous', 'coulomb'):
            names += [f'{term}+({joint.name})', f'{term}-({joint.name})']
        elif term == 'presliding':
            names += [f'{term}@{distance:g}({joint.name})' for distance in joint.bristles]
        else:
            names.append(f'{term}({joint.name})')
    return tuple(names)


def friction_columns(
    joint: JointSpec, dq: FloatArray, load: FloatArray | None = None,
    bent: FloatArray | None = None,
) -> FloatArray:
    """
    Evaluate the friction columns of a joint.

    dq (samples,) [rad/s or m/s], load (samples,) [N m or N]; bent (samples, bristles or more): as
    of a joint that slides by default; returns (samples, terms).
    """
    codes = friction_codes(joint)
    out = np.empty((len(dq), len(codes)))
    _fill(np.asarray(dq, dtype=float), codes, joint.friction_velocity, joint.stribeck_velocity,
          out)
    if bent is not None:
        out[:, codes == PRESLIDING] = bent[:, :len(joint.bristles)]
    if load is not None:
        out[:, codes == LOAD] *= np.abs(load)[:, None]
    return out


def friction_codes(joint: JointSpec) -> NDArray[np.intp]:
    """Give the terms of a joint as `friction_term` takes them, one a column."""
    return np.array([
        code for term in joint.friction for code in (
            _DIRECTED if joint.asymmetric and term in _DIRECTED else _TERMS)[term]
        for _ in (joint.bristles if code == PRESLIDING else (0.0,))], dtype=np.intp)


@compiled
def _fill(dq: FloatArray, codes: NDArray, sharp: float, stribeck: float, out: FloatArray) -> None:
    for k in range(len(dq)):
        for i in range(len(codes)):
            out[k, i] = friction_term(codes[i], dq[k], sharp, stribeck)


@compiled
def friction_term(code: int, dq: float, sharp: float, stribeck: float) -> float:
    """
    Evaluate one column at one speed; that of a load still wants its size as a factor.

    Friction that gives way is taken as that of a joint that slides.

    dq, sharp, stribeck [rad/s or m/s].
    """
    if code == _OFFSET:
        return 1.0
    if code == _VISCOUS:
        return dq
    if code == _SQUARE:
        return dq * abs(dq)
    if code == _CUBE_ROOT:
        # smoothed as the sign is: the root's slope at zero is infinite
        return dq / (dq * dq + sharp * sharp) ** (1.0 / 3.0)
    smooth = math.tanh(dq / sharp)
    if code == _COULOMB or code == LOAD or code == PRESLIDING:
        return smooth
    if code == _STRIBECK:
        return smooth * math.exp(-(dq / stribeck) ** 2)
    if code == _VISCOUS_FORWARD:
        return dq * 0.5 * (1.0 + smooth)
    if code == _VISCOUS_BACKWARD:
        return dq * 0.5 * (1.0 - smooth)
    return 0.5 * (1.0 + smooth) if code == _FORWARD else 0.5 * (1.0 - smooth)
