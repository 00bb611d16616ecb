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

"""Drives as parts of the links: rotor, gear and viscous friction of ``motors``."""

from __future__ import annotations

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.drives import MotorSpec
from tudor_dynamics.arm.links import LinkSpec


def with_motors(arm: Arm) -> Arm:
    """
    Put what ``motors`` say of each joint into its link, for a mechanism driven by torques.

    The rotor's inertia seen through the gear goes to the hub, the gear between hub and link, and
    viscous friction to the joint: the mean of both directions.
    """
    if not arm.spec.motors:
        return arm
    links = {link.joint: link for link in arm.spec.links}
    for motor in arm.spec.motors:
        link = links.get(motor.joint, LinkSpec(joint=motor.joint))
        links[motor.joint] = link.model_copy(update={
            'hub_inertia': motor.reflected_inertia,
            'joint_stiffness': motor.stiffness,
            'joint_damping': motor.damping if motor.stiffness is not None else 0.0,
            'viscous_friction': motor.joint_torque_constant * sum(motor.viscous) / 2})
    spec = arm.spec.model_copy(update={'links': tuple(links.values()), 'motors': ()})
    return Arm(spec, arm.full_model, arm.source, arm.urdf)


def _left_out(motor: MotorSpec) -> list[str]:
    parts = {'Coulomb friction': any(motor.coulomb) or motor.load_friction > 0.0,
             'backlash': motor.backlash > 0.0, 'current limit': motor.current_limit is not None}
    return [name for name, there in parts.items() if there]


def left_out(arm: Arm) -> dict[str, list[str]]:
    """Name what ``with_motors`` leaves out of each joint's drive, where there is anything."""
    found = {motor.joint: _left_out(motor) for motor in arm.spec.motors}
    return {joint: parts for joint, parts in found.items() if parts}
