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

The path ``q(s)`` stays, with ``s`` the time of the given trajectory; the square ``z(s)`` of the
rate ``ds/dt`` is sought. With the flange's acceleration ``a(s)`` and twist ``v(s)`` of the given
trajectory, that of the new one is ``a z + v z' / 2``: linear in z, and so are the accelerations of
joints (Verscheure et al.: Time-optimal path tracking for robots, IEEE Trans. Automatic Control 54,
2009). The ring that this leaves is linear in small changes of z, so that linear programmes in turn
reduce it, as in ``signals/shaping.py``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import maximum_filter1d

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import effort_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle, tool_of
from tudor_dynamics.models.flexible_tool import (
    flange_motion, FlexibleTool, LIKELY, modes_of, row_of)
from tudor_dynamics.models.settings import (
    TIMING_CUTS, TIMING_FEWEST, TIMING_FULL, TIMING_GOOD, TIMING_KNOT, TIMING_LEAST, TIMING_LONGER,
    TIMING_MOST, TIMING_NEAR, TIMING_OFF, TIMING_RADIUS, TIMING_ROUNDS, TIMING_SAME,
    TIMING_SLOWEST, TIMING_SMALL, TIMING_SPREAD, TIMING_WINDOW, TIMING_WORTH, TOOL_STEP)
from tudor_dynamics.models.tool_motion import end_slopes, follow, from_rest
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.signals.shaping import check_at_rest, convolved, impulses, solved
from tudor_dynamics.typing import FloatArray

TIMING = 'timing'  # the kind of shaping beside those by impulses
WEIGHT = np.array([1.0, TIMING_GOOD / TIMING_OFF, TIMING_GOOD / TIMING_OFF])[:, None]
"""Of the rings at the frequencies expected, at lower and at higher ones."""


def still_timing(
    arm: Arm, tool: FlexibleTool, given: Trajectory, effort: Model | None = None,
) -> Trajectory:
    """
    Change when a trajectory passes its path, so that a tool at the flange is still at its end.

    No joint is faster than at the same place of the given trajectory, nor accelerates more than it
    does anywhere, nor needs more than its limit by a model of efforts, unless it does as given or
    slowly. A SignalError if it does not lead from rest to rest, or no timing is found.
    """
    if given.dq is None or len(given.t) < 2:
        raise SignalError('the trajectory has no velocities',
                          remedy='give them, or shape it by zv or zvd')
    check_at_rest(given)
    for window in (TIMING_WINDOW, math.inf):  # the end suffices, unless it hardly moves the tool
        timing = _Timing(arm, tool, given, effort, window)
        c, left = timing.shortest()
        if left <= TIMING_MOST:
            return timing.trajectory(given, c)
        if timing.first == 0:
            break
    raise SignalError(f'no timing of this path leaves the tool still, as {100.0 * left:.0f} % of '
                      'the ring remain', remedy='begin more slowly, or shape it by zv or zvd')


def shaped_for(bundle: ModelBundle, given: Trajectory, kind: str) -> Trajectory:
    """Shape a trajectory by its timing, or by impulses for the tool where it ends."""
    arm, tool = bundle.arm, tool_of(bundle)
    if kind == TIMING:
        return still_timing(arm, tool, given, bundle.models.get('effort', {}).get('analytical'))
    modes = [one.value for one in tool.frequency_at(arm, given.of(arm.active_joints).q[-1])]
    if modes[-1] < (1.0 + TIMING_SAME) * modes[0]:
        modes = [math.sqrt(modes[0] * modes[-1])]
    for frequency in modes:
        given = convolved(given, impulses(kind, frequency, float(np.mean(tool.damping))))
    return given


