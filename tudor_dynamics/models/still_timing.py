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
Another timing of a given path, after which a flexible tool is still.

The path ``q(s)`` stays, with ``s`` the time of the given trajectory; ``s(t)`` is sought. With the
flange's acceleration ``a(s)`` and twist ``v(s)`` of the given trajectory, that of the new one is
``a s'^2 + v s''``. The ring that this leaves (``flexible_tool.free_ring``) is linear in small
changes of ``s'``, so that linear programmes in turn reduce it, as in ``signals/shaping.py``.

It is reduced not only in the direction of the participation but, less strictly, in each of the six
of the flange: tools bend in a second plane too, and planes exchange their rings where they turn.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from scipy.interpolate import BSpline

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.models.flexible_tool import (
    Flange, flange_motion, FlexibleTool, free_ring, LIKELY)
from tudor_dynamics.models.settings import (
    TIMING_ASIDE, TIMING_EVERY, TIMING_FEWEST, TIMING_GOOD, TIMING_KNOT, TIMING_LEAST,
    TIMING_LONGER, TIMING_MOST, TIMING_NUDGE, TIMING_OFF, TIMING_RADII, TIMING_ROUNDS,
    TIMING_SLOWEST, TIMING_SPREAD, TOOL_STEP)
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.signals.settings import ROUNDING
from tudor_dynamics.signals.shaping import check_at_rest, convolved, impulses, solved
from tudor_dynamics.typing import FloatArray

TIMING = 'timing'  # the kind of shaping beside those by impulses
WEIGHT = np.repeat([1.0, TIMING_GOOD / TIMING_OFF, TIMING_GOOD / TIMING_OFF], 7)
"""Of the rings at the frequency expected, at a lower and at a higher one."""


@dataclass(frozen=True, eq=False)
class StillTiming:
    """A trajectory after which a tool is still."""

    trajectory: Trajectory
    # What is left of the ring of the given one, by the model; the same where the frequency is off.
    left: float
    left_off: float


def still_timing(arm: Arm, tool: FlexibleTool, given: Trajectory) -> StillTiming:
    """
    Change when a trajectory passes its path, so that a tool at the flange is still at its end.

    No joint is faster than at the same place of the given trajectory, nor accelerates more than it
    does anywhere. A SignalError if it does not lead from rest to rest, or no timing is found.
    """
    if given.dq is None or len(given.t) < 2:
        raise SignalError('the trajectory has no velocities',
                          remedy='give them, or shape it by zv or zvd')
    check_at_rest(given)
    path = _Path(arm, tool, given)
    best: tuple[float, _Timing, FloatArray] | None = None
    for longer in TIMING_LONGER:
        timing = _Timing(path, longer / path.frequency)
        rate, rings = timing.search()
        left = float((WEIGHT * rings).max())
        if best is None or left < best[0]:
            best = left, timing, rate
        if left <= TIMING_GOOD:
            break  # the shortest
    assert best is not None
    left, timing, rate = best
    if left > TIMING_MOST:
        raise SignalError(f'no timing of this path leaves the tool still: {100.0 * left:.0f} % of '
                          'the ring remain', remedy='begin more slowly, or shape it by zv or zvd')
    rings = np.abs(timing.rings(rate)) / path.size
    return StillTiming(timing.trajectory(given, rate), float(rings[0]),
                       float(rings[[7, 14]].max()))


def shaped_for(arm: Arm, tool: FlexibleTool, given: Trajectory, kind: str) -> Trajectory:
    """Shape a trajectory by its timing, or by impulses for the tool where it ends."""
    if kind == TIMING:
        return still_timing(arm, tool, given).trajectory
    frequency = tool.frequency_at(arm, given.of(arm.active_joints).q[-1]).value
    return convolved(given, impulses(kind, frequency, tool.damping))


