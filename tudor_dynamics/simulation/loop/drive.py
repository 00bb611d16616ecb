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
Current-controlled motor with gear: rotor, friction, elastic gear with backlash.

Friction grows with the torque through the gear, gives way before it slides, and may grip more
firmly at rest. All values are those seen at the joint. The rotor is advanced first, then the link
with the torque of the gear at the end of the step: the gear's spring is a stiffness of the link's
joint, the rotor's angle its other end, so that no gear is too stiff for the light end of a beam.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.drives import MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.typing import FloatArray

# Columns of the parameters of one joint.
TORQUE = 0  # per current [N m/A]
INERTIA = 1  # of the rotor [kg m^2]
VISCOUS = 2  # 2: for positive and negative motion [N m s/rad]
COULOMB = 4  # 2: for positive and negative motion [N m]
BREAKAWAY = 6  # friction at rest over Coulomb friction
LIMIT = 7  # of the current [A]
STIFFNESS = 8  # of the gear [N m/rad]
DAMPING = 9  # of the gear [N m s/rad]
PLAY = 10  # half of the backlash [rad]
LOADED = 11  # friction per torque through the gear
PRESLIDING = 12  # how far friction gives way before it slides [rad]
PARAMETERS = 13
# Columns of the state of one joint; bent is how far friction has given way, over PRESLIDING.
ANGLE, SPEED, CURRENT, GEAR, LIMITED, BENT = range(6)
STATES = 6

RIGID = 0.5
"""Angle of the fastest allowed swing of the rotor on its gear per step [rad]."""


@compiled
def rotor_law(drive: NDArray, state: NDArray, dt: float, current: float) -> None:
    """
    Advance the rotor of one joint by a step [s] under a wanted current [A].

    Friction is implicit: it takes the speed to zero where it can, and holds it there, or with
    presliding it is an elastic bristle that yields at the grip of Coulomb friction (Dupont et
    al., "Single state elastoplastic friction models", IEEE TAC 47(5), 2002, with a sharp
    transition): elastic for good below it, so a load that trembles makes nothing creep.
    """
    limited = min(max(current, -drive[LIMIT]), drive[LIMIT])
    state[LIMITED] = 1.0 if limited != current else 0.0
    state[CURRENT] = limited
    per = dt / drive[INERTIA]
    free = state[SPEED] + per * (drive[TORQUE] * limited - state[GEAR])
    if drive[PRESLIDING] > 0.0 and bristle_holds(drive, state, dt, free):
        return
    side = 0 if free >= 0.0 else 1
    grip = drive[COULOMB + side] + drive[LOADED] * abs(state[GEAR])
    hold = grip
    if state[SPEED] == 0.0 and drive[PRESLIDING] <= 0.0:
        hold *= drive[BREAKAWAY]
    if abs(free) <= per * hold:
        state[SPEED] = 0.0
        return
    slower = max(abs(free) - per * grip, 0.0) / (1.0 + per * drive[VISCOUS + side])
    state[SPEED] = slower if free > 0.0 else -slower
    state[ANGLE] += dt * state[SPEED]


@compiled
def bristle_holds(drive: NDArray, state: NDArray, dt: float, free: float) -> bool:
    """
    Advance a rotor whose friction gives way but does not slide; False where it slides.

    Then the bristle is bent to its end in the direction of motion, ``state[BENT]`` is 1 or -1.
    """
    bent = state[BENT]
    side = 0 if bent > 0.0 or (bent == 0.0 and free >= 0.0) else 1
    grip = drive[COULOMB + side] + drive[LOADED] * abs(state[GEAR])
    per, most = dt / drive[INERTIA], drive[BREAKAWAY]
    if abs(bent) == 1.0 and bent * state[SPEED] > 0.0:
        most = 1.0  # it slides already
    speed = (free - per * grip * bent) / (
        1.0 + per * (drive[VISCOUS + side] + dt * grip / drive[PRESLIDING]))
    further = bent + dt * speed / drive[PRESLIDING]
    if abs(further) > most:
        state[BENT] = 1.0 if further > 0.0 else -1.0
        return False
    state[BENT], state[SPEED] = further, speed
    state[ANGLE] += dt * speed
    return True


@compiled
def gear_push(drive: NDArray, state: NDArray, dt: float, q: float, dq: float) -> float:
    """
    Give the other end of the gear's spring and damper as a torque on the link's joint.

    The link subtracts stiffness q + damping dq at the end of the step; in the play that leaves
    nothing but what the motion within one step makes.
    """
    ahead = q + dt * dq
    twist = state[ANGLE] - ahead
    if abs(twist) <= drive[PLAY]:
        return drive[STIFFNESS] * ahead + drive[DAMPING] * dq
    edge = drive[PLAY] if twist > 0.0 else -drive[PLAY]
    return drive[STIFFNESS] * (state[ANGLE] - edge) + drive[DAMPING] * state[SPEED]


@dataclass(frozen=True)
class Imperfections:
    """
    Which imperfections of drives and sensors are simulated.

    Attributes
    ----------
    friction, backlash, gear_compliance, current_limit : bool
        Of the drives.
    encoder, current_noise, current_ripple, current_resolution : bool
        Of their measurement: encoder counts; noise, ripple and resolution of the current.
    strain_noise, strain_offset, strain_resolution : bool
        Of the gauges.

    """

    friction: bool = True
    backlash: bool = True
    gear_compliance: bool = True
    current_limit: bool = True
    encoder: bool = True
    current_noise: bool = True
    current_ripple: bool = True
    current_resolution: bool = True
    strain_noise: bool = True
    strain_offset: bool = True
    strain_resolution: bool = True

    @classmethod
    def none(cls) -> Imperfections:
        """Switch all of them off."""
        return cls(**{field.name: False for field in fields(cls)})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Give their names."""
        return tuple(field.name for field in fields(cls))


def drive_row(motor: MotorSpec, dt: float, chosen: Imperfections) -> FloatArray:
    """Lay out the parameters of one motor: dt [s]; returns (PARAMETERS,)."""
    inertia, torque = motor.reflected_inertia, motor.joint_torque_constant
    if inertia <= 0.0:
        msg = (f'motor of joint {motor.joint!r}: rotor_inertia is 0; the simulated drive needs '
               'it, give it in motors')
        raise SimulationError(msg)
    # A rigid gear is as stiff as the step allows, well damped.
    stiffest = inertia * (RIGID / dt) ** 2
    stiffness, damping = motor.stiffness, motor.damping
    if stiffness is None or stiffness > stiffest or not chosen.gear_compliance:
        stiffness, damping = stiffest, 0.2 * math.sqrt(stiffest * inertia)
    friction = float(chosen.friction)
    limit = motor.current_limit if chosen.current_limit else None
    return np.array([
        torque, inertia, *(friction * torque * value for value in motor.viscous),
        *(friction * torque * value for value in motor.coulomb), motor.breakaway,
        math.inf if limit is None else limit, stiffness, damping,
        0.5 * motor.backlash if chosen.backlash else 0.0,
        friction * motor.load_friction, friction * motor.presliding])
