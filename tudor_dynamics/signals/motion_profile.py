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
Online planner of sin^2 motions: a new target at any time, no step in the acceleration.

Each change of speed is one pulse of acceleration a sin^2(pi t/T), so that the jerk is bounded and
little of the motion lies at the eigenfrequencies of an elastic link: two pulses and a stretch of
constant speed between them make a move. A target that arrives inside a pulse either lets it go on
to its end or lets the acceleration fade out along a cosine squared first, whatever is sooner
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.motion_law import (
    CLOCK, FIRST, follow_all, follow_plan, PLAN, plan_motion, Q, stopping_distance, TARGET)
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference motion, sample by sample."""

    dt: float  # sample time [s]
    # Positions, speeds and accelerations wanted, (samples, joints) [rad, rad/s, rad/s^2].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    @property
    def motion(self) -> FloatArray:
        """All of it side by side, as regressors take it."""
        return np.hstack([self.q, self.dq, self.ddq])


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits of the planned motion of each joint: [rad/s] and [rad/s^2]."""

    velocity: FloatArray  # largest planned speed of each joint, (joints,) [rad/s]
    acceleration: FloatArray  # largest planned acceleration of each joint, (joints,) [rad/s^2]


def motion_limits(arm: Arm) -> MotionLimits:
    """
    Take what is planned for the active joints from an arm description.

    Parameters
    ----------
    arm : Arm
        Description; see ``arm.limits``.

    Returns
    -------
    MotionLimits
        One value a joint.

    Raises
    ------
    SignalError
        If a joint has no limit of speed or acceleration.

    """
    planned = planned_limits(arm)
    for joint, velocity, acceleration in zip(arm.joints, planned.velocity, planned.acceleration,
                                             strict=True):
        if not (np.isfinite(velocity) and np.isfinite(acceleration)):
            msg = (f'{arm.source}: joint {joint.name!r} has no limits of velocity and '
                   'acceleration, without which no motion can be planned; add '
                   'limits: {velocity: ..., acceleration: ...}')
            raise SignalError(msg)
    return MotionLimits(planned.velocity, planned.acceleration)


class MotionPlanner:
    """
    Reference of several joints, step by step.

    Parameters
    ----------
    limits : MotionLimits
        One value a joint.
    q : array of shape (n_joints,)
        Where the joints rest at the start [rad].

    """

    def __init__(self, limits: MotionLimits, q: ArrayLike) -> None:
        self.limits = limits
        self.q = np.array(q, dtype=float)
        self.dq, self.ddq = np.zeros_like(self.q), np.zeros_like(self.q)
        self._plans = np.zeros((self.q.size, PLAN))
        self.go(self.q)

    def go(self, target: ArrayLike) -> None:
        """
        Take a new target, also in the middle of a motion.

        Parameters
        ----------
        target : array of shape (n_joints,)
            [rad]; a joint whose target is not a number keeps the one it has.

        """
        wanted = np.broadcast_to(np.asarray(target, dtype=float), self.q.shape)
        if np.isinf(wanted).any():
            msg = f'the target {wanted.tolist()} is not finite; give angles in rad'
            raise SignalError(msg)
        for j, plan in enumerate(self._plans):
            if not np.isnan(wanted[j]):
                plan_motion(plan, self.q[j], self.dq[j], self.ddq[j], float(wanted[j]),
                            float(self.limits.velocity[j]), float(self.limits.acceleration[j]))

    def move(self, q: ArrayLike, dq: ArrayLike) -> None:
        """
        Go on from other positions [rad] and speeds [rad/s], without a target.

        Parameters
        ----------
        q : array of shape (n_joints,)
            Positions to go on from [rad].
        dq : array of shape (n_joints,)
            Speeds to go on from [rad/s].

        """
        self.q[:], self.dq[:], self.ddq[:] = q, dq, 0.0
        self._plans[:] = 0.0
        self._plans[:, Q] = self._plans[:, TARGET] = self.q

    def brake(self) -> None:
        """Come to rest by one pulse of the planned acceleration a joint, from this moment on."""
        self.move(self.q, self.dq)
        self.go([q + stopping_distance(float(dq), float(a)) for q, dq, a in zip(
            self.q, self.dq, self.limits.acceleration, strict=True)])

    def step(self, dt: float) -> None:
        """
        Advance ``q``, ``dq`` and ``ddq`` by a step [s].

        Parameters
        ----------
        dt : float
            Time since the step before [s].

        """
        for j, plan in enumerate(self._plans):
            self.q[j], self.dq[j], self.ddq[j] = follow_plan(plan, dt)

    @property
    def remaining(self) -> float:
        """Time until all joints rest at their targets [s]."""
        lengths = self._plans[:, FIRST::4].sum(axis=1) - self._plans[:, CLOCK]
        return float(max(lengths.max(initial=0.0), 0.0))


def follow_targets(
    start: ArrayLike, switches: Sequence[FloatArray], targets: Sequence[FloatArray],
    limits: MotionLimits, dt: float, samples: int,
) -> Reference:
    """
    Plan through targets that come one after the other, each joint for itself.

    Parameters
    ----------
    start : array of shape (n_joints,)
        Where the joints rest at the start [rad].
    switches, targets : sequence of ndarray
        For each joint, times [s] at which it gets a target [rad].
    limits : MotionLimits
        One value a joint.
    dt : float
        Sample time [s].
    samples : int
        Number of samples.

    Returns
    -------
    Reference
        Motion.

    """
    count = max([len(item) for item in switches], default=0)
    padded = np.full((2, len(switches), max(count, 1)), np.inf)
    for j, (times, values) in enumerate(zip(switches, targets, strict=True)):
        padded[0, j, :len(times)], padded[1, j, :len(values)] = times, values
    q, dq, ddq = (np.zeros((samples, len(switches))) for _ in range(3))
    q[0] = start
    follow_all(padded[0], padded[1], limits.velocity, limits.acceleration, dt, q, dq, ddq)
    return Reference(dt, q, dq, ddq)