class _Path:
    """What a trajectory does, at even times, and how it rings."""

    def __init__(self, arm: Arm, tool: FlexibleTool, given: Trajectory) -> None:
        self.seconds = float(given.t[-1] - given.t[0])
        count = max(int(round(self.seconds / TOOL_STEP)), TIMING_FEWEST) + 1
        t = np.linspace(given.t[0], given.t[-1], count)
        curve = spline(given)
        q, dq, ddq = (np.asarray(curve(t, order)) for order in range(3))
        own = [given.joints.index(name) for name in given.of(arm.active_joints).joints]
        flange = flange_motion(arm, t, MotionState(q[:, own], dq[:, own], ddq[:, own]))
        self.damping, expected = tool.damping, tool.frequency(flange.gravity[-1])
        self.frequency = expected.value
        spread = max(TIMING_SPREAD, (expected.high - expected.low) / (2.0 * LIKELY)
                     / expected.value)
        # squares of the tool at the frequency expected, and at two that are off
        more = expected.value**2 * (np.array([1.0, 1.0 - spread, 1.0 + spread])**2 - 1.0)
        self.squares = np.array(tool.squares) + np.outer(more, [1.0, 0.0, 0.0, 0.0])
        self.own = np.array(tool.participation)
        self.sizes = np.repeat(np.linalg.norm(self.own.reshape(2, 3), axis=1), 3)
        most = np.abs(ddq).max(axis=0)
        moves = most > 1e-9
        self.rows = np.hstack([flange.acceleration, flange.twist, flange.gravity,
                               ddq[:, moves] / most[moves], dq[:, moves] / most[moves]])
        # relative to a motion that hardly rings, nothing would be little
        rings = self.rings(t - t[0], self.rows, np.ones((count, 1)), np.zeros((count, 1)))
        drive = np.abs(flange.acceleration @ self.own)
        gross = 2.0 * math.pi * self.frequency * float(drive.mean()) * self.seconds
        self.size = max(float(np.abs(rings[:7]).max()), TIMING_LEAST * gross, 1e-12)

    def at(self, s: FloatArray) -> FloatArray:
        """Give the rows at times of the given trajectory [s]."""
        place = np.clip(s / self.seconds, 0.0, 1.0) * (len(self.rows) - 1)
        k = np.minimum(place.astype(int), len(self.rows) - 2)
        share = (place - k)[:, None]
        return np.asarray((1.0 - share) * self.rows[k] + share * self.rows[k + 1])

    def rings(self, t: FloatArray, rows: FloatArray, rate: FloatArray, slope: FloatArray,
              ) -> FloatArray:
        """Give the rings at the end, complex (21,), of rows passed at a rate (samples, 1)."""
        moving = rows[:, :6] * rate**2 + rows[:, 6:12] * slope
        # the arm rests until it begins, maybe with a jump of the acceleration
        flange = Flange(np.append(t[0], t), np.vstack([0.0 * moving[:1], moving]), np.empty(0),
                        np.vstack([rows[:1, 12:15], rows[:, 12:15]]), np.empty(0))
        parts = np.array([free_ring(flange, squares, self.damping) for squares in self.squares])
        return np.hstack([parts @ self.own[:, None], TIMING_ASIDE * parts * self.sizes]).ravel()


