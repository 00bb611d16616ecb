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

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import DriveStop, Limits, unlimited
from tudor_dynamics.arm.schema import DamperSpec, MotorSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control.guards import Envelope
from tudor_dynamics.errors import ArmError
from tudor_dynamics.typing import FloatArray

# Columns of the gains of one joint.
POSITION_GAIN = 0  # speed per position error [1/s]
VELOCITY_GAIN = 1  # current per speed error [A s/rad]
INTEGRAL_GAIN = 2  # current per integrated speed error [A/rad]
CURRENT_LIMIT = 3  # [A]
GAINS = 4
# Columns of the state of one joint.
INTEGRAL = 0  # share of the integrator in the current [A]
SATURATED = 1  # 1 while the current is at its limit
STATES = 2

INTEGRAL_SHARE = 0.2
"""Corner of the integrator over the bandwidth: costs atan(0.2) = 11 deg of phase there."""


@compiled
def position_law(
    gains: NDArray, q_ref: float, dq_ref: float, q: float, yielding: float,
) -> float:
    """
    Give the speed that the position loop of one joint wants.

    gains (GAINS,), q_ref, dq_ref [rad, rad/s], q [rad], yielding [rad/s]; returns speed, to be
    bounded by the envelope [rad/s].
    """
    return dq_ref + gains[POSITION_GAIN] * (q_ref - q) + yielding


@compiled
def velocity_law(
    gains: NDArray, state: NDArray, dt: float, speed: float, dq: float, ahead: float,
) -> float:
    """
    Give the current of one joint.

    gains, state (GAINS,), dt [s], speed, dq [rad/s], ahead [A]; returns current [A].
    """
    error = speed - dq
    current = gains[VELOCITY_GAIN] * error + state[INTEGRAL] + ahead
    limit = gains[CURRENT_LIMIT]
    bounded = min(max(current, -limit), limit)
    # Anti-windup: the integrator stands still unless it leads back from the limit.
    if bounded == current or (error > 0.0) != (current > 0.0):
        state[INTEGRAL] += gains[INTEGRAL_GAIN] * dt * error
        state[INTEGRAL] = min(max(state[INTEGRAL], -limit), limit)
    state[SATURATED] = 1.0 if bounded != current else 0.0
    return bounded


@dataclass(frozen=True)
class JointGains:
    """Gains of one joint."""

    # Speed per position error [1/s]; at most 0.3 times the first eigenfrequency in rad/s, or the
    # position loop undoes the damping.
    position: float
    velocity: float  # current per speed error [A s/rad]
    integral: float  # current per integrated speed error [A/rad]
    current_limit: float = math.inf  # largest current of the drive [A]

    @property
    def row(self) -> FloatArray:
        """Gains in the order of the columns."""
        return np.array([self.position, self.velocity, self.integral, self.current_limit])


def motor_gains(motor: MotorSpec, damper: DamperSpec) -> JointGains:
    """
    Tune the cascade of one joint by its motor.

    The velocity loop sees the rotor alone, because the elastic link follows far below its
    bandwidth w: K = J w / k_t, and the integrator has its corner at a fifth of w.
    """
    if motor.reflected_inertia <= 0.0:
        msg = (f'motor of joint {motor.joint!r}: rotor_inertia is 0, so that the velocity loop '
               'cannot be tuned; give it in motors')
        raise ArmError(msg)
    bandwidth = 2.0 * math.pi * damper.velocity_bandwidth
    gain = motor.reflected_inertia * bandwidth / motor.joint_torque_constant
    return JointGains(
        damper.position_gain, gain, INTEGRAL_SHARE * bandwidth * gain,
        motor.current_limit or math.inf)


def arm_gains(arm: Arm) -> list[JointGains]:
    """Tune the cascade of an arm's active joints."""
    if arm.spec.damper is None:
        msg = (f'{arm.source}: there is no damper, which has position_gain and '
               'velocity_bandwidth of the joint cascade; add damper:')
        raise ArmError(msg)
    motors = {motor.joint: motor for motor in arm.spec.motors}
    result = []
    for joint in arm.joints:
        if joint.name not in motors:
            msg = f'{arm.source}: joint {joint.name!r} has no entry in motors; add one'
            raise ArmError(msg)
        result.append(motor_gains(motors[joint.name], arm.spec.damper))
    return result


def velocity_lag(damper: DamperSpec) -> float:
    """Give the time from a commanded speed until the joint has most of it [s]."""
    return 1.0 / (2.0 * math.pi * damper.velocity_bandwidth)


class Cascade:
    """Cascade of several joints, step by step: dt, lag [s]."""

    def __init__(self, gains: list[JointGains], dt: float, limits: Limits | None = None,
                 lag: float = 0.0, stop: DriveStop | None = None) -> None:
        self.gains = np.array([item.row for item in gains]).reshape(-1, GAINS)
        self.state = np.zeros((len(gains), STATES))
        self.envelope = Envelope(limits or unlimited(len(gains)), lag + 2.0 * dt, stop)
        self.dt = dt

    def reset(self, current: ArrayLike = 0.0) -> None:
        """Start anew with integrators that give a current [A]."""
        self.state[:] = 0.0
        self.state[:, INTEGRAL] = current
        self.envelope.reset()

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Which joints had current, speed or position at a limit in the last step."""
        return np.asarray((self.state[:, SATURATED] > 0.0) | self.envelope.saturated)

    def step(
        self, q_ref: ArrayLike, dq_ref: ArrayLike, q: ArrayLike, dq: ArrayLike,
        yielding: ArrayLike = 0.0, ahead: ArrayLike = 0.0,
    ) -> FloatArray:
        """
        Give the currents for one step.

        q_ref, dq_ref, q, dq (joints,) [rad, rad/s], yielding (joints,) [rad/s], ahead (joints,)
        [A]; returns (joints,) [A].
        """
        count = len(self.gains)
        q_ref, dq_ref, q, dq, yielding, ahead = (
            np.broadcast_to(np.asarray(item, dtype=float), count)
            for item in (q_ref, dq_ref, q, dq, yielding, ahead))
        wanted = [position_law(self.gains[j], float(q_ref[j]), float(dq_ref[j]), float(q[j]),
                               float(yielding[j])) for j in range(count)]
        speed = self.envelope.step(self.dt, wanted, q)
        return np.array([velocity_law(self.gains[j], self.state[j], self.dt, float(speed[j]),
                                      float(dq[j]), float(ahead[j])) for j in range(count)])
