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

"""Simulated hardware: motors with gears, sensors, pushes, an elastic floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import InertiaPart, MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics import chain as at, settings
from tudor_dynamics.mechanics.chain import Chain, times, vector_at
from tudor_dynamics.mechanics.equations import add_to_sections, point_motion, put_force
from tudor_dynamics.mechanics.mechanism import Mechanism
from tudor_dynamics.mechanics.run import Probe
from tudor_dynamics.typing import FloatArray, Shown


# -- Current-controlled motor with gear: rotor, friction, elastic gear with backlash.
#
# Friction grows with the torque through the gear, gives way before it slides, and may grip more
# firmly at rest. All values are those seen at the joint. The rotor is advanced first, then the
# link with the torque of the gear at the end of the step: the gear's spring is a stiffness of the
# link's joint, the rotor's angle its other end, so that no gear is too stiff for the light end of
# a beam.

# Columns of the parameters of one joint.
TORQUE = 0  # per current [N m/A]
INERTIA = 1  # of the rotor [kg m^2]
VISCOUS = 2  # 2: for positive and negative motion [N m s/rad]
COULOMB = 4  # 2: for positive and negative motion [N m]
BREAKAWAY = 6  # friction at rest over Coulomb friction
LIMIT = 7  # of the current [A]
GEAR_STIFFNESS = 8  # of the gear [N m/rad]
DAMPING = 9  # of the gear [N m s/rad]
PLAY = 10  # half of the backlash [rad]
LOADED = 11  # friction per torque through the gear
PRESLIDING = 12  # how far friction gives way before it slides [rad]
PARAMETERS = 13
# Columns of the state of one joint; bristle is the deflection of friction over PRESLIDING.
ANGLE, SPEED, CURRENT, GEAR, LIMITED, BRISTLE = range(6)
STATES = 6


@compiled
def rotor_law(drive: NDArray, state: NDArray, dt: float, current: float) -> None:
    """Advance the rotor of one joint by a step [s] under a wanted current [A]."""
    # Friction is implicit: it takes the speed to zero where it can, and holds it there, or with
    # presliding it is an elastic bristle that yields at the grip of Coulomb friction (Dupont et
    # al., "Single state elastoplastic friction models", IEEE TAC 47(5), 2002, with a sharp
    # transition): elastic for good below it, so a load that trembles makes nothing creep.
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
    """Advance a rotor whose friction gives way but does not slide; False where it slides."""
    deflection = state[BRISTLE]
    side = 0 if deflection > 0.0 or (deflection == 0.0 and free >= 0.0) else 1
    grip = drive[COULOMB + side] + drive[LOADED] * abs(state[GEAR])
    per, most = dt / drive[INERTIA], drive[BREAKAWAY]
    if abs(deflection) == 1.0 and deflection * state[SPEED] > 0.0:
        most = 1.0  # it slides already
    speed = (free - per * grip * deflection) / (
        1.0 + per * (drive[VISCOUS + side] + dt * grip / drive[PRESLIDING]))
    further = deflection + dt * speed / drive[PRESLIDING]
    if abs(further) > most:
        state[BRISTLE] = 1.0 if further > 0.0 else -1.0  # deflected to its end
        return False
    state[BRISTLE], state[SPEED] = further, speed
    state[ANGLE] += dt * speed
    return True


@compiled
def gear_push(drive: NDArray, state: NDArray, dt: float, q: float, dq: float) -> float:
    """Give the other end of the gear's spring and damper as a torque on the link's joint."""
    # The link subtracts stiffness q + damping dq at the end of the step; in the play that leaves
    # nothing but what the motion within one step makes.
    ahead = q + dt * dq
    twist = state[ANGLE] - ahead
    if abs(twist) <= drive[PLAY]:
        return drive[GEAR_STIFFNESS] * ahead + drive[DAMPING] * dq
    edge = drive[PLAY] if twist > 0.0 else -drive[PLAY]
    return drive[GEAR_STIFFNESS] * (state[ANGLE] - edge) + drive[DAMPING] * state[SPEED]


@dataclass(frozen=True, repr=False)
class Imperfections(Shown):
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
        raise SimulationError(f'the rotor_inertia of joint {motor.joint!r} is 0; give its true '
                              'value under motors in the arm description')
    # A rigid gear is as stiff as the step allows, well damped.
    stiffest = inertia * (settings.RIGID_GEAR / dt) ** 2
    stiffness, damping = motor.stiffness, motor.damping
    if stiffness is None or stiffness > stiffest or not chosen.gear_compliance:
        stiffness = stiffest
        damping = settings.RIGID_GEAR_DAMPING * math.sqrt(stiffest * inertia)
    friction = float(chosen.friction)
    limit = motor.current_limit if chosen.current_limit else None
    return np.array([
        torque, inertia, *(friction * torque * value for value in motor.viscous),
        *(friction * torque * value for value in motor.coulomb), motor.breakaway,
        math.inf if limit is None else limit, stiffness, damping,
        0.5 * motor.backlash if chosen.backlash else 0.0,
        friction * motor.load_friction, friction * motor.presliding])


# -- What sensors make of the truth: counts, gain, offset, noise and resolution.
#
# Noise is drawn outside of compiled code, one row a step over all channels, whether a channel's
# noise is switched on or not: one seed gives each channel its own noise whatever the others do.

# Columns of the parameters of one encoder and current measurement.
COUNT, AT_MOTOR, CURRENT_NOISE, CURRENT_STEP, RIPPLE, TURNS, PHASE = range(7)
# Columns of the parameters of one gauge.
PER_MOMENT, PER_RATE, COLUMN, OFFSET, NOISE, RESOLUTION = range(6)
GAUGE = 6


@compiled
def stepped(value: float, resolution: float) -> float:
    """Round to whole steps; 0 for none."""
    return value if resolution <= 0.0 else resolution * math.floor(value / resolution + 0.5)


@compiled
def encoder_reading(sensor: NDArray, rotor: float, joint: float) -> float:
    """Give the angle that an encoder has counted [rad]."""
    value = rotor if sensor[AT_MOTOR] > 0.0 else joint
    count = sensor[COUNT]
    return value if count <= 0.0 else count * math.floor(value / count)


@compiled
def current_reading(sensor: NDArray, current: float, rotor: float, noise: float) -> float:
    """Give the measured current [A], the rotor's angle being that seen at the joint [rad]."""
    value = current + sensor[CURRENT_NOISE] * noise
    if sensor[RIPPLE] > 0.0:
        value += sensor[RIPPLE] * math.cos(sensor[TURNS] * rotor + sensor[PHASE])
    return stepped(value, sensor[CURRENT_STEP])


