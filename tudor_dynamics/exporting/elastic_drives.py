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

"""What an elastic model says of the drives of an arm: torque constants, rotors, friction."""

from __future__ import annotations

from dataclasses import dataclass

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.exporting.friction import Simple, simple_friction
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.elastic.model import elastic_of


SPEED = 1.0
"""Up to which friction counts, where a description has no limit [rad/s or m/s]."""


@dataclass(frozen=True)
class ElasticDrive:
    """Drive of one joint."""

    # Torque at the joint for each unit of the measured effort [N m or N by that unit].
    constant: float
    # Rotor inertia `Ia` and friction as the joint feels them, by the names of their terms
    # [kg m^2, N m s/rad, N m; for prismatic joints kg, N s/m, N].
    terms: dict[str, float]


def elastic_drives(bundle: ModelBundle) -> dict[str, ElasticDrive]:
    """
    Read the drives out of the effort model of an elastic arm.

    Returns an empty dict where there is no elastic model of efforts.
    """
    model = elastic_of(bundle, 'effort')
    if model is None or model.coefficients_ is None:
        return {}
    found = {}
    for joint, columns, values in zip(
            model.channels, model.columns, model.coefficients_, strict=True):
        by_torque = float(values[0])
        if by_torque <= 0.0:
            raise ModelError(
                f'the elastic model of {bundle.arm.name} has efforts of {joint} that fall with '
                f'the torque of its gear ({by_torque:.3g}): its drive cannot be described',
                remedy='fit motion in which this joint carries more')
        found[joint] = ElasticDrive(1.0 / by_torque, {
            column.partition('(')[0]: float(value) / by_torque
            for column, value in zip(columns[1:], values[1:], strict=True)})
    return found


def elastic_friction(arm: Arm, joint: str, terms: dict[str, float]) -> Simple:
    """Bring the friction of a joint to two numbers."""
    spec = arm.joints[arm.active_joints.index(joint)]
    limit = None if spec.limits is None else spec.limits.velocity
    return simple_friction(spec, terms, limit or SPEED)
