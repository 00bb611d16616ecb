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
References with a reaction to collisions: hold, retreat along the path just driven, or comply.

An elastic arm that merely stops keeps pressing like a bent spring, so that holding leaves the
contact force where it is; retreating or complying takes it away.
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.shaped_motion import ShapedPlanner, Shaping
from tudor_dynamics.errors import UsageError
from tudor_dynamics.signals.motion_profile import MotionLimits
from tudor_dynamics.typing import FloatArray

REACTIONS = ('none', 'hold', 'retreat', 'comply')
RAMP = 0.15
"""Time in which a retreat comes to speed [s]."""


class ReactingReference:
    """
    Reference motion, step by step, that yields to collisions.

    q (joints,) [rad], retreat_time [s]; shaping: not at all by default.
    """

    def __init__(
        self,
        limits: Limits,
        q: FloatArray,
        reaction: str = 'retreat',
        retreat_time: float = 1.0,
        comply_speed: float = 0.5,
        shaping: Shaping | None = None,
    ) -> None:
        if reaction not in REACTIONS:
            msg = f'reaction {reaction!r}; expected one of {", ".join(REACTIONS)}'
            raise UsageError(msg)
        self.limits = limits
        self.reaction = reaction
        self.retreat_time = retreat_time
        self.comply_speed = comply_speed
        self._planner = ShapedPlanner(
            MotionLimits(limits.velocity, limits.acceleration), q, shaping or Shaping())
        self._path: deque[tuple[float, FloatArray]] = deque()
        self._length = 0.0
        self._back = 0.0
        self._since = 0.0
        self.yielding = np.zeros(len(q))
        self._stopped = False
        self.reacting = False

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
        return self._planner.remaining

    def go(self, target: FloatArray) -> bool:
        """Take a target [rad]; refused while a collision is reacted to."""
        if self.reacting:
            return False
        self._planner.go(target)
        return True

    def collide(self) -> None:
        """React to a collision."""
        if self.reaction == 'none' or self.reacting:
            return
        self.reacting = True
        self._since = 0.0
        self._stopped = False
        self._back = min(self._length, self.retreat_time)
        if self.reaction in ('hold', 'retreat'):
            self._planner.brake()

    def stop(self) -> None:
        """Brake where the reference is, without a collision."""
        if not self.reacting:
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
            self._planner.step(dt)
            self._remember(dt)
            return
        self._since += dt
        if self.reaction == 'comply':
            bound = self.comply_speed * self.limits.velocity
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
        rate = min(1.0, 0.05 + self._since / RAMP, 0.05 + self._back / RAMP)
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
    """
    Give the speed with which a joint yields to the strain of a contact.

    strain [its unit], gain [rad/s per m/m]; returns speed [rad/s].
    """
    return -gain * strain / unit_scale if math.isfinite(strain) else 0.0
