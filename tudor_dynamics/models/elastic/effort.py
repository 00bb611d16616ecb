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

"""What makes up the effort of an elastic arm's motor: torque of its gear, its rotor, friction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.base import SLIDING
from tudor_dynamics.models.elastic.arm import Response
from tudor_dynamics.models.friction import friction_columns, friction_names
from tudor_dynamics.typing import FloatArray


def _has_offset(names: tuple[str, ...]) -> bool:
    """Say whether friction terms make a constant: an offset, or a Coulomb term each way."""
    return any(name.startswith(('offset(', 'coulomb+(')) for name in names)


def effort_columns(arm: Arm) -> tuple[tuple[str, ...], ...]:
    """Name what makes up the effort of each joint."""
    return tuple(
        ('torque', f'Ia({joint.name})', *friction_names(joint),
         *(() if _has_offset(friction_names(joint)) else ('offset',)))
        for joint in arm.joints)


def effort_rows(arm: Arm, response: Response, motion: FloatArray) -> list[FloatArray]:
    """
    Give what makes up the effort of each joint.

    motion (samples, 3 joints): ``[q, dq, ddq]`` of the same samples
    [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (samples, columns).
    """
    n = len(arm.joints)
    rows = []
    for i, joint in enumerate(arm.joints):
        dq, ddq = motion[:, n + i], motion[:, 2 * n + i]
        columns = [response.torque[:, i], ddq, *friction_columns(joint, dq).T]
        if not _has_offset(friction_names(joint)):
            columns.append(np.ones(len(motion)))
        rows.append(np.column_stack(columns))
    return rows


def friction_jumps(arm: Arm, coefficients: Sequence[FloatArray]) -> FloatArray:
    """
    Give half of what each effort jumps by where its joint begins to slide, either way.

    Returns (joints,).
    """
    jumps = []
    for joint, values in zip(arm.joints, coefficients, strict=True):
        forward, backward = friction_columns(joint, np.array([SLIDING, -SLIDING]))
        jumps.append(0.5 * abs(float((forward - backward) @ values[2:2 + len(forward)])))
    return np.array(jumps)
