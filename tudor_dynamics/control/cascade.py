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
Joint cascade: P position control with velocity feed-forward around PI velocity control.

Between the two stands the motion envelope, so that no speed is asked for beyond a joint's limits.

One compiled law serves the controller of a real arm, step by step, and the simulated one, inside a
compiled loop.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import DriveStop, Limits, unlimited
from tudor_dynamics.arm.schema import DamperSpec, MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.errors import ArmError
from tudor_dynamics.typing import FloatArray

# Envelope: columns of the limits of one joint.
LOWER, UPPER = 0, 1  # position [rad]
SPEED = 2  # [rad/s]
ACCELERATION = 3  # [rad/s^2]
BRAKE = 4  # with which the joint stops before a position limit [rad/s^2]
TIME = 5  # for which it goes on as fast before that [s]
ROW = 6
# Columns of its state.
COMMAND = 0  # last command [rad/s]
CUT = 1  # what cut the last command: sum of the following
ENVELOPE_STATES = 2
BY_SPEED, BY_POSITION, BY_ACCELERATION = 1, 2, 4
SATURATING = BY_SPEED + BY_POSITION  # a command that only takes longer is none the less obeyed


@compiled
def approach_speed(way: float, acceleration: float, time: float) -> float:
    """Give the fastest speed from which a joint stops in a way [rad], after a time [s] of it."""
    if way <= 0.0:
        return 0.0
    if math.isinf(way) or math.isinf(acceleration):
        return math.inf if time == 0.0 else way / time
    reach = acceleration * time
    return math.sqrt(reach * reach + 2.0 * acceleration * way) - reach


@compiled
def envelope_law(row: NDArray, state: NDArray, dt: float, wanted: float, q: float) -> float:
    """Give the speed nearest to the wanted one that keeps a joint within its limits."""
    limit = settings.COMMANDED_SPEED * row[SPEED]
    speed = min(max(wanted, -limit), limit)
    cut = 0
    if speed != wanted:
        cut += BY_SPEED
    bounded = min(max(speed, -approach_speed(q - row[LOWER], row[BRAKE], row[TIME])),
                  approach_speed(row[UPPER] - q, row[BRAKE], row[TIME]))
    if bounded != speed:
        cut += BY_POSITION
    speed = bounded
    if not math.isinf(row[ACCELERATION]):  # no time times no limit is no number
        change = row[ACCELERATION] * dt
        speed = min(max(bounded, state[COMMAND] - change), state[COMMAND] + change)
    if speed != bounded:
        cut += BY_ACCELERATION
    state[COMMAND], state[CUT] = speed, cut
    return speed


class Envelope:
    """Envelope of several joints, step by step; lag [s]: from a command to its motion."""

    def __init__(self, limits: Limits, lag: float, stop: DriveStop | None = None) -> None:
        joints = len(limits.lower)
        self._timeout = 0.0 if stop is None else stop.timeout
        margin = np.where(np.isfinite(limits.velocity),
                          settings.POSITION_MARGIN * limits.velocity, 0.0)
        brake = settings.BRAKING_SHARE * limits.acceleration
        self.rows = np.zeros((joints, ROW))
        self.rows[:, LOWER], self.rows[:, UPPER] = limits.lower + margin, limits.upper - margin
        self.rows[:, SPEED], self.rows[:, ACCELERATION] = limits.velocity, limits.acceleration
        self.rows[:, BRAKE] = brake if stop is None else np.minimum(brake, stop.acceleration)
        self.state = np.zeros((joints, ENVELOPE_STATES))
        self.lag = lag
        self._take_lag()
        self.begin(0.0)

    @property
    def command(self) -> FloatArray:
        """Last command [rad/s]."""
        return np.asarray(self.state[:, COMMAND].copy())

    @property
    def cuts(self) -> NDArray[np.intp]:
        """Say what cut the last command of each joint, see `envelope_law`, (joints,)."""
        return self.state[:, CUT].astype(np.intp)

    def _take_lag(self) -> None:
        self.rows[:, TIME] = max(settings.APPROACH_TIME * self.lag, self.lag + self._timeout)

    def begin(self, command: ArrayLike) -> None:
        """Restart at the speeds that the joints have: command (joints,) [rad/s]."""
        self.state[:] = 0.0
        self.state[:, COMMAND] = command

    def step(self, dt: float, wanted: ArrayLike, q: ArrayLike) -> FloatArray:
        """Bound the wanted speeds, (joints,)."""
        self._take_lag()
        wanted, q = np.asarray(wanted, dtype=float), np.asarray(q, dtype=float)
        return np.array([envelope_law(self.rows[j], self.state[j], dt, float(wanted[j]),
                                      float(q[j])) for j in range(len(self.rows))])


