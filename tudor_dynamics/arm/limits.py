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
Limits of the joints, told apart: what nothing ever exceeds, and what is planned.

The first come from the description's ``limits``, the URDF and the motors, whichever is tighter.
Planned motion stays below, so that the damper of the links has room to add its share.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.drives import DRIVE_TIMEOUT
from tudor_dynamics.arm.schema import JointSpec, LimitSpec, PlannedSpec
from tudor_dynamics.typing import FloatArray

UNLIMITED = 1e8
"""What a continuous joint of a URDF has as a limit is none."""
PLANNED_SPEED = 2.0 / 3.0
"""Part of the speed limit that is planned where the description does not say."""
PLANNED_ACCELERATION = 1.0 / 3.0
"""The same of the acceleration; the damper needs more of that."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the active joints; infinite where none is known."""

    # Smallest and largest positions, (joints,) [rad or m].
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray  # largest speed in either direction, (joints,) [rad/s or m/s]
    # Largest acceleration in either direction, (joints,) [rad/s^2 or m/s^2].
    acceleration: FloatArray
    missing: tuple[str, ...] = ()  # what is not known, one phrase each

    def outside(self, q: FloatArray) -> NDArray[np.bool_]:
        """Say which positions [rad or m] are beyond a limit: q (joints,) [rad or m]."""
        return np.asarray((q < self.lower) | (q > self.upper))


@dataclass(frozen=True, eq=False)
class DriveStop:
    """How drives stop by themselves where no command comes."""

    timeout: float  # time without a command from which on they do [s]
    acceleration: FloatArray  # with which they brake, (joints,) [rad/s^2 or m/s^2]


def unlimited(joints: int) -> Limits:
    """Give the limits of joints that have none."""
    without = np.full(joints, np.inf)
    return Limits(-without, without, without, without)


def _known(value: float | None) -> float:
    return math.inf if value is None else value


def _of_joint(arm: Arm, joint: JointSpec) -> tuple[float, float, float, float]:
    """Give lower, upper, velocity and acceleration of one joint; infinite where unknown."""
    given = joint.limits or LimitSpec()
    lower = -math.inf if given.lower is None else given.lower
    upper, speed = _known(given.upper), _known(given.velocity)
    if arm.urdf is not None:
        inner = arm.full_model.joints[arm.full_model.getJointId(joint.name)]
        described = (float(arm.full_model.lowerPositionLimit[inner.idx_q]),
                     float(arm.full_model.upperPositionLimit[inner.idx_q]))
        if described[0] < described[1] and max(-described[0], described[1]) < UNLIMITED:
            lower, upper = max(lower, described[0]), min(upper, described[1])
        fastest = float(arm.full_model.velocityLimit[inner.idx_v])
        if 0.0 < fastest < UNLIMITED:
            speed = min(speed, fastest)
    acceleration = _known(given.acceleration)
    motor = next((motor for motor in arm.spec.motors if motor.joint == joint.name), None)
    if motor is not None and motor.current_limit and motor.reflected_inertia > 0.0:
        acceleration = min(acceleration, motor.current_limit * motor.joint_torque_constant
                           / motor.reflected_inertia)
    return lower, upper, speed, acceleration


def hard_limits(arm: Arm) -> Limits:
    """Give what the joints of an arm never exceed."""
    rows = np.array([_of_joint(arm, joint) for joint in arm.joints]).reshape(-1, 4)
    missing = [f'{joint.name}: no limit of {what}'
               for joint, row in zip(arm.joints, rows, strict=True)
               for what, value in zip(('position downwards', 'position upwards', 'velocity',
                                       'acceleration'), row, strict=True)
               if not math.isfinite(value)]
    return Limits(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], tuple(missing))


def planned_limits(arm: Arm) -> Limits:
    """
    Give what planned motion of an arm keeps to.

    Parameters
    ----------
    arm : Arm
        Description; where ``planned`` says nothing, parts of the hard limits are taken, and a
        range that leaves the way in which the hard acceleration stops the planned speed twice.

    Returns
    -------
    Limits
        Of the active joints.

    """
    hard = hard_limits(arm)
    given = [joint.planned or PlannedSpec() for joint in arm.joints]

    def chosen(key: str, default: FloatArray) -> FloatArray:
        return np.array([value if getattr(item, key) is None else getattr(item, key)
                         for item, value in zip(given, default, strict=True)], dtype=float)
    velocity = np.minimum(chosen('velocity', PLANNED_SPEED * hard.velocity), hard.velocity)
    acceleration = np.minimum(chosen('acceleration', PLANNED_ACCELERATION * hard.acceleration),
                              hard.acceleration)
    with np.errstate(invalid='ignore'):
        room = np.nan_to_num(velocity**2 / hard.acceleration, nan=0.0, posinf=0.0)
    room = np.minimum(room, 0.1 * np.where(np.isfinite(hard.upper - hard.lower),
                                           hard.upper - hard.lower, 0.0))
    return Limits(chosen('lower', hard.lower + room), chosen('upper', hard.upper - room),
                  velocity, acceleration, hard.missing)


def effort_limits(arm: Arm) -> FloatArray:
    """
    Give the largest effort of each active joint, in the unit that it is measured in.

    Returns (joints,) [A, N m or N], infinite where none is known.
    """
    largest = np.full(len(arm.joints), np.inf)
    for i, joint in enumerate(arm.joints):
        constant = joint.effort.torque_constant
        motor = next((motor for motor in arm.spec.motors if motor.joint == joint.name), None)
        if motor is not None and motor.current_limit:
            largest[i] = motor.current_limit * (
                1.0 if joint.effort.unit == 'A' else motor.joint_torque_constant)
        if arm.urdf is not None and (joint.effort.unit != 'A' or constant is not None):
            inner = arm.full_model.joints[arm.full_model.getJointId(joint.name)]
            described = float(arm.full_model.effortLimit[inner.idx_v])
            if 0.0 < described < UNLIMITED:
                largest[i] = min(largest[i], described / (constant or 1.0))
    return largest


def drive_stop(arm: Arm) -> DriveStop:
    """Give how the drives of an arm stop by themselves."""
    damper = arm.spec.damper
    return DriveStop(DRIVE_TIMEOUT if damper is None else damper.drive_timeout,
                     planned_limits(arm).acceleration)