class _Timing:
    """Timings of a path that take a given time; their rate ds/dt is a cubic spline."""

    def __init__(self, path: _Path, longer: float) -> None:
        self.path, end = path, path.seconds + longer
        self.t = np.linspace(0.0, end, int(round(end / TOOL_STEP)) + 1)
        self.count = max(TIMING_FEWEST, int(end / TIMING_KNOT))
        knots = np.concatenate([[0.0] * 3, np.linspace(0.0, end, self.count - 2), [end] * 3])
        basis = BSpline(knots, np.eye(self.count), 3)
        self.rate, self.slope, self.place = (np.asarray(curve(self.t)) for curve in (
            basis, basis.derivative(), basis.antiderivative()))

    def parts(self, c: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give rows, rate and its slope of a timing."""
        return (self.path.at(self.place @ c), (self.rate @ c)[:, None], (self.slope @ c)[:, None])

    def rings(self, c: FloatArray) -> FloatArray:
        """Give the rings of a timing, complex (21,)."""
        return self.path.rings(self.t, *self.parts(c))

    def allowed(self, c: FloatArray) -> bool:
        """Say whether no joint is faster, nor accelerates more, than in the given trajectory."""
        rows, rate, slope = self.parts(c)
        half = (rows.shape[1] - 15) // 2
        used = np.abs(rows[:, 15:15 + half] * rate**2 + rows[:, 15 + half:] * slope)
        return bool(used.max() <= 1.0 and rate.max() <= 1.0 and rate.min() > 0.0)

    def search(self) -> tuple[FloatArray, FloatArray]:
        """Search the timing after which least rings; with the rings, over those given."""
        c = np.full(self.count, self.path.seconds / self.t[-1])
        here = self.rings(c) / self.path.size
        radius = 0
        for _ in range(TIMING_ROUNDS):
            if (WEIGHT * np.abs(here)).max() <= TIMING_GOOD:
                break
            changes = TIMING_NUDGE * np.eye(self.count)
            slopes = np.array([self.rings(c + one) / self.path.size - here
                               for one in changes]).T / TIMING_NUDGE
            while radius < len(TIMING_RADII):
                found = self._better(c, here, slopes, TIMING_RADII[radius])
                if found is not None:
                    break
                radius += 1
            else:
                break
            c, here = found
        return c, np.abs(here)

    def _better(self, c: FloatArray, here: FloatArray, slopes: FloatArray, radius: float,
                ) -> tuple[FloatArray, FloatArray] | None:
        """Solve the linear programme; None where it brings nothing."""
        rows, rate, slope = (part[::TIMING_EVERY] for part in self.parts(c))
        of_rate, of_slope = self.rate[::TIMING_EVERY], self.slope[::TIMING_EVERY]
        half = (rows.shape[1] - 15) // 2
        a, v = rows[:, 15:15 + half], rows[:, 15 + half:]
        used = (a * rate**2 + v * slope).ravel()
        changes = ((2.0 * a * rate)[:, :, None] * of_rate[:, None] + v[:, :, None]
                   * of_slope[:, None]).reshape(-1, self.count)
        near = np.abs(used) + radius * np.abs(changes).sum(axis=1) > ROUNDING
        used, changes = used[near], changes[near]
        weighted, now = WEIGHT[:, None] * slopes, WEIGHT * here
        rings = np.vstack([weighted.real, weighted.imag])
        value = np.concatenate([now.real, now.imag])
        blocks = [(rings, -value, value, -1.0), (changes, 1.0 - used, 1.0 + used, 0.0),
                  (of_rate, 1.0 - rate[:, 0], rate[:, 0] - TIMING_SLOWEST, 0.0)]
        bound = [np.hstack([side * block, np.full((len(block), 1), last)])
                 for block, *_, last in blocks for side in (1.0, -1.0)]
        right = [np.maximum(limit, 0.0) if last == 0.0 else limit
                 for _, above, below, last in blocks for limit in (above, below)]
        step = solved(
            np.append(np.zeros(self.count), 1.0), bound, right,
            A_eq=np.append(self.place[-1], 0.0)[None],
            b_eq=[self.path.seconds - self.place[-1] @ c],
            bounds=[(-radius, radius)] * self.count + [(0.0, None)])
        if step is None:
            return None
        for share in (1.0, 0.5, 0.25):
            tried = c + share * step[:-1]
            left = self.rings(tried) / self.path.size
            if self.allowed(tried) and (WEIGHT * np.abs(left)).max() < (
                    WEIGHT * np.abs(here)).max():
                return tried, left
        return None

    def trajectory(self, given: Trajectory, c: FloatArray) -> Trajectory:
        """Give the trajectory of a timing."""
        s, rate, slope = self.place @ c, (self.rate @ c)[:, None], (self.slope @ c)[:, None]
        curve = spline(given)
        q, dq, ddq = (np.asarray(curve(given.t[0] + np.clip(s, 0.0, self.path.seconds), order))
                      for order in range(3))
        dq, ddq = dq * rate, ddq * rate**2 + dq * slope
        q[[0, -1]], dq[[0, -1]] = given.q[[0, -1]], 0.0
        return Trajectory(given.joints, given.t[0] + self.t, q, dq, ddq)