@compiled
def gauge_reading(gauge: NDArray, loads: NDArray, noise: float) -> float:
    """Give the reading of a gauge from the loads at its section."""
    axis = int(gauge[COLUMN])
    value = gauge[PER_MOMENT] * loads[3 + axis] + gauge[PER_RATE] * loads[6 + axis]
    return stepped(value + gauge[OFFSET] + gauge[NOISE] * noise, gauge[RESOLUTION])


def drive_sensor_row(motor: MotorSpec, chosen: Imperfections) -> FloatArray:
    """Lay out encoder and current measurement of one motor; returns (7,)."""
    return np.array([
        motor.encoder_resolution if chosen.encoder else 0.0,
        1.0 if motor.encoder_on == 'motor' else 0.0,
        motor.current_noise if chosen.current_noise else 0.0,
        motor.current_resolution if chosen.current_resolution else 0.0,
        motor.current_ripple if chosen.current_ripple else 0.0, motor.gear_ratio,
        motor.current_ripple_phase])


def gauge_rows(arm: Arm, probe: Probe, chosen: Imperfections) -> FloatArray:
    """Lay out the gauges of an arm (gauges, GAUGE); ideal without an entry in ``sensors``."""
    sensors = {sensor.gauge: sensor for sensor in arm.spec.sensors}
    rows = np.zeros((len(arm.gauges), GAUGE))
    for row, gauge, ideal in zip(rows, arm.gauges, probe.gains, strict=True):
        row[[PER_MOMENT, PER_RATE, COLUMN]] = ideal
        sensor = sensors.get(gauge.name)
        if sensor is not None:
            scale = sensor.gain / abs(ideal[0])
            row[[PER_MOMENT, PER_RATE]] *= scale
            row[OFFSET] = sensor.offset if chosen.strain_offset else 0.0
            row[NOISE] = sensor.noise if chosen.strain_noise else 0.0
            row[RESOLUTION] = sensor.resolution if chosen.strain_resolution else 0.0
    return rows


# -- An elastic floor below the tip, with which the arm is in contact step by step

HEIGHT, FLOOR_STIFFNESS, FLOOR_BODY, NODE, POINT = range(5)
FLOOR = 5


@dataclass(frozen=True)
class Floor:
    """An elastic floor below the tip, without friction."""

    height: float  # in the base frame [m]
    stiffness: float  # force per penetration [N/m]


def floor_row(floor: Floor | None, mechanism: Mechanism) -> FloatArray:
    """Lay a floor out for compiled code; floor: none presses nowhere; returns (FLOOR,)."""
    body = mechanism.body_at(mechanism.tip)
    node = mechanism.tip - mechanism.body_int[body, at.POINT]
    height, stiffness = (0.0, 0.0) if floor is None else (floor.height, floor.stiffness)
    return np.array([height, stiffness, body, node, mechanism.tip])