class _Timing:
    """
    A trajectory at even times, and how it rings at other rates in a window up to its end.

    The square of the rate is a cubic spline of coefficients ``c`` (count,).
    """

    def __init__(
        self, arm: Arm, tool: FlexibleTool, given: Trajectory, effort: Model | None,
        window: float,
    ) -> None:
        self.seconds = float(given.t[-1] - given.t[0])
        # an even number of steps, of which every second is one of the tool; eight or more between
        # knots, as limits hold at their ends alone
        count = 2 * max(math.ceil(0.5 * self.seconds / TOOL_STEP), 4 * TIMING_FEWEST) + 1
        self.step = self.seconds / (count - 1)
        t = np.linspace(given.t[0], given.t[-1], count)
        curve = spline(given)
        q, dq, ddq = (np.asarray(curve(t, order)) for order in range(3))
        own = [given.joints.index(name) for name in given.of(arm.active_joints).joints]
        states = MotionState(q[:, own], dq[:, own], ddq[:, own])
        flange = flange_motion(arm, t[::2], MotionState(q[::2, own], dq[::2, own], ddq[::2, own]))
        gravity = flange.motion[-1, 9:]
        expected = tool.frequency(gravity)
        self.frequency = expected[0].value
        spread = max(TIMING_SPREAD, *((one.high - one.low) / (2.0 * LIKELY) / one.value
                                      for one in expected))
        # the tool at the frequencies expected, and at lower and higher ones
        self.rows = np.tile(row_of(tool.parameters), (3, 1))
        self.rows[:, 13:15] *= np.array([[1.0], [1.0 - spread], [1.0 + spread]]) ** 2
        self.modes = [modes_of(row, gravity) for row in self.rows]
        # relative to a motion that hardly rings, nothing would be little
        drive = np.linalg.norm((flange.motion[:, :3] + np.cross(flange.motion[:, 3:6], tool.place))
                               @ self.rows[0, 3:9].reshape(2, 3).T, axis=1)
        gross = float(drive.mean()) * self.seconds / (2.0 * math.pi * self.frequency)
        swings = np.array([from_rest(row, 2.0 * self.step, flange.motion) for row in self.rows])
        self.size = 1.0
        rings = self.rings_of(swings[:, -1])
        if not np.isfinite(rings).all():
            raise SignalError('the trajectory bends the tool further than its model knows',
                              remedy='move more slowly, or shape it by zv or zvd')
        self.size = max(float(np.abs(rings[0]).max()), TIMING_LEAST * gross, 1e-12)

        self.first = max(count - 1 - 2 * round(0.5 * min(window, self.seconds) / self.step), 0)
        self.begin = swings[:, self.first // 2]
        self.flange = np.hstack([flange.motion[:, :6], flange.velocity,
                                 flange.motion[:, 6:]])[self.first // 2:]
        most = np.abs(ddq).max(axis=0)
        loads = [np.stack([ddq, 0.0 * q, 0.5 * dq, 0.0 * q])[:, :, most > 1e-9]
                 / most[most > 1e-9]]
        allowed = effort_limits(arm)
        if effort is not None and np.isfinite(allowed).any():
            loads.append(_efforts(effort, allowed, states))
        self.loads = np.concatenate(loads, axis=2)[:, self.first:]

        s: FloatArray = self.step * np.arange(count - self.first, dtype=float)
        length = float(s[-1])
        self.count = max(TIMING_FEWEST, int(length / TIMING_KNOT))
        self.knots = np.concatenate(
            [[0.0] * 3, np.linspace(0.0, length, self.count - 2), [length] * 3])
        basis = BSpline(self.knots, np.eye(self.count), 3)
        self.square, self.slope = (np.asarray(basis(s, order)) for order in (0, 1))
        before = np.abs(self.needs(np.ones(self.count)))
        # the trajectory itself is always allowed
        self.most = np.maximum(TIMING_FULL * np.maximum(1.0, before.max(axis=0)), before)
        self.tight = np.zeros(self.most.shape)  # the sign of limits that bound a timing

    def rings_of(self, ends: FloatArray) -> Any:
        """Give the rings of states at the end (3, 4), complex (3, modes)."""
        return np.array([modes.of(end) for modes, end in zip(
            self.modes, ends, strict=True)]) / self.size

    def needs(self, c: FloatArray) -> FloatArray:
        """Give accelerations and efforts over what is allowed, (samples, ...)."""
        z = (self.square @ c)[:, None]
        of_z, of_rate, of_slope, rest = self.loads
        return np.asarray(of_z * z + of_rate * np.sqrt(z) + of_slope * (self.slope @ c)[:, None]
                          + rest)

    def motion(self, c: FloatArray) -> FloatArray:
        """Give the motion of the flange, see ``tool_motion``."""
        z, flange = (self.square[::2] @ c)[:, None], self.flange
        return np.hstack([
            flange[:, :6] * z + flange[:, 6:12] * 0.5 * (self.slope[::2] @ c)[:, None],
            flange[:, 9:12] * np.sqrt(z), flange[:, 12:]])

    def steps(self, c: FloatArray) -> FloatArray:
        """Give how long each step of the flange takes [s]."""
        rate = np.sqrt(self.square[::2] @ c)
        return np.asarray(4.0 * self.step / (rate[1:] + rate[:-1]))

    def rings(self, c: FloatArray) -> Any:
        """Give the rings of a timing, complex (3, modes)."""
        motion, steps = self.motion(c), self.steps(c)
        return self.rings_of(np.array([follow(row, steps, motion, begin)[-1] for row, begin in zip(
            self.rows, self.begin, strict=True)]))

    def longer(self, c: FloatArray) -> float:
        """Give how much longer a timing takes [s]."""
        return float(self.steps(c).sum()) - float(self.knots[-1])

    def changes(self, c: FloatArray) -> tuple[Any, FloatArray]:
        """Give what each coefficient does to the rings, complex (3, modes, count), and to time."""
        flange, motion, steps = self.flange, self.motion(c), self.steps(c)
        rate = np.sqrt(self.square[::2] @ c)[:, None]
        none = np.zeros((len(flange), 3))
        ways = np.stack([np.hstack([flange[:, :6], 0.5 * flange[:, 9:12] / rate, none]),
                         np.hstack([0.5 * flange[:, 6:12], none, none])])

        def by_square(of_steps: FloatArray) -> FloatArray:
            sums = np.zeros((*of_steps.shape[:-1], len(flange)))
            shares = of_steps * steps**2 / (8.0 * self.step)
            sums[..., 1:] += shares
            sums[..., :-1] += shares
            return -sums / rate[:, 0]
        found = []
        for row, modes, begin in zip(self.rows, self.modes, self.begin, strict=True):
            states = follow(row, steps, motion, begin)
            ends, of_steps = end_slopes(row, steps, motion, states, ways)
            found.append(modes.rows @ ((ends[:, 0] + by_square(of_steps)) @ self.square[::2]
                                       + ends[:, 1] @ self.slope[::2]))
        return np.array(found) / self.size, by_square(np.ones(len(steps))) @ self.square[::2]

    def shortest(self) -> tuple[FloatArray, float]:
        """Search the shortest timing after which little rings; what is left over that given."""
        # evenly slower, as near as a search has to begin
        slow = (1.0 + TIMING_LONGER[0] / self.frequency / float(self.knots[-1]))**-2
        c = np.full(self.count, slow)
        if self.first > 0:
            c = np.append([1.0] * 3, np.linspace(1.0, slow, self.count - 3))
        if not self.allowed(c, TIMING_LONGER[0] / self.frequency):
            c = np.ones(self.count)
        best = c, math.inf
        for longer in TIMING_LONGER:
            c, left = self.search(c, longer / self.frequency)
            if left < best[1]:
                best = c, left
            if left <= TIMING_GOOD:
                break
        return best

    def search(self, c: FloatArray, longer: float) -> tuple[FloatArray, float]:
        """Search the timing after which least rings, no more than so much longer [s]."""
        here, radius = self.rings(c), TIMING_RADIUS
        for _ in range(TIMING_ROUNDS):
            left = loudest(here)
            step = None if left <= TIMING_GOOD else self.programme(c, here, longer, radius)
            if step is None:
                break
            for share in (1.0, 0.5):
                tried = c + share * step
                rings = self.rings(tried)
                if loudest(rings) < left and self.allowed(tried, longer):
                    c, here = tried, rings
                    break
            else:
                radius *= 0.3
                continue
            if loudest(here) > TIMING_WORTH * left:
                break
        return c, loudest(here)

    def allowed(self, c: FloatArray, longer: float) -> bool:
        """Say whether a timing keeps to the limits, and to the time."""
        return bool((np.abs(self.needs(c)) <= self.most * (1.0 + TIMING_NEAR)).all()
                    and self.longer(c) <= longer + TIMING_NEAR)

    def programme(
        self, c: FloatArray, here: Any, longer: float, radius: float,
    ) -> FloatArray | None:
        """Solve the linear programme, with the limits that bound its solution."""
        slopes, of_time = self.changes(c)
        weighted, now = (WEIGHT[:, :, None] * slopes).reshape(-1, self.count), WEIGHT * here
        rings = np.vstack([weighted.real, weighted.imag, -weighted.real, -weighted.imag])
        value = np.concatenate([now.real, now.imag, -now.real, -now.imag], axis=None)
        needs, rate = self.needs(c), np.sqrt(self.square @ c)[:, None]
        spare = longer - self.longer(c)
        # of steps that bring nearly as much the smallest, for which slopes hold best
        each = np.vstack([np.eye(self.count), -np.eye(self.count)])
        small = np.hstack([each, np.zeros((len(each), 1)), -np.ones((len(each), 1))])
        # a spline is nowhere beyond its coefficients
        low = np.maximum(-radius * c, TIMING_SLOWEST**2 - c)
        high = np.minimum(radius * c, 1.0 - c)
        if self.first > 0:
            low[:3] = high[:3] = 0.0  # it begins at the rate given, which does not change there
        ends = [*zip(low, high, strict=True), (0.0, None), (0.0, None)]
        excess, late = np.zeros_like(needs), 0.0
        step: FloatArray | None = None
        for _ in range(TIMING_CUTS):
            k, j = np.nonzero(self.tight)
            limits = self.tight[k, j, None] * (
                (self.loads[0] + 0.5 * self.loads[1] / rate)[k, j, None] * self.square[k]
                + self.loads[2][k, j, None] * self.slope[k])
            bound = [np.hstack([rings, np.tile([-1.0, 0.0], (len(rings), 1))]), small,
                     np.hstack([limits, np.zeros((len(k), 2))]),
                     np.append(of_time, [0.0, 0.0])[None]]
            found = solved(
                np.append(np.zeros(self.count), [1.0, TIMING_SMALL * loudest(here)]), bound,
                [-value, np.zeros(len(each)), (self.most - self.tight * needs - excess)[k, j],
                 np.array([spare - late])], bounds=ends)
            if found is None:
                return step
            step = found[:-2]
            if self.allowed(c + step, longer):
                return step
            after = self.needs(c + step)
            over = np.maximum(np.abs(after) - self.most, 0.0)
            late += max(self.longer(c + step) - longer, 0.0)
            excess += np.where(self.tight, over, 0.0)
            peaks = (over > 0.0) & (over == maximum_filter1d(over, 5, axis=0))
            self.tight[peaks] = np.sign(after[peaks])
        return step

    def trajectory(self, given: Trajectory, c: FloatArray) -> Trajectory:
        """Give the trajectory of a timing."""
        square, step, begin = BSpline(self.knots, c, 3), self.step, self.first * self.step
        nodes, weights = np.polynomial.legendre.leggauss(3)

        def passed(low: FloatArray, high: FloatArray) -> FloatArray:
            half = 0.5 * (high - low)[:, None]
            rates = np.sqrt(square(low[:, None] + half * (1.0 + nodes)))
            return np.asarray((half / rates) @ weights)
        grid: FloatArray = step * np.arange(len(self.square), dtype=float)
        t = begin + np.append(0.0, np.cumsum(passed(grid[:-1], grid[1:])))
        out = np.linspace(0.0, t[-1], round(t[-1] / TOOL_STEP) + 1)
        k = np.clip(np.searchsorted(t, out, 'right') - 1, 0, len(t) - 2)
        s = np.interp(out, t, grid)
        for _ in range(3):  # by Newton's method
            s -= (t[k] + passed(grid[k], s) - np.maximum(out, begin)) * np.sqrt(square(s))
            s = np.clip(s, 0.0, grid[-1])
        rate = np.sqrt(square(s))[:, None]
        slope = 0.5 * np.asarray(square(s, 1))[:, None]
        curve = spline(given)
        place = np.clip(np.where(out < begin, out, begin + s), 0.0, self.seconds)
        q, dq, ddq = (np.asarray(curve(given.t[0] + place, order)) for order in range(3))
        dq, ddq = dq * rate, ddq * rate**2 + dq * slope
        q[[0, -1]], dq[[0, -1]] = given.q[[0, -1]], 0.0
        return Trajectory(given.joints, given.t[0] + out, q, dq, ddq)


def loudest(rings: Any) -> float:
    """Give the loudest ring, those of frequencies that are off by their weight."""
    return float((WEIGHT * np.abs(rings)).max())


def _efforts(model: Model, allowed: FloatArray, motion: MotionState) -> FloatArray:
    """Give efforts over what is allowed: by rate squared, rate and its slope, and the rest."""
    q, dq, ddq = motion.q, motion.dq, motion.ddq
    rates = np.array([TIMING_SLOWEST, 0.5, 1.0])
    *steady, whole, more = (model.predict(np.hstack([q, *states])) for states in (
        *((rate * dq, 0.0 * q) for rate in rates), (dq, ddq), (dq, ddq + dq)))
    square, linear, rest = np.tensordot(np.linalg.inv(np.vander(rates)), steady, 1)
    most = np.maximum(allowed, np.abs([whole, steady[0]]).max(axis=(0, 1)))
    return (np.stack([square + whole - steady[2], linear, 0.5 * (more - whole), rest]) / most)[
        :, :, np.isfinite(most)]
