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

"""Who commands the joints: follows a reference, holds, or stands still, within limits."""

from __future__ import annotations

from collections import Counter
from enum import IntEnum
import math

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import drive_stop, hard_limits
from tudor_dynamics.control.damper import arm_damping, Damper, moving_share
from tudor_dynamics.control.gains import Adaptation, learned_period, LoopGains
from tudor_dynamics.control.guards import (
    EncoderWatch, Envelope, Following, NEAR_TIME, ReferenceGate, Takeover)
from tudor_dynamics.errors import ArmError
from tudor_dynamics.signals.motion_profile import motion_limits, MotionPlanner
from tudor_dynamics.typing import FloatArray


# -- What the joints of a controlled arm do

class State(IntEnum):
    """What the joints do, and why not more."""

    HOLDING = 0
    """They stand, or brake to where they will: there is no reference that may be followed."""
    FOLLOWING = 1
    """They follow the reference."""
    FAULT = 2
    """They stand until they are told to begin anew: encoders cannot be believed."""


# -- Who commands the joints: follows a reference, holds the arm, or stands still, never beyond
#    limits.
#
# ``dq_ref + K_p (q_ref - q) + damper``, through the motion envelope. All times are handed in, so
# that a robot and a simulated clock see the same object.

WATCH = 0.01
"""Period at which `MotionController.watch` wants to be called [s]."""
ASLEEP = 0.1
"""Without a command for so long beyond the timeout, drives have stopped by themselves [s]."""


