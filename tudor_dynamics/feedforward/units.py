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

"""Efforts as currents or as torques, by the torque constants of the description."""

from __future__ import annotations

from typing import Literal

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.typing import FloatArray

Unit = Literal['model', 'current', 'torque']
UNITS: tuple[Unit, ...] = ('model', 'current', 'torque')
"""As the model has it; currents [A]; torques of the motors at the joints [N m, or N]."""


def torque_constants(arm: Arm) -> dict[str, float]:
    """
    Give the torque at each joint per ampere, gear and efficiency included, where it is described.

    Returns joint to constant [N m/A or N/A].
    """
    motors = {motor.joint: motor.joint_torque_constant for motor in arm.spec.motors}
    return {joint.name: joint.effort.torque_constant or motors[joint.name]
            for joint in arm.joints
            if joint.effort.torque_constant is not None or joint.name in motors}


def factors(arm: Arm, unit: Unit) -> FloatArray:
    """Give what efforts of a model are multiplied by; returns (joints,)."""
    known, result = torque_constants(arm), np.ones(len(arm.joints))
    for i, joint in enumerate(arm.joints):
        is_current = joint.effort.unit == 'A'
        if unit == 'model' or is_current == (unit == 'current'):
            continue
        if joint.name not in known:
            msg = (f'the effort of joint {joint.name!r} is in {joint.effort.unit}, and its torque '
                   'constant is not described')
            raise ModelError(msg, remedy='give effort.torque_constant, or motors, and fit anew; '
                                         'or take the unit of the model')
        result[i] = known[joint.name] if unit == 'torque' else 1.0 / known[joint.name]
    return result


def unit_names(arm: Arm, unit: Unit) -> tuple[str, ...]:
    """Name the unit of each joint's effort."""
    return tuple(
        joint.effort.unit if unit == 'model' else 'A' if unit == 'current' else
        'N' if arm.is_prismatic(joint.name) else 'N m' for joint in arm.joints)