@compiled
def press(floor: NDArray, z: NDArray, dz: NDArray, chain: Chain, dt: float) -> bool:
    """Add the force of the floor to the wrench of the tip: floor (FLOOR,), z, dz (n,), dt [s]."""
    if floor[FLOOR_STIFFNESS] <= 0.0:
        return False
    place, velocity = point_motion(z, dz, chain, int(floor[FLOOR_BODY]), int(floor[NODE]))
    depth = floor[HEIGHT] - place[2] - dt * velocity[2]
    if depth <= 0.0:
        return False
    chain.wrench[int(floor[POINT]), 2] += floor[FLOOR_STIFFNESS] * depth
    return True


# -- Pushes: forces on any link at any place, for a while

# Columns of a table of pushes.
TIME, DURATION, RISE, PUSHED_BODY, DISTANCE = range(5)
FORCE = 5  # 3: base frame [N]
PUSH = 8


@dataclass(frozen=True, repr=False)
class Push(Shown):
    """
    A force on a link.

    Attributes
    ----------
    time, duration : float
        Begin and length [s].
    joint : str
        Joint that moves the link.
    distance : float
        From the start of the link's beam [m].
    force : tuple of float
        Greatest force, in the base frame [N].
    rise : float
        Time in which it comes and goes, along a sin^2 [s].

    """

    time: float
    duration: float
    joint: str
    distance: float
    force: tuple[float, float, float]
    rise: float = 0.05


@compiled
def push_share(row: NDArray, t: float) -> float:
    """Give the part of its greatest force with which a push acts at a time [s]."""
    since = t - row[TIME]
    left = row[DURATION] - since
    if since <= 0.0 or left <= 0.0:
        return 0.0
    nearest = min(since, left)
    if nearest >= row[RISE]:
        return 1.0
    return math.sin(0.5 * math.pi * nearest / row[RISE]) ** 2


@compiled
def put_pushes(table: NDArray, t: float, chain: Chain) -> bool:
    """Add the pushes at a time [s] to the nodes; a place between nodes loads both neighbours."""
    acting = False
    for i in range(table.shape[0]):
        row = table[i]
        share = push_share(row, t)
        if share == 0.0:
            continue
        acting = True
        put_force(chain, int(row[PUSHED_BODY]), row[DISTANCE], times(share, vector_at(row, FORCE)))
    return acting


@compiled
def add_pushes_to_sections(
    table: NDArray, t: float, chain: Chain, bodies: NDArray, places: NDArray, loads: NDArray,
) -> None:
    """Correct ``section_loads`` where pushes stand on the element of a section."""
    for i in range(table.shape[0]):
        row = table[i]
        share = push_share(row, t)
        if share != 0.0:
            add_to_sections(chain, bodies, places, int(row[PUSHED_BODY]), row[DISTANCE],
                            times(share, vector_at(row, FORCE)), loads)


def push_table(pushes: Sequence[Push], mechanism: Mechanism) -> FloatArray:
    """Lay pushes out for compiled code; returns (pushes, PUSH)."""
    table = np.zeros((len(pushes), PUSH))
    for row, push in zip(table, pushes, strict=True):
        if push.joint not in mechanism.body_of:
            raise SimulationError(f'joint {push.joint!r} has no link to push; choose one of '
                                  f'{list(mechanism.body_of)}')
        body = mechanism.body_of[push.joint]
        length = mechanism.length(push.joint)
        if not 0.0 <= push.distance <= length + 1e-9:
            raise SimulationError(f'a push at {push.distance:g} m lies outside the link of '
                                  f'{push.joint!r}; choose a place from 0 to {length:g} m')
        values = (push.time, push.duration, push.rise, *push.force)
        if not np.isfinite(values).all() or push.duration <= 0.0 or push.rise < 0.0:
            raise SimulationError(f'{push}: give finite times and forces, and a duration above 0')
        row[:] = (push.time, push.duration, min(push.rise, 0.5 * push.duration), body,
                  push.distance, *push.force)
    return table


def with_payload(arm: Arm, mass: float) -> Arm:
    """
    Put a mass at the tip of an arm; 0 takes it away.

    Parameters
    ----------
    arm : Arm
        Arm with any payload, or none.
    mass : float
        Mass at the tip [kg].

    Raises
    ------
    SimulationError
        If the mass is negative or not finite.

    """
    if not (math.isfinite(mass) and mass >= 0.0):
        raise SimulationError(f'payload= {mass:g} kg: give 0 or more')
    return arm.changed(payload=InertiaPart(mass=mass) if mass > 0.0 else None)