class MotionController:
    """
    Velocity commands from reference, positions and strains.

    It begins by holding the arm where it is, and follows a reference once that rests near the arm.
    After any interruption it does so again: it brakes as planned motion does and holds where it
    stopped. Encoders that cannot be believed are a fault: it stands still until ``reset``.

    timeout, period [s].
    """

    def __init__(self, arm: Arm, share: float = 1.0, timeout: float = 0.1) -> None:
        if arm.spec.damper is None:
            msg = f'{arm.source}: there is no damper; add damper: with the gains of its joints'
            raise ArmError(msg)
        self.joints, self.gauges = arm.active_joints, arm.gauge_names
        self.limits = hard_limits(arm)
        self.planned = motion_limits(arm)
        self.timeout = timeout
        self.damper = Damper([item for item in arm_damping(arm) if item.joint in self.joints],
                             1.0 / arm.spec.damper.rate)
        self.gains = LoopGains(arm.spec.damper, self.limits.velocity, share)
        self.adaptation: Adaptation | None = None
        self.envelope = Envelope(self.limits, self.gains.response_time(0.0), drive_stop(arm))
        self.encoders = EncoderWatch(self.limits)
        self.reference = ReferenceGate(self.joints, self.limits)
        self._following = Following(self.joints, self.planned.velocity, self.reference)
        self._takeover = Takeover(self.planned.acceleration)
        self._to = [self.joints.index(name) for name in self.damper.joints]
        self._from = [self.gauges.index(name) for name in self.damper.gauges]
        self._hold = MotionPlanner(self.planned, np.zeros(len(self.joints)))
        self._q: FloatArray | None = None
        self._clock = 0.0
        self._at = -math.inf
        self._gave = -math.inf  # when the last command was given
        self._unknown = True  # the speed of the arm
        self._blind = False  # commands are given without positions
        self.period = 0.0
        self.takeovers = 0
        self.cuts: Counter[str] = Counter()
        self.state, self.cause = State.HOLDING, 'no reference yet'

    def reset(self) -> None:
        """Leave a fault and begin anew: hold, and fade the damper in."""
        self.state, self.cause = State.HOLDING, 'no reference yet'
        self._q = None
        self.reference.reset()
        self.gains.reset()
        self.damper.reset()
        if self.adaptation is not None:
            self.adaptation.reset()

    @property
    def unreferenced(self) -> bool:
        """Whether there was a reference, and comes no more."""
        return self.reference.known and self.reference.age(self._at) > self.timeout

    @property
    def missing(self) -> bool:
        """Whether positions fail to come, and commands are given without them."""
        return self._blind

    def step(
        self, now: float, dt: float, q: FloatArray, strain: FloatArray, fresh: FloatArray,
    ) -> FloatArray | None:
        """
        Give the commands for one sample.

        now [s], q (joints,) [rad or m], strain, fresh (gauges,); dt [s]: 0 where nothing before it
        counts; returns (joints,) [rad/s or m/s], None until it is known how fast the arm is.
        """
        self._at = now
        self.period = self.period or max(dt, 0.0)
        if self._q is None or dt <= 0.0 or dt > self._patience or (
                not self._unknown and self._slept(now)):
            self._take_first(now, q)
            return None
        dq = (q - self._q) / dt
        self.period = learned_period(self.period, dt)
        self._q = q.copy()
        self._clock += dt  # stamps alone: a simulated arm may be slower than this machine
        delay = self.gains.delay
        doubts = self.encoders.step(
            dt, q, delay.commanded(self._clock, self.gains.assumed_delay))
        if self._unknown:
            if not (doubts or self._takeover.step(self._clock, dq, self.gains.assumed_delay)):
                return None
            self.takeovers += 1
            self._begin(now, q, np.zeros_like(dq) if doubts else dq)
        if doubts and self.state is not State.FAULT:
            self._fault('; '.join(f'{self.joints[j]}: {text}' for j, text in doubts))
        delay.add_motion(self._clock, dt, dq)
        self._hold.step(dt)
        self._choose(now, q)
        command = self._command(now, dt, q, strain, fresh)
        delay.add_command(self._clock, command)
        self._gave = now
        return command

    def watch(self, now: float) -> FloatArray | None:
        """
        Give commands where positions fail to come; to be called every `WATCH` seconds.

        now [s]; returns (joints,) [rad/s or m/s], None while positions come.
        """
        if self._q is None or now - self._at <= self._patience:
            return None
        return self._brake(now, 'no positions come')

    def stand_still(self, now: float) -> FloatArray | None:
        """
        Brake without looking at positions, as `watch` does; None once the joints stand.

        now [s].
        """
        if self._q is None or not self.envelope.command.any():
            return None
        return self._brake(now, 'told to stand still')

    def _brake(self, now: float, cause: str) -> FloatArray | None:
        """Give a command of braking blindly; the arm is where it was told to go."""
        if self._slept(now):  # whoever drives the joints has stopped them meanwhile
            self._q = None
            return None
        if not self._blind:
            self._interrupt(now, cause)
            self._blind = True
        waited = now - self._gave
        self._gave = now
        self._hold.step(waited)
        self.gains.begin()
        return self.envelope.step(min(waited, WATCH), self._hold.dq, self._hold.q)

    def _slept(self, now: float) -> bool:
        """Say whether drives have stopped by themselves."""
        return now - self._gave > self._patience + ASLEEP

    @property
    def _patience(self) -> float:
        """Longest time between samples that is no interruption [s]."""
        return max(self.timeout, 3.0 * self.period)

    def _take_first(self, now: float, q: FloatArray) -> None:
        """Take a sample before which nothing counts: the next one tells how fast the arm is."""
        if self._slept(now) or not self._blind:
            self._unknown = True
            self._takeover.reset()
        self._q = q.copy()
        self.encoders.reset()
        self.encoders.step(0.0, q, np.zeros_like(q))
        self.gains.begin()
        self.damper.reset()
        if self.adaptation is not None:
            self.adaptation.forget()
        if not self._unknown:  # it was commanded all the time, only not seen
            self._begin(now, q, self.envelope.command)
        if self.state is State.FOLLOWING:
            self.state, self.cause = State.HOLDING, 'positions were interrupted'

    def _begin(self, now: float, q: FloatArray, dq: FloatArray) -> None:
        """Brake from a known motion, and hold where that ends."""
        self._unknown = self._blind = False
        self._gave = now
        self.envelope.begin(np.clip(dq, -self.limits.velocity, self.limits.velocity))
        self._hold.move(q, self.envelope.command)
        self._hold.brake()

    def _choose(self, now: float, q: FloatArray) -> None:
        """Follow, or hold, by what the reference is now."""
        reference = self.reference
        if self.state is State.FAULT or not reference.known:
            if reference.refusal and self.state is State.HOLDING:
                self.cause = reference.refusal
            return
        if self.state is State.FOLLOWING:
            cause = self._following.stray(now, self.timeout, q)
            if cause:
                self._interrupt(now, cause)
            return
        self.cause = self._following.obstacle(now, self.timeout, q, self._hold.dq)
        if not self.cause:
            self.state, self.cause = State.FOLLOWING, 'follows the reference'

    def _interrupt(self, now: float, cause: str) -> None:
        """Brake from the motion that is in force, and hold where that ends."""
        reference = self.reference
        if self.state is State.FOLLOWING:
            place = np.clip(reference.place(now, self.timeout), self.limits.lower,
                            self.limits.upper)
            if self._q is not None:  # what the arm is away is not made up for behind a stop
                near = NEAR_TIME * self.planned.velocity
                place = np.clip(place, self._q - near, self._q + near)
            self._hold.move(place, reference.dq)
            self._hold.brake()
        if self.state is not State.FAULT:
            self.state, self.cause = State.HOLDING, cause

    def _fault(self, cause: str) -> None:
        self._hold.move(self._hold.q, self.envelope.command)
        self._hold.brake()
        self.state, self.cause = State.FAULT, cause

    def _command(
        self, now: float, dt: float, q: FloatArray, strain: FloatArray, fresh: FloatArray,
    ) -> FloatArray:
        if self.state is State.FOLLOWING:
            q_ref, dq_ref = self.reference.place(now, self.timeout), self.reference.dq
        else:
            q_ref, dq_ref = self._hold.q, self._hold.dq
        self.damper.dt = dt
        if self.adaptation is not None:
            self.adaptation.use(now, dt, q, dq_ref, self.damper, self.gains)
        moving = max((moving_share(float(a), float(b)) for a, b in zip(
            dq_ref, self.planned.velocity, strict=True)), default=0.0)
        yielding = np.zeros(len(q))
        yielding[self._to] = self.damper.step(
            strain[self._from], fresh[self._from], self.envelope.saturated[self._to], moving)
        weight = self.gains.step(dt)
        place = q + self.encoders.owed
        if self.state is State.FAULT:  # no position can be believed: the farther one counts
            added = np.zeros(len(q))
            place = np.where(self.envelope.command < 0.0, np.minimum(q, place),
                             np.maximum(q, place))
            place = np.clip(place, self.limits.lower, self.limits.upper)
        else:
            gain = self.gains.position_gain_in_use(self.period)
            added = gain * (q_ref - q) + weight * yielding
        # What a lost sample left out is not made up for in one command.
        command = self.envelope.step(min(dt, self.period), dq_ref + added, place)
        self.gains.judge(dt, added, moving > 0.0, bool(self.envelope.speeding.any()))
        for j in np.flatnonzero(self.envelope.cuts):
            self.cuts[self.joints[j]] += 1
        self.envelope.set_lag(self.gains.response_time(self.period))
        return command
