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

"""References: goals or random targets from where the arm is, with reactions to collisions."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import hard_limits, Limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control import settings
from tudor_dynamics.control.shaped_motion import ShapedPlanner, Shaping
from tudor_dynamics.control.trajectory import Follower, of_all, ROUNDING
from tudor_dynamics.errors import SignalError, UsageError
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import aprbs, Deviation, joint_range, motion_limits
from tudor_dynamics.typing import FloatArray


# -- References with a reaction to collisions: hold, retreat along the path just driven, or comply.
#
# An elastic arm that merely stops keeps pressing like a bent spring, so that holding leaves the
# contact force where it is; retreating or complying takes it away.

REACTIONS = ('none', 'hold', 'retreat', 'comply')


class ReactingReference:
    """Reference motion, step by step, that yields to collisions."""

    def __init__(
        self,
        limits: Limits,
        q: FloatArray,
        reaction: str = 'retreat',
        retreat_time: float = 1.0,  # [s]
        shaping: Shaping | None = None,  # none by default
        hard: Limits | None = None,  # what trajectories keep to; limits by default
    ) -> None:
        if reaction not in REACTIONS:
            raise UsageError(f'reaction is {reaction!r}; expected one of {", ".join(REACTIONS)}')
        self.limits = limits
        self.reaction = reaction
        self.retreat_time = retreat_time
        self._planner = ShapedPlanner(limits, q, shaping or Shaping())
        self._path: deque[tuple[float, FloatArray]] = deque()
        self._length = self._back = self._since = 0.0
        self.follower = Follower(hard or limits)
        self.refused = ''
        self.yielding = np.zeros(len(q))
        self._stopped = self.reacting = False

    @property
    def q(self) -> FloatArray:
        """Give the reference positions [rad]."""
        return self._planner.q

    @property
    def dq(self) -> FloatArray:
        """Give the reference speeds [rad/s]."""
        return self._planner.dq

    @property
    def remaining(self) -> float:
        """Time until the joints rest at their targets [s]."""
        if (progress := self.follower.progress) is not None:
            return progress[1] - progress[0]
        return self._planner.remaining

    def go(self, target: FloatArray) -> bool:
        """Take a target [rad]; refused while a collision is reacted to."""
        if self.reacting:
            return False
        self.follower.leave()
        self._planner.go(target)
        return True

    def follow(self, trajectory: Trajectory, since: float) -> str:
        """Take a trajectory; empty if it is taken, see `Follower.take`."""
        self.refused = ''
        return self.follower.take(trajectory, since, self.state, self._planner.remaining <= 0.0)

    @property
    def state(self) -> MotionState:
        """Give positions, speeds and accelerations of the reference."""
        return self.follower.state or MotionState(
            self.q.copy(), self.dq.copy(), self._planner.ddq.copy())

    @property
    def moving(self) -> bool:
        """Whether the reference does not rest yet."""
        return bool(self.remaining > 0.0 or self.dq.any())

    def collide(self) -> None:
        """React to a collision."""
        if self.reaction == 'none' or self.reacting:
            return
        self.reacting = True
        self._since = 0.0
        self._stopped = False
        self._back = min(self._length, self.retreat_time)
        self.follower.leave()
        if self.reaction in ('hold', 'retreat'):
            self._planner.brake()

    def stop(self) -> None:
        """Brake where the reference is, without a collision."""
        if not self.reacting:
            self.follower.leave()
            self._planner.brake()

    def hold(self) -> None:
        """Brake, and stay there whatever was reacted to."""
        self.follower.leave()
        self.reaction = 'hold'
        self._planner.brake()

    def clear(self) -> None:
        """Take goals again, from where the joints are now."""
        if self.reacting:
            self._planner.move(self.q.copy(), np.zeros_like(self.q))
            self.reacting = False
            self._path.clear()
            self._length = 0.0

    def step(self, dt: float) -> None:
        """Advance by a step [s]."""
        if not self.reacting:
            state: MotionState | None = None
            if self.follower.path is not None or self.follower.coming is not None:
                state, self.refused = self.follower.step(dt, self.state)
                if self.refused:
                    self._planner.brake()
            if state is None:
                self._planner.step(dt)
            else:
                self._planner.move(state.q, state.dq)
            self._remember(dt)
            return
        self._since += dt
        if self.reaction == 'comply':
            bound = settings.COMPLY_SPEED * self.limits.velocity
            speed = np.clip(self.yielding, -bound, bound)
            place = np.clip(self.q + dt * speed, np.minimum(self.limits.lower, self.q),
                            np.maximum(self.limits.upper, self.q))
            self._planner.move(place, (place - self.q) / dt)
        elif self.reaction == 'retreat' and self._stopped:
            self._drive_back(dt)
        else:
            self._planner.step(dt)
            self._remember(dt)
            self._back = min(self._back + dt, self._length)  # the way of braking, too
            if self._planner.remaining <= 0.0:
                self._stopped, self._since = True, 0.0

    def _remember(self, dt: float) -> None:
        self._path.append((dt, self._planner.q.copy()))
        self._length += dt
        while self._length > 2.0 * self.retreat_time + 1.0 and len(self._path) > 1:
            gone, _ = self._path.popleft()
            self._length -= gone

    def _drive_back(self, dt: float) -> None:
        """Drive the path back, slower at both ends of the way."""
        if not self._path or self._back <= 0.0:
            self._planner.move(self.q.copy(), np.zeros_like(self.q))
            return
        rate = min(1.0, 0.05 + min(self._since, self._back) / settings.RETREAT_RAMP)
        way = rate * dt
        self._back -= way
        place = self.q.copy()
        while self._path and way > 0.0:
            length, before = self._path[-1]
            if length > way:
                share = way / length
                place = place + share * (before - place)
                self._path[-1] = (length - way, before)
                self._length -= way
                break
            self._path.pop()
            self._length -= length
            way -= length
            place = before
        speed = (place - self.q) / dt
        bound = self.limits.velocity
        if np.any(np.abs(speed) > bound):
            share = float(np.min(bound / np.maximum(np.abs(speed), 1e-12)))
            speed, place = share * speed, self.q + share * (place - self.q)
        self._planner.move(place, speed)


def yielding_speed(strain: float, unit_scale: float, gain: float) -> float:
    """Give the speed [rad/s] of yielding to the strain of a contact; gain [rad/s per m/m]."""
    return -gain * strain / unit_scale if math.isfinite(strain) else 0.0


# -- Source of references: goals or random targets, from where the arm is, with reactions to
#    collisions.
#
# It begins again at the measured pose wherever the arm is not with its reference: what commands
# the joints follows nobody who is somewhere else.

REACHED, MISSED, OFF_PATH = 'reached', 'missed', 'off the path'
"""How outcomes begin that are not those of a stop."""


@dataclass
class Tolerances:
    """How far the arm may be from a trajectory, joint by joint; 0 for as far as it likes."""

    path: FloatArray | float = 0.0  # on the way [rad or m]
    goal: FloatArray | float = 0.0  # at the end [rad or m]
    goal_time: float = 0.0  # how much later than its end that is judged, 0 for never [s]


class ReferenceSource:
    """Reference motion of an arm: retreat_time, timeout [s]."""

    def __init__(
        self, arm: Arm, reaction: str = 'retreat', retreat_time: float = 1.0,
        timeout: float = 0.5, shaping: Shaping | None = None,
    ) -> None:
        self.hard, self._limits = hard_limits(arm), motion_limits(arm)
        self._range = joint_range(arm)
        self.reaction, self.retreat_time, self.timeout = reaction, retreat_time, timeout
        self.shaping = shaping or Shaping()
        self.names = arm.active_joints
        self._units = arm.position_units
        self.tolerances = Tolerances()
        self.partial = True  # joints that a trajectory does not name are held
        self.motion: ReactingReference | None = None  # while positions come
        self.outcome = self.note = ''  # how the last trajectory ended, and why motion began again
        self._asked = -math.inf
        self._ends: FloatArray | None = None
        self._own: Tolerances | None = None
        self._overdue = self._away = 0.0
        self.actual = np.zeros(len(self.names))  # where the joints are, known since `_at` [s]
        self._at = -math.inf
        self.collision = False
        self.halted = ''  # empty where goals are taken
        self._goals: list[tuple[float, FloatArray]] = []
        self._elapsed = 0.0
        self._seed: int | None = None
        self._stretches = 0

    @property
    def q(self) -> FloatArray | None:
        """Give the reference positions [rad]."""
        return None if self.motion is None else self.motion.q

    @property
    def reacting(self) -> bool:
        """Whether a collision has taken over."""
        return self.motion is not None and self.motion.reacting

    def wander(self, seed: int) -> None:
        """Take random targets from now on (an APRBS), others in each stretch of ten minutes."""
        self._seed, self._stretches = seed, 0

    def measured(self, now: float, q: FloatArray) -> None:
        """Take measured positions [rad] into account, at a local time [s]: q (joints,) [rad]."""
        self.actual, self._at = q.copy(), now

    def configure(self, reaction: str, retreat_time: float) -> None:
        """Take another reaction into use: retreat_time [s]."""
        self.reaction, self.retreat_time = reaction, retreat_time
        if self.motion is not None:
            self.motion.reaction, self.motion.retreat_time = reaction, retreat_time

    def go(self, target: ArrayLike) -> str:
        """Take a goal: target (joints,); returns an empty string if it is taken."""
        target = np.asarray(target, dtype=np.float64)
        if why := self._unable():
            return why
        for k in np.flatnonzero(self.hard.outside(target) | np.isinf(target)):
            return (f'the target of {self.names[k]!r} is {target[k]:.4g} '
                    f'{self._units[self.names[k]]}; send one within its limits '
                    f'{self.hard.lower[k]:.4g} to {self.hard.upper[k]:.4g}')
        assert self.motion is not None
        self.motion.go(target)
        self._follow(target)
        return ''

    def take(
        self, trajectory: Trajectory,
        since: float = 0.0,  # time since its start, below zero where that is to come [s]
        tolerances: Tolerances | None = None,  # its own, those of the source by default
    ) -> str:
        """
        Take a trajectory, as a joint trajectory controller does, or say why it is refused.

        One point is a goal, reached by a smooth move of its own time. Several are passed at their
        times. A new one takes over at its start; until then what is driven goes on. Points whose
        time is over are left out. Everything is checked before the first sample moves.
        """
        if why := self._unable():
            return why
        assert self.motion is not None
        held = self.motion.follower.path
        try:
            whole = of_all(trajectory, self.names, self.motion.q if held is None else held.target,
                           self.partial)
            if len(whole.t) == 1:
                why = self.go(np.where(np.isin(self.names, trajectory.joints), whole.q[0], np.nan))
            else:
                why = self.motion.follow(whole, since)
        except SignalError as err:
            return str(err)
        if not why:
            self._follow(whole.q[-1], tolerances)
        return why

    def stop(self, why: str) -> None:
        """Brake, and follow no trajectory any more."""
        if self.motion is not None:
            self.motion.stop()
        self._end(f'stopped: {why}')

    def hold(self, why: str) -> None:
        """Brake, also out of a reaction, and take nothing until it begins again."""
        if self.motion is not None:
            self.motion.hold()
        self._end(f'stopped: {why}')

    def _unable(self) -> str:
        """Say why no motion can be taken now; empty where it can."""
        if self.motion is None:
            return 'no joint positions arrive; start the driver of the arm'
        if self.halted:
            return f"the parameter 'require_monitor' is set, but {self.halted}"
        if self._seed is not None:
            return 'this node drives random targets; restart it with the parameter mode:=goals'
        return ('a collision was reported; free the arm, then call the service ~/reset'
                if self.reacting or self.collision else '')

    def _follow(self, ends: FloatArray, own: Tolerances | None = None) -> None:
        """Watch the way to the ends of what was taken, NaN where that is open."""
        self._ends, self._own, self._overdue, self.outcome = ends, own, 0.0, ''

    def _end(self, outcome: str) -> None:
        """Keep how a trajectory ended."""
        if self._ends is not None:
            self._ends, self.outcome = None, outcome

    def _judge(self, motion: ReactingReference, dt: float) -> None:
        """Stop where the arm leaves its path, and say whether it has reached the end."""
        if self._ends is None:
            return
        if motion.refused:
            self._end(f'not begun: {motion.refused}')
            return
        follower, limit = motion.follower, self._own or self.tolerances
        if motion.moving or np.any(np.abs(motion.q - self._ends) > ROUNDING):
            begun = follower.coming is None or follower.path is not None
            off = self._beyond(motion.q, limit.path)
            if begun and off:
                motion.stop()
                self._end(f'{OFF_PATH}: {off}')
            return
        off = self._beyond(self._ends, limit.goal)
        if not off:
            self._end(REACHED)
            return
        self._overdue += dt
        if 0.0 < limit.goal_time < self._overdue:
            self._end(f'{MISSED} the goal: {limit.goal_time:g} s after the end {off}')

    def _beyond(self, wanted: FloatArray, bound: FloatArray | float) -> str:
        """Name the joint that is farthest beyond its bound; empty if none is."""
        off, bounds = np.abs(self.actual - wanted), np.broadcast_to(bound, wanted.shape)
        over = np.where((bounds > 0.0) & (off > bounds), off - bounds, 0.0)
        k = int(over.argmax())
        return (f'{self.names[k]!r} is {off[k]:.3g} {self._units[self.names[k]]} away (tolerance '
                f'{bounds[k]:.3g}); see the diagnostics of oscillation_damper' if over[k] else '')

    def collide(self, collision: bool) -> None:
        """Take the state of the collision detector into account."""
        rising, self.collision = collision and not self.collision, collision
        if rising and self.motion is not None:
            self.motion.collide()
            self._end('stopped: collision')

    def clear(self) -> None:
        """Take goals again."""
        self.collision = False
        if self.motion is not None:
            self.motion.clear()

    def reset(self, now: float) -> None:
        """Take goals again; while a collision lasts only if that is asked for twice [s]."""
        if self.collision and now - self._asked > settings.RESET_AGAIN:
            self._asked = now
            raise UsageError('a collision is still reported', remedy='free the arm and call the '
                             'service reset of the monitor; to move the arm all the same, call '
                             f'this service again within {settings.RESET_AGAIN:g} s')
        self._asked = -math.inf
        self.clear()

    def halt(self, cause: str) -> None:
        """Brake and take no goals for a cause, such as that nobody watches; empty to go on."""
        if cause and not self.halted:
            self.stop(cause)
        self.halted = cause

    def step(self, now: float, dt: float) -> tuple[FloatArray, FloatArray] | None:
        """Advance the reference; give its positions and speeds, None while there is none."""
        if now - self._at > self.timeout:
            if self.motion is not None:
                self.motion = None
                self.note = 'joint positions stopped; the reference restarts when they return'
                self._end('stopped: no joint positions arrive; start the driver of the arm')
            return None
        motion = self.motion
        if motion is None or self._lost(motion, dt):
            place = np.clip(self.actual, self.hard.lower, self.hard.upper)
            motion = self.motion = ReactingReference(
                self._limits, place, self.reaction, self.retreat_time, shaping=self.shaping,
                hard=self.hard)
            self._end(f'stopped: {self.note}')
            self._away = 0.0
            if self.collision:
                motion.collide()
        dt = min(dt, settings.LARGEST_PERIOD)
        self._elapsed += dt
        if self._seed is not None and not self.halted:
            self._take_targets(motion)
        motion.step(dt)
        self._judge(motion, dt)
        return motion.q.copy(), motion.dq.copy()

    def _lost(self, motion: ReactingReference, dt: float) -> bool:
        """Say whether the arm is not with its reference."""
        planned = self._limits.velocity
        found = Deviation.of(self.names, motion.q - self.actual, planned)
        resting = bool((np.abs(motion.dq) < settings.RESTING_SPEED * planned).all())
        self._away = self._away + dt if resting and found.seconds > settings.NEAR_TIME else 0.0
        if found.seconds > settings.FOLLOWING_TIME or self._away > settings.LOST_TIME:
            self.note = f'{found}, which restarted where the arm is; see oscillation_damper'
            return True
        return False

    def _take_targets(self, motion: ReactingReference) -> None:
        if not self._goals:
            assert self._seed is not None
            seed = self._seed if not self._stretches else int(np.random.SeedSequence(
                [self._seed, self._stretches]).generate_state(1)[0])
            self._stretches += 1
            targets = aprbs(self._range, settings.TARGETS_SECONDS, seed)
            self._goals = sorted(
                ((self._elapsed + float(t), np.where(only, v, np.nan))
                 for only, times, values in zip(
                     np.eye(len(targets.times), dtype=bool), targets.times, targets.values,
                     strict=True)
                 for t, v in zip(times, values, strict=True)),
                key=lambda item: -item[0])
        while self._goals and self._goals[-1][0] <= self._elapsed:
            motion.go(self._goals.pop()[1])
