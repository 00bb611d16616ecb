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

"""Reference motion without ringing: shaped by impulses, or planned by modes."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
import math

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.errors import SignalError, SimulationError, UsageError
from tudor_dynamics.signals.motion_profile import MotionPlanner
from tudor_dynamics.signals.shaping import impulses, ImpulseShaper, PathModes, plan_shaped, Profile
from tudor_dynamics.typing import FloatArray

SHAPINGS = ('none', 'zv', 'zvd', 'elastic')
Refine = Callable[[Profile, Limits, float, float], Profile]
"""From a move by the modes, limits, payload [kg] and the period at its end [s] to a better one of
the same length; see ``models.tuning.MoveRefiner``."""


@dataclass(eq=False)
class Shaping:
    """How moves are shaped, and what is known for that."""

    kind: str = 'none'  # none, zv or zvd (impulses of the first mode), or elastic (all modes)
    schedule: Schedule | None = None  # has the modes by payload and pose
    frequency: float = 0.0  # of the first mode where there is no schedule [Hz]
    damping: float = 0.0
    payload: float | None = None  # at the tip [kg]; None while it is unknown
    note: str = ''  # why the last move was not shaped, or not refined; empty if it was
    refine: Refine | None = None  # by a model that knows what modes do not
    # Plans elastic moves while the joints rest; without one a step waits for its move.
    beside: Executor | None = None

    def __post_init__(self) -> None:
        if self.kind not in SHAPINGS:
            raise UsageError(f'shaping is {self.kind!r}; expected one of {", ".join(SHAPINGS)}')
        if self.kind == 'elastic' and self.schedule is None:
            raise UsageError("the parameter 'shaping' is elastic, but gain_schedule is empty",
                             remedy='set gain_schedule to a file that `tudor tune` wrote')
        if self.kind in ('zv', 'zvd') and self.schedule is None and self.frequency <= 0.0:
            raise UsageError(f"the parameter 'shaping' is {self.kind}, which needs a frequency",
                             remedy="set the parameter 'shaping_frequency' [Hz], or "
                             "'gain_schedule' to a file that `tudor tune` wrote")

    def shaper(self, target: FloatArray) -> ImpulseShaper | None:
        """Give the shaper of a move by impulses, not begun: target (joints,), its end [rad]."""
        if self.kind not in ('zv', 'zvd'):
            return None
        frequency, damping = self.frequency, self.damping
        if frequency <= 0.0:
            if self.payload is None or self.schedule is None:
                self.note = 'the load is unknown; start payload_estimator'
                return None
            mode = self.schedule.at(self.payload, target).modes[0]
            frequency, damping = mode.frequency, max(mode.damping, 0.0)
        return ImpulseShaper(impulses(self.kind, frequency, damping), target)

    def along(self, payload: float, path: FloatArray) -> PathModes:
        """Give the modes along a path: payload [kg], path (samples, joints) in its order [rad]."""
        assert self.schedule is not None
        found = [self.schedule.at(payload, q).modes for q in path]
        return PathModes(
            np.array([[2.0 * math.pi * mode.frequency for mode in modes] for modes in found]),
            np.array([[min(max(mode.damping, 0.0), 0.9) for mode in modes] for modes in found]),
            np.array([[mode.drive for mode in modes] for modes in found]),
            np.array([float(np.abs(mode.strain).max()) for mode in found[-1]]))

    def profile(self, start: FloatArray, target: FloatArray, limits: Limits) -> Profile | None:
        """Plan a move by the modes on its path, rest to rest [rad]; None if there is none."""
        payload = self.payload  # another one may be reported meanwhile
        if self.kind != 'elastic':
            return None
        if payload is None:
            self.note = 'the load is unknown; start payload_estimator'
            return None
        along = partial(self.along, payload)
        try:
            found = plan_shaped(start, target, limits, along)
        except SignalError as err:
            self.note = str(err)
            return None
        if self.refine is None:
            return found
        period = 2.0 * math.pi / float(along(target[None]).omega[0, 0])
        try:
            return self.refine(found, limits, payload, period)
        except SimulationError as err:
            self.note = f'only gain_schedule shapes motion, as the elastic model failed ({err})'
            return found


class ShapedPlanner(MotionPlanner):
    """Planner whose moves are shaped; the joints rest at q [rad]."""

    def __init__(self, limits: Limits, q: ArrayLike, shaping: Shaping) -> None:
        self._shaping = shaping
        self._planned: Future[Profile | None] | None = None
        self._clear()
        super().__init__(limits, q)
        self._inner = MotionPlanner(limits, self.q)

    def _clear(self) -> None:
        if self._planned is not None:
            self._planned.cancel()
        self._planned = None
        self._profile: Profile | None = None
        self._target: FloatArray | None = None
        self._shaper: ImpulseShaper | None = None
        self._clock, self._left = 0.0, 0.0

    def go(self, target: ArrayLike) -> None:
        """Take a new target, also in motion; a joint whose target is no number keeps its own."""
        if self._shaper is not None and self.remaining > 0.0:
            self._inner.go(target)  # what follows is shaped by the same impulses
            self._left = self._inner.remaining + self._shaper.length
            return
        rests = not self.dq.any() and not self.ddq.any()
        wanted = np.broadcast_to(np.asarray(target, dtype=float), self.q.shape)
        if self._target is not None:  # what it was to do is unknown to the plans
            wanted = np.where(np.isnan(wanted), self._target, wanted)
            self._plans[:] = 0.0
        super().go(wanted)
        self._clear()
        wanted = np.where(np.isnan(wanted), self.q, wanted)
        if self._shaping.kind == 'none' or not np.any(np.abs(wanted - self.q) > 1e-9):
            return
        self._shaping.note = '' if rests else 'a new target came during motion; send it at rest'
        if not rests:
            return
        shaping, given = self._shaping, (self.q.copy(), wanted.copy(), self.limits)
        if shaping.beside is not None and shaping.kind == 'elastic':
            self._planned, self._target = shaping.beside.submit(shaping.profile, *given), given[1]
        else:
            self._take(shaping.profile(*given))
        found = shaping.shaper(wanted)
        if found is not None:
            self._shaper = ImpulseShaper(found.shaper, self.q.copy())
            self._inner = MotionPlanner(self.limits, self.q)
            self._inner.go(wanted)
            self._left = self._inner.remaining + self._shaper.length

    def _take(self, profile: Profile | None) -> None:
        self._planned, self._profile = None, profile
        self._target = None if profile is None else profile.q[-1]

    def move(self, q: ArrayLike, dq: ArrayLike) -> None:
        self._clear()
        super().move(q, dq)

    def brake(self, q: ArrayLike | None = None, dq: ArrayLike | None = None) -> None:
        kind, self._shaping.kind = self._shaping.kind, 'none'
        try:
            super().brake(q, dq)
        finally:
            self._shaping.kind = kind

    def step(self, dt: float) -> None:
        """Advance ``q``, ``dq`` and ``ddq`` by a step: dt, time since the step before [s]."""
        if self._planned is not None:
            if not self._planned.done():
                return
            self._take(self._planned.result())
        if self._profile is not None:
            self._clock += dt
            self.q[:], self.dq[:], self.ddq[:] = self._profile.at(self._clock)
            if self._clock >= self._profile.duration:
                self._rest(self._profile.q[-1])
        elif self._shaper is not None:
            self._inner.step(dt)
            self._left -= dt
            self.q[:], self.dq[:], self.ddq[:] = self._shaper.step(
                dt, self._inner.q, self._inner.dq, self._inner.ddq)
            if self._left < -dt:
                self._rest(self._inner.q)
        else:
            super().step(dt)

    def _rest(self, q: FloatArray) -> None:
        super().move(q.copy(), np.zeros_like(q))
        self._clear()

    @property
    def remaining(self) -> float:
        if self._profile is not None:
            return max(self._profile.duration - self._clock, 0.0)
        if self._shaper is not None:
            return max(self._left, 0.0)
        return super().remaining
