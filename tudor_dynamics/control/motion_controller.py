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

from collections import Counter, deque
from dataclasses import replace
from enum import IntEnum
import math

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import drive_stop, effort_limits, hard_limits, Limits
from tudor_dynamics.control import settings
from tudor_dynamics.control.cascade import (
    BY_SPEED, Envelope, learned_period, LoopGains, SATURATING)
from tudor_dynamics.control.damper import arm_damping, Damper, moving_share
from tudor_dynamics.control.plausibility import AgeWatch, AHEAD, Doubt, MotionWatch
from tudor_dynamics.control.schedule import Adaptation
from tudor_dynamics.signals.motion_profile import Deviation, motion_limits, MotionPlanner
from tudor_dynamics.typing import FloatArray


class State(IntEnum):
    """What the joints do, and why not more."""

    HOLDING = 0
    """They stand, or brake to where they will: there is no reference that may be followed."""
    FOLLOWING = 1
    """They follow the reference."""
    FAULT = 2
    """They stand until a reset: encoders cannot be believed."""


class ReferenceGate:
    """Lets references pass that keep to the limits; says when an arm may follow, and why not."""

    def __init__(self, joints: tuple[str, ...], limits: Limits, planned: FloatArray) -> None:
        self._joints, self._limits, self._planned = joints, limits, planned
        self.refused: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the newest reference."""
        self.q, self.dq = np.zeros(len(self._joints)), np.zeros(len(self._joints))
        self._at: float | None = None
        self.refusal = ''  # of the last one; empty if it was taken

    @property
    def known(self) -> bool:
        """Whether any reference was taken."""
        return self._at is not None

    def age(self, now: float) -> float:
        """Give the age of the newest reference; infinite without one [s]."""
        return math.inf if self._at is None else now - self._at

    def place(self, now: float, longest: float) -> FloatArray:
        """Give where the newest reference is by now, extrapolated for a time [s] at most."""
        longest = min(longest, settings.LONGEST_EXTRAPOLATED)
        return np.asarray(self.q + min(self.age(now), longest) * self.dq)

    def motion(self, now: float, longest: float) -> tuple[FloatArray, FloatArray]:
        """Give place and speed of the newest reference; too old, it stands [rad, rad/s]."""
        old = self.age(now) > settings.LONGEST_EXTRAPOLATED
        return self.place(now, longest), np.zeros_like(self.dq) if old else self.dq

    def add(self, now: float, q: FloatArray, dq: FloatArray) -> None:
        """Take a reference, if it can be one: now [s], q, dq (joints,) [rad, rad/s]."""
        self.refusal = self._impossible(q, dq)
        if self.refusal:
            self.refused[self.refusal.partition(':')[0]] += 1
        else:
            self._at, self.q, self.dq = now, q.copy(), dq.copy()

    def stray(self, now: float, timeout: float, q: FloatArray) -> str:
        """Say why an arm that follows must not go on; empty if it may: timeout [s]."""
        if self.age(now) > timeout:
            return f'no reference on joint_reference for {1e3 * timeout:.0f} ms; check its sender'
        found = self._deviation(now, timeout, q)
        return str(found) if found.seconds > settings.FOLLOWING_TIME else ''

    def obstacle(self, now: float, timeout: float, q: FloatArray, held: FloatArray) -> str:
        """Say why an arm that holds, at its speeds, cannot begin to follow; empty if it can."""
        if self.age(now) > timeout:
            return self.refusal or 'no reference on joint_reference; start reference_generator'
        found = self._deviation(now, timeout, q)
        if found.seconds > settings.NEAR_TIME:
            return (f'{found.joint} is {found.away:.3g} [rad or m] away from its reference; send '
                    'a reference that begins where the arm is')
        resting = settings.RESTING_SPEED * self._planned
        if (np.abs(self.dq) > resting).any():
            return 'the reference moves; send one at rest until the arm follows it'
        return 'the arm still brakes' if (np.abs(held) > resting).any() else ''

    def _deviation(self, now: float, timeout: float, q: FloatArray) -> Deviation:
        return Deviation.of(self._joints, self.place(now, timeout) - q, self._planned)

    def _impossible(self, q: FloatArray, dq: FloatArray) -> str:
        for j in (~(np.isfinite(q) & np.isfinite(dq))).nonzero()[0]:
            return (f'reference not finite: the position of {self._joints[j]!r} is {q[j]:g}, its '
                    f'velocity {dq[j]:g}; send finite numbers')
        limits = self._limits
        for j in limits.outside(q).nonzero()[0]:
            unit = '' if abs(q[j]) < 2.0 * math.pi else ', in rad or m, not degrees or mm'
            return (f'reference outside limits: it sends {self._joints[j]!r} to {q[j]:.4g}; send '
                    f'{limits.lower[j]:.4g} to {limits.upper[j]:.4g}{unit}')
        for j in (np.abs(dq) > limits.velocity).nonzero()[0]:
            return (f'reference too fast: the velocity of {self._joints[j]!r} is {dq[j]:.4g}; '
                    f'send at most {limits.velocity[j]:.4g} [rad/s or m/s]')
        return ''


class Takeover:
    """Says when an arm of unknown motion can be commanded at the speed that was measured."""

    def __init__(self, acceleration: FloatArray) -> None:
        self._acceleration = acceleration
        self._seen: deque[tuple[float, FloatArray]] = deque()

    def reset(self) -> None:
        """Begin to observe."""
        self._seen.clear()

    def step(self, now: float, dq: FloatArray, delay: float) -> bool:
        """Observe a sample of a loop with a delay [s]; True where commands can begin."""
        self._seen.append((now, dq))
        while len(self._seen) > 2 and now - self._seen[1][0] >= settings.TAKEOVER_TIME + delay:
            self._seen.popleft()
        begin, before = self._seen[0]
        if now - begin < settings.TAKEOVER_TIME + delay:
            return False
        # One that brakes is left to stop: the speed measured before would be a step up for it.
        slower = np.abs(before) - np.abs(dq)
        braking = settings.TAKEOVER_BRAKING * self._acceleration
        return not bool(np.any(slower > braking * (now - begin)))


class MotionController:
    """
    Velocity commands from reference, positions and strains.

    It begins by holding the arm where it is, and follows a reference once that rests near the arm.
    After any interruption it does so again: it brakes as planned motion does and holds where it
    stopped. Encoders that cannot be believed are a fault: it stands still until ``reset``.
    """

    def __init__(self, arm: Arm, share: float = 1.0, timeout: float = 0.1) -> None:
        self.joints, self.gauges = arm.active_joints, arm.gauge_names
        self.limits = hard_limits(arm)
        self.planned = motion_limits(arm)
        self.timeout = timeout
        self.damper = Damper(arm_damping(arm), 1.0 / arm.damper.rate)
        self.gains = LoopGains(arm.damper, self.limits.velocity, share)
        self.adaptation: Adaptation | None = None
        self.envelope = Envelope(self.limits, self.gains.response_time, drive_stop(arm))
        self.watched = MotionWatch({name: arm.position_units[name] for name in self.joints},
                                   self.limits, effort_limits(arm))
        self.reference = ReferenceGate(self.joints, self.limits, self.planned.velocity)
        self._takeover = Takeover(self.planned.acceleration)
        self._to = [self.joints.index(name) for name in self.damper.joints]
        self._from = [self.gauges.index(name) for name in self.damper.gauges]
        self._hold = MotionPlanner(self.planned, np.zeros(len(self.joints)))
        self._q: FloatArray | None = None
        self._guess = np.zeros(len(self.joints))  # where it is while positions do not come
        self._at = -math.inf
        self._arrival = 0.0  # time between samples by the clock of this machine
        self.ages = AgeWatch()
        self._gave = -math.inf  # when the last command was given
        # For which commands may still change: samples that waited are answered all at once [s].
        self._budget = 0.0
        self._unknown = True  # the speed of the arm
        self.missing = False  # positions: commands are given without them
        self._stops, self._enough, self._astray = 0, 0, False  # stops at a fault, given and needed
        self.required = self.tested = False  # whether joint_test has to be passed first, and is
        self._origin = np.zeros(len(self.joints))
        self.takeovers = 0
        self._doubts: list[Doubt] = []
        # Until when the cause of a fault is estimated again, and when next.
        self._explain_until = self._explain_at = -math.inf
        self.cuts: Counter[str] = Counter()
        self.state, self.cause = State.HOLDING, 'no reference yet; start reference_generator'

    def reset(self) -> bool:
        """Leave a fault and begin again; True where its own motion is braked, without a break."""
        moving = not (self._unknown or self.missing or self.state is State.FAULT)
        self.state, self.cause = State.HOLDING, 'no reference yet; start reference_generator'
        self.reference.reset()
        self.damper.reset()
        if self.adaptation is not None:
            self.adaptation.reset()
        if self._q is not None and moving and self.envelope.command.any():
            self._hold.brake(self._q, self.envelope.command)
            self.gains.excited = ''
            return True
        self._q = None
        self.ages.reset()
        self._hold = MotionPlanner(self.planned, np.zeros(len(self.joints)))
        self.gains.reset()
        return False

    def distrust(self) -> None:
        """Take the driver for another one: joints have to be tested, and confirmed, again."""
        self.watched.reset()
        self.tested = False

    @property
    def blind(self) -> bool:
        """Whether it knows no positions, so that it commands nothing."""
        return self._q is None

    @property
    def unreferenced(self) -> bool:
        """Whether there was a reference, and none comes any more."""
        return self.reference.known and self.reference.age(self._at) > self.timeout

    def step(
        self, now: float, dt: float, q: FloatArray, strain: FloatArray, fresh: FloatArray, *,
        age: float | None = None,  # of its stamp by the node's clock, where that is known [s]
        # What the driver itself says, None or no numbers where it says nothing.
        dq: FloatArray | None = None, effort: FloatArray | None = None,
    ) -> FloatArray | None:
        """Give the commands for one sample; None until it is known how fast the arm is."""
        gains = self.gains
        silent, self._at = now - self._at, now
        if math.isfinite(silent):
            self._arrival = learned_period(self._arrival, silent)
        if dt <= 0.0:
            self.ages.reset()
        if dt <= 0.0 or silent > settings.DRIVER_STARTS:
            self.distrust()
        if age is not None and self.ages.step(now, age) > self._latest:
            self.cuts['late'] += 1
            return None if self._q is None or self._silent else self._brake(
                now, f'joint positions come {1e3 * self.ages.late:.0f} ms late (limit '
                f'{1e3 * self._latest:.0f} ms); lower the load of computer and network')
        gains.late = max(self.ages.late, 0.0)
        gains.period = gains.period or max(dt, 0.0)
        if self._q is None or dt <= 0.0 or dt > self._patience or (
                not self._unknown and (self.missing or self._slept(now))):
            self._take_first(now, q)
            return None
        speed = (q - self._q) / dt
        self._q = self._guess = q.copy()
        clock, delay = gains.sampled(dt)
        fault = self.state is State.FAULT  # then drives brake with all they have: no overload
        doubts = self.watched.step(
            clock, dt, self._q, gains.delay.commands, gains.lags, dq, None if fault else effort,
            telling=not fault, late=self.ages.late, recent=self.ages.recent)
        if self._unknown:
            if not (doubts or self._takeover.step(clock, speed, delay)):
                return None
            self.takeovers += 1
            self._begin(now, q, np.zeros_like(speed) if doubts else speed)
        if doubts:
            self._fault(doubts)
            self._explain_until = clock + settings.TELLING_AFTER
            self._explain_at = clock + settings.TELLING_EVERY
        elif fault and self._explain_at < clock < self._explain_until:
            self._explain_at = clock + settings.TELLING_EVERY
            later = [self.watched.tell(doubt.joint, gains.delay.commands, gains.lags)
                     if doubt.later else doubt for doubt in self._doubts]
            worse = not self._astray and any(doubt.astray for doubt in later)
            (self._fault if worse else self._explain)(later)
        self._hold.step(dt)
        self._choose(now, q)
        self._budget = min(self._budget + now - self._gave,
                           max(2.0 * gains.period, settings.WATCH_PERIOD))
        self._gave = now
        command = self._command(now, dt, q, speed, strain, fresh)
        self._stops = self._stops + 1 if self.state is State.FAULT and not command.any() else 0
        return None if self._silent else command

    def watch(self, now: float) -> FloatArray | None:
        """Give commands while no positions come, each `watch_period`; None while some do."""
        waited = now - self._at
        if self._q is None or self._silent or waited <= settings.MISSED_PERIODS * max(
                self.gains.period, self._arrival):
            return None
        if waited > self._patience:
            return self._brake(now, 'no joint positions arrive; start the driver of the arm')
        if self._unknown or self.missing:
            return None
        command = self._slow_down(now)
        self.gains.took(waited, command)
        return command

    @property
    def watch_period(self) -> float:
        """Time after which to call `watch`, counted from each sample, or the last call [s]."""
        late = settings.WATCHED_PERIODS * max(self.gains.period, self._arrival)
        return late / math.ceil(late / settings.WATCH_PERIOD) if late > 0.0 else (
            settings.WATCH_PERIOD)

    def stand_still(self, now: float) -> FloatArray | None:
        """Brake without looking at positions, as `watch`; None once the joints stand: now [s]."""
        if self._q is None or not self.envelope.command.any():
            return None
        return self._brake(now, 'the node was deactivated or shut down')

    def _slow_down(self, now: float) -> FloatArray:
        """Give a slower command; a sample that is only late finds the arm following."""
        dt, command = min(now - self._gave, 2.0 * settings.WATCH_PERIOD), self.envelope.command
        self._gave = now
        most = self.planned.acceleration * dt
        slower = self.envelope.step(dt, command - np.clip(command, -most, most), self._guess)
        self._guess = self._guess + dt * slower
        return slower

    def _brake(self, now: float, cause: str) -> FloatArray | None:
        """Give a command of braking blindly; the arm is where it was commanded to go."""
        if self._slept(now):  # whoever drives the joints has stopped them meanwhile
            self._q = None
            return None
        if not self.missing:
            self._interrupt(now, cause, self.envelope.command)
            self.missing = True
        elif self.state is State.HOLDING:
            self.cause = cause
        self.gains.begin()
        return self._slow_down(now)

    def _slept(self, now: float) -> bool:
        """Say whether drives have stopped by themselves."""
        return now - self._gave > self._patience + settings.ASLEEP_TIME

    @property
    def _patience(self) -> float:
        """Longest time between samples that is no interruption [s]."""
        return max(min(self.timeout, settings.LONGEST_BLIND), 3.0 * self.gains.period)

    @property
    def _silent(self) -> bool:
        """Say whether a fault has commanded standstill often enough."""
        return self.state is State.FAULT and self._stops > self._enough

    @property
    def _latest(self) -> float:
        """By how much a sample may come later than usual, by how far joints go meanwhile [s]."""
        share = float((np.abs(self.envelope.command) / self.watched.speed).max())
        return min(settings.LATE_AT_SPEED / max(share, 1e-3), settings.LONGEST_LATE)

    def _take_first(self, now: float, q: FloatArray) -> None:
        """Take a sample before which nothing counts: the next one shows how fast the arm is."""
        if self._slept(now) or not self.missing:
            self._unknown = True
            self._takeover.reset()
            self.distrust()
        self._q = self._guess = q.copy()
        self.watched.restart(self._q, 0.0 if self._unknown else settings.FREE_AFTER)
        self._explain_until = -math.inf  # what a fault is explained by is forgotten
        self.gains.begin()
        self.damper.reset()
        if self.adaptation is not None:
            self.adaptation.forget()
        if not self._unknown:  # it was commanded all the time, only not seen
            self._begin(now, q, self.envelope.command)
        if self.state is State.FOLLOWING:
            self.state, self.cause = State.HOLDING, 'the joint positions were interrupted'

    def _begin(self, now: float, q: FloatArray, dq: FloatArray) -> None:
        """Brake from a known motion, and hold where that ends."""
        self._unknown = self.missing = False
        self._gave, self._budget = now, self.gains.period
        speed = np.clip(dq, -self.limits.velocity, self.limits.velocity)
        self.envelope.begin(speed)
        self.gains.begin(speed)
        self.watched.trust(speed)
        self._hold.brake(q, speed)
        self._origin = q.copy()

    def _choose(self, now: float, q: FloatArray) -> None:
        """Follow, or hold, by what the reference is now."""
        reference = self.reference
        if self.state is State.FAULT or not reference.known:
            if reference.refusal and self.state is State.HOLDING:
                self.cause = reference.refusal
            return
        if self.state is State.FOLLOWING:
            if cause := self._untested() or reference.stray(now, self.timeout, q):
                self._interrupt(now, cause)
            return
        self.cause = self._untested() or reference.obstacle(now, self.timeout, q, self._hold.dq)
        if not self.cause:
            self.state, self.cause = State.FOLLOWING, 'follows the reference'

    def _untested(self) -> str:
        """Say why the reference is too far for joints that were not tested; empty if it is not."""
        if not self.required or self.tested:
            return ''
        away = np.abs(self.reference.q - self._origin) / self.limits.velocity
        fast = np.abs(self.reference.dq) / self.limits.velocity
        return 'joints were not tested since their driver started; run the node joint_test' if (
            away.max() > settings.UNTESTED_TIME or fast.max() > settings.UNTESTED_SHARE) else ''

    def _interrupt(self, now: float, cause: str, dq: FloatArray | None = None) -> None:
        """Brake from the motion that is in force, and hold where that ends."""
        reference = self.reference
        if self.state is State.FOLLOWING:
            place = np.clip(reference.place(now, self.timeout), self.limits.lower,
                            self.limits.upper)
            if self._q is not None:  # what the arm is away is not made up for after a stop
                near = settings.NEAR_TIME * self.planned.velocity
                place = np.clip(place, self._q - near, self._q + near)
            self._hold.brake(place, reference.dq if dq is None else dq)
        if self.state is not State.FAULT:
            self.state, self.cause = State.HOLDING, cause

    def _fault(self, doubts: list[Doubt]) -> None:
        assert self._q is not None
        speed = np.abs(self.envelope.command)
        astray = any(doubt.astray for doubt in doubts)  # each moment it goes farther astray
        one_period = self.limits.acceleration * self.gains.period  # takes off no more
        least, most = np.outer(settings.STOPPED_AT_ONCE, self.watched.speed)
        slow = speed < np.clip(one_period, least, most)
        if self.state is not State.FAULT:
            self._stops, self._enough, self._astray = 0, 0, False
        self._astray |= astray
        self._enough = max(self._enough, 1 if slow.all() else 2,
                           int(settings.STOPPING_TIME / self.gains.period))
        # Zero at once is the shortest way; each further command would make a runaway faster.
        if astray and ((self.watched.state[:, AHEAD] > 1.0).any() or slow.all()):
            self.envelope.begin(np.zeros_like(speed))
        quick = speed / (settings.ASTRAY_STOP_TIME if astray else settings.FAULT_STOP_TIME)
        self._hold = MotionPlanner(replace(
            self.planned, acceleration=np.maximum(self.planned.acceleration, quick)), self._q)
        self._hold.brake(self._q, self.envelope.command)
        self.state = State.FAULT
        self._explain(doubts)

    def _explain(self, doubts: list[Doubt]) -> None:
        self._doubts = doubts
        self.cause = '; '.join(f'{self.joints[doubt.joint]}: {doubt.text}' for doubt in doubts)

    def _command(
        self, now: float, dt: float, q: FloatArray, dq: FloatArray, strain: FloatArray,
        fresh: FloatArray,
    ) -> FloatArray:
        q_ref, dq_ref = (self.reference.motion(now, self.timeout)
                         if self.state is State.FOLLOWING else (self._hold.q, self._hold.dq))
        gains, envelope = self.gains, self.envelope
        self.damper.dt = dt
        if self.adaptation is not None:
            self.adaptation.use(now, dt, q, dq_ref, self.damper, gains)
        moving = moving_share(dq_ref, self.planned.velocity)
        limited = (envelope.cuts & SATURATING) > 0
        yielding = np.zeros(len(q))
        yielding[self._to] = self.damper.step(
            strain[self._from], fresh[self._from], limited[self._to], moving)
        weight, gain = gains.step(dt, dq)
        added = gain * (q_ref - q) + weight * yielding
        if self.state is State.FAULT:
            added = np.zeros(len(q))
        trusted = self.watched.trusted
        wanted = np.clip(dq_ref + added, -trusted, trusted)
        # Where readings and commands part, either may be right: the farther place counts.
        place = q + settings.EXCESS_COUNTS * self.watched.owed
        toward = envelope.command if self.state is State.FAULT else wanted
        place = np.where(toward < 0.0, np.minimum(q, place), np.maximum(q, place))
        if self.state is State.FAULT:
            place = np.clip(place, self.limits.lower, self.limits.upper)
        # What a lost sample left out is not made up for in one command.
        step = min(dt, gains.period, self._budget)
        self._budget -= step
        command = envelope.step(step, wanted, place)
        cuts = envelope.cuts
        for j in cuts.nonzero()[0]:
            self.cuts[self.joints[j]] += 1
        envelope.lag = gains.late + gains.commanded(
            dt, command, added, moving > 0.0, bool((cuts & BY_SPEED).any()))
        return command