# Cascade: columns of the gains of one joint, see `JointGains`.
POSITION_GAIN, VELOCITY_GAIN, INTEGRAL_GAIN, CURRENT_LIMIT = range(4)
# Columns of the state of one joint.
INTEGRAL = 0  # share of the integrator in the current [A]
SATURATED = 1  # 1 while the current is at its limit
STATES = 2


@compiled
def position_law(row: NDArray, q_ref: float, dq_ref: float, q: float, yielding: float) -> float:
    """Give the speed that the position loop of a joint wants, for the envelope to bound."""
    return dq_ref + row[POSITION_GAIN] * (q_ref - q) + yielding


@compiled
def velocity_law(
    row: NDArray, state: NDArray, dt: float, speed: float, dq: float, ahead: float,
) -> float:
    """Give the current [A] of one joint; ahead [A]: what is fed forward."""
    error = speed - dq
    current = row[VELOCITY_GAIN] * error + state[INTEGRAL] + ahead
    limit = row[CURRENT_LIMIT]
    bounded = min(max(current, -limit), limit)
    # Anti-windup: the integrator stands still unless it leads back from the limit.
    if bounded == current or (error > 0.0) != (current > 0.0):
        state[INTEGRAL] += row[INTEGRAL_GAIN] * dt * error
        state[INTEGRAL] = min(max(state[INTEGRAL], -limit), limit)
    state[SATURATED] = 1.0 if bounded != current else 0.0
    return bounded


class JointGains(NamedTuple):
    """Gains of one joint, in the order of the columns."""

    # Speed per position error [1/s]; at most 0.3 times the first eigenfrequency in rad/s, or the
    # position loop undoes the damping.
    position: float
    velocity: float  # current per speed error [A s/rad]
    integral: float  # current per integrated speed error [A/rad]
    current_limit: float = math.inf  # largest current of the drive [A]


def motor_gains(motor: MotorSpec, damper: DamperSpec) -> JointGains:
    """Tune the cascade of one joint by its motor."""
    # The velocity loop sees the rotor alone, because the elastic link follows far below its
    # bandwidth w: K = J w / k_t, and the integrator has its corner at a fifth of w.
    if motor.reflected_inertia <= 0.0:
        raise ArmError(f'joint {motor.joint!r}: no velocity loop can be tuned for a rotor_inertia '
                       'of 0; set it [kg m^2] in motors: of the arm description')
    bandwidth = 2.0 * math.pi * damper.velocity_bandwidth
    gain = motor.reflected_inertia * bandwidth / motor.joint_torque_constant
    return JointGains(
        damper.position_gain, gain, settings.INTEGRAL_SHARE * bandwidth * gain,
        motor.current_limit or math.inf)


def arm_gains(arm: Arm) -> list[JointGains]:
    """Tune the cascade of an arm's active joints."""
    damper = arm.damper
    motors = {motor.joint: motor for motor in arm.spec.motors}
    for joint in arm.joints:
        if joint.name not in motors:
            raise ArmError(f'{arm.source}: joint {joint.name!r} has no motor; add it to motors: '
                           'with gear_ratio, torque_constant and rotor_inertia')
    return [motor_gains(motors[joint.name], damper) for joint in arm.joints]


def velocity_lag(damper: DamperSpec) -> float:
    """Give the time from a commanded speed until the joint has most of it [s]."""
    return 1.0 / (2.0 * math.pi * damper.velocity_bandwidth)


class Cascade:
    """Gains, state and envelope of several joints, for the laws above: dt, lag [s]."""

    def __init__(self, gains: list[JointGains], dt: float, limits: Limits | None = None,
                 lag: float = 0.0, stop: DriveStop | None = None) -> None:
        self.rows = np.array(gains).reshape(-1, 4)
        self.state = np.zeros((len(gains), STATES))
        self.envelope = Envelope(limits or unlimited(len(gains)), lag + 2.0 * dt, stop)

    def reset(self, current: ArrayLike = 0.0) -> None:
        """Restart with integrators that give a current [A]."""
        self.state[:] = 0.0
        self.state[:, INTEGRAL] = current
        self.envelope.begin(0.0)
