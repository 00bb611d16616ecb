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

"""Coupled drives: motors that turn with more than one joint, as in wrists and SCARAs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from tudor_dynamics.arm.fields import Finite, Name, Spec
from tudor_dynamics.typing import FloatArray

LARGEST_CONDITION = 1e6
"""A matrix beyond it does not tell the joints from the motors."""


class CouplingPair(Spec):
    """One motor that another joint turns as well."""

    motor: Name
    """Joint whose motor it is."""
    joint: Name
    """Other joint that turns it."""
    ratio: Finite
    """Turns of the motor for one turn of that joint, in turns of the motor for one of its own;
    -1 where it turns the other way [1, or rad/m or m/rad where one of both slides]."""

    @model_validator(mode='after')
    def _two_joints(self) -> CouplingPair:
        if self.motor == self.joint:
            raise ValueError(f'{self.motor!r} is coupled with itself; name another joint')
        return self


class CouplingsSpec(Spec):
    """How motors turn with joints; friction and rotor inertia act where the motors are."""

    pairs: tuple[CouplingPair, ...] = ()
    """Motors with the other joints that turn them."""
    matrix: tuple[tuple[Finite, ...], ...] | None = Field(default=None, max_length=100)
    """In place of ``pairs``: speeds of the motors, as the joints' own would be without coupling,
    by speeds of the joints; a row a motor and a column a joint, in the order of ``joints`` [1, or
    rad/m or m/rad]."""
    positions: Literal['joints', 'motors'] = 'joints'
    """What positions and velocities in the messages are those of."""
    efforts: Literal['joints', 'motors'] = 'joints'
    """What efforts in the messages are those of."""

    @model_validator(mode='after')
    def _one_form(self) -> CouplingsSpec:
        if (self.matrix is None) == (not self.pairs):
            raise ValueError('give either pairs: [{motor, joint, ratio}, ...] or matrix: [[...]]')
        return self


def coupling_matrix(couplings: CouplingsSpec, joints: Sequence[str]) -> FloatArray:
    """Give the speeds of all motors by those of all joints; returns (joints, joints)."""
    n = len(joints)
    if couplings.matrix is not None:
        if len(couplings.matrix) != n or any(len(row) != n for row in couplings.matrix):
            raise ValueError(f'couplings.matrix: expected {n} rows of {n} numbers, one a joint')
        matrix = np.array(couplings.matrix)
    else:
        matrix = np.eye(n)
        for pair in couplings.pairs:
            for name in (pair.motor, pair.joint):
                if name not in joints:
                    raise ValueError(f'couplings names the joint {name!r}, which is not among the '
                                     f'joints {list(joints)}')
            matrix[joints.index(pair.motor), joints.index(pair.joint)] += pair.ratio
    if not np.linalg.cond(matrix) < LARGEST_CONDITION:
        raise ValueError('couplings: different motions of the joints are the same motion of the '
                         'motors; correct the ratios')
    return matrix


def check_couplings(
    couplings: CouplingsSpec | None, joints: Sequence[str], active: Sequence[str],
) -> None:
    """Refuse couplings that cannot be; couplings: None where nothing is coupled."""
    if couplings is None:
        return
    matrix = coupling_matrix(couplings, joints)
    at_motors = 'motors' in (couplings.positions, couplings.efforts)
    for i, motor in enumerate(joints):
        for j, joint in enumerate(joints):
            if at_motors and i != j and matrix[i, j] and (motor in active) != (joint in active):
                raise ValueError(f'couplings: {motor!r} and {joint!r} are coupled, and what is '
                                 'measured at their motors needs both among active_joints')
