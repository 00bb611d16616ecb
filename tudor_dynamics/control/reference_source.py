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
Source of references: goals or random targets, from where the arm is, with reactions to collisions.

It begins again at the measured pose wherever the arm is not with its reference: what commands the
joints follows nobody who is somewhere else.
"""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import hard_limits, planned_limits
from tudor_dynamics.control.guards.following import FOLLOWING_TIME, NEAR_TIME, RESTING
from tudor_dynamics.control.reaction import ReactingReference
from tudor_dynamics.control.shaped_motion import Shaping
from tudor_dynamics.signals.excitation import aprbs, joint_range
from tudor_dynamics.signals.motion_profile import motion_limits
from tudor_dynamics.typing import FloatArray

LONGEST = 600.0
"""Length of random targets before they begin anew [s]."""
LARGEST_STEP = 0.1
"""A pause is not made up for beyond this [s]."""
PATIENCE = 0.5
"""A resting reference that the arm is not near for so long begins again at the arm [s]."""


class ReferenceSource:
    """
    Reference motion of an arm.

    retreat_time, timeout [s]; shaping: not at all by default; motion: None before the first
    positions and while none come; halted: empty where they are; note: empty for nothing.
    """

    def __init__(
        self, arm: Arm, reaction: str = 'retreat', retreat_time: float = 1.0,
        timeout: float = 0.5, shaping: Shaping | None = None,
    ) -> None:
        motion_limits(arm)  # says what is missing
        self.hard = hard_limits(arm)
        self._limits = planned_limits(arm)
        self._range = joint_range(arm)
        self.reaction, self.retreat_time, self.timeout = reaction, retreat_time, timeout
        self.shaping = shaping or Shaping()
        self.motion: ReactingReference | None = None
        self.note = ''
        self._measured: FloatArray | None = None
        self._at = -math.inf
        self._away = 0.0
        self.collision = False
        self.halted = ''
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
        self._measured, self._at = q.copy(), now

    def configure(self, reaction: str, retreat_time: float) -> None:
        """Take another reaction into use: retreat_time [s]."""
        self.reaction, self.retreat_time = reaction, retreat_time
        if self.motion is not None:
            self.motion.reaction, self.motion.retreat_time = reaction, retreat_time

    def go(self, target: FloatArray) -> str:
        """Take a goal: target (joints,); returns an empty string if it is taken."""
        motion = self.motion
        if motion is None:
            return 'no positions come: where the arm is, is not known'
        if self.halted:
            return f'no monitor watches the arm, {self.halted}'
        outside = self.hard.outside(target) | np.isinf(target)
        if outside.any():
            return (f'{target.tolist()} is outside {self.hard.lower.tolist()} .. '
                    f'{self.hard.upper.tolist()}')
        if motion.reacting or self.collision:
            return 'a collision is being reacted to'
        motion.go(target)
        return ''

    def collide(self, collision: bool) -> None:
        """Take the state of the collision detector into account."""
        rising, self.collision = collision and not self.collision, collision
        if rising and self.motion is not None:
            self.motion.collide()

    def clear(self) -> None:
        """Take goals again."""
        self.collision = False
        if self.motion is not None:
            self.motion.clear()

    def halt(self, cause: str) -> None:
        """Brake and take no goals for a cause, such as that nobody watches; empty to go on."""
        if cause and not self.halted and self.motion is not None:
            self.motion.stop()
        self.halted = cause

    def step(self, now: float, dt: float) -> tuple[FloatArray, FloatArray] | None:
        """
        Advance the reference.

        now, dt [s]; returns positions and speeds [rad, rad/s], None while none can be told.
        """
        if self._measured is None:
            return None
        if now - self._at > self.timeout:
            if self.motion is not None:
                self.motion, self.note = None, 'positions stopped; it begins again with them'
            return None
        motion = self.motion
        if motion is None or self._lost(motion, dt):
            motion = self._begin()
        dt = min(dt, LARGEST_STEP)
        self._elapsed += dt
        if self._seed is not None and not self.halted:
            self._take_targets(motion)
        motion.step(dt)
        return motion.q.copy(), motion.dq.copy()

    def _begin(self) -> ReactingReference:
        assert self._measured is not None
        place = np.clip(self._measured, self.hard.lower, self.hard.upper)
        self.motion = ReactingReference(self._limits, place, self.reaction, self.retreat_time,
                                        shaping=self.shaping)
        self._away = 0.0
        if self.collision:
            self.motion.collide()
        return self.motion

    def _lost(self, motion: ReactingReference, dt: float) -> bool:
        """Say whether the arm is not with its reference."""
        assert self._measured is not None
        planned = self._limits.velocity
        away = np.abs(motion.q - self._measured) / planned
        resting = bool(np.all(np.abs(motion.dq) < RESTING * planned))
        self._away = self._away + dt if resting and away.max() > NEAR_TIME else 0.0
        if away.max() > FOLLOWING_TIME or self._away > PATIENCE:
            self.note = 'the arm was not with its reference; it begins again where the arm is'
            return True
        return False

    def _take_targets(self, motion: ReactingReference) -> None:
        if not self._goals:
            assert self._seed is not None
            seed = self._seed if not self._stretches else int(np.random.SeedSequence(
                [self._seed, self._stretches]).generate_state(1)[0])
            self._stretches += 1
            targets = aprbs(self._range, LONGEST, seed)
            self._goals = sorted(
                ((self._elapsed + float(t), self._only(j, float(v)))
                 for j in range(len(targets.times))
                 for t, v in zip(targets.times[j], targets.values[j], strict=True)),
                key=lambda item: -item[0])
        while self._goals and self._goals[-1][0] <= self._elapsed:
            motion.go(self._goals.pop()[1])

    def _only(self, joint: int, value: float) -> FloatArray:
        target = np.full(len(self._limits.velocity), np.nan)
        target[joint] = value
        return target
