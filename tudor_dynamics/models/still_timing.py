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
``a s'^2 + v s''``. The ring that this leaves is linear in small changes of ``s'``, so that linear
programmes in turn reduce it, as in ``signals/shaping.py``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import effort_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle, tool_of
from tudor_dynamics.models.flexible_tool import (
    flange_motion, FlexibleTool, LIKELY, modes_of, row_of)
from tudor_dynamics.models.settings import (
    TIMING_EVERY, TIMING_FEWEST, TIMING_GOOD, TIMING_KNOT, TIMING_LEAST, TIMING_LONGER,
    TIMING_MOST, TIMING_OFF, TIMING_RADII, TIMING_ROUNDS, TIMING_SAME, TIMING_SLOWEST,
    TIMING_SPREAD, TOOL_STEP)
from tudor_dynamics.models.tool_motion import end_slopes, follow
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.signals.settings import ROUNDING
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
    path = _Path(arm, tool, given, effort)
    found: list[tuple[float, _Timing, FloatArray]] = []
    for longer in TIMING_LONGER:
        timing = _Timing(path, longer / path.frequency)
        rate, rings = timing.search()
        found.append((float((WEIGHT * rings).max()), timing, rate))
        if found[-1][0] <= TIMING_GOOD:
            break  # the shortest
    left, timing, rate = min(found, key=lambda one: one[0])
    if left > TIMING_MOST:
        raise SignalError(f'no timing of this path leaves the tool still: {100.0 * left:.0f} % of '
                          'the ring remain', remedy='begin more slowly, or shape it by zv or zvd')
    return timing.trajectory(given, rate)


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


class _Path:
    """What a trajectory does, at even times, and how it rings."""

    def __init__(
        self, arm: Arm, tool: FlexibleTool, given: Trajectory, effort: Model | None,
    ) -> None:
        self.seconds = float(given.t[-1] - given.t[0])
        count = max(int(round(self.seconds / TOOL_STEP)), TIMING_FEWEST) + 1
        t = np.linspace(given.t[0], given.t[-1], count)
        curve = spline(given)
        q, dq, ddq = (np.asarray(curve(t, order)) for order in range(3))
        own = [given.joints.index(name) for name in given.of(arm.active_joints).joints]
        states = MotionState(q[:, own], dq[:, own], ddq[:, own])
        flange = flange_motion(arm, t, states)
        gravity = flange.motion[-1, 9:]
        expected = tool.frequency(gravity)
        self.frequency = expected[0].value
        spread = max(TIMING_SPREAD, *((one.high - one.low) / (2.0 * LIKELY) / one.value
                                      for one in expected))
        # the tool at the frequencies expected, and at lower and higher ones
        self.rows = np.tile(row_of(tool.parameters), (3, 1))
        self.rows[:, 13:15] *= np.array([[1.0], [1.0 - spread], [1.0 + spread]]) ** 2
        self.modes = [modes_of(row, gravity) for row in self.rows]
        most = np.abs(ddq).max(axis=0)
        loads = [np.stack([ddq, 0.0 * q, dq, 0.0 * q])[:, :, most > 1e-9] / most[most > 1e-9]]
        allowed = effort_limits(arm)
        if effort is not None and np.isfinite(allowed).any():
            loads.append(_efforts(effort, allowed, states))
        self.table = np.hstack([flange.motion[:, :6], flange.velocity, flange.motion[:, 6:],
                                *np.concatenate(loads, axis=2)])
        self.slopes = np.gradient(self.table[:, :15], self.seconds / (count - 1), axis=0)
        # relative to a motion that hardly rings, nothing would be little
        motion = motion_of(self.table, np.ones((count, 1)), np.zeros((count, 1)))
        drive = np.linalg.norm((motion[:, :3] + np.cross(motion[:, 3:6], tool.place))
                               @ self.rows[0, 3:9].reshape(2, 3).T, axis=1)
        gross = float(drive.mean()) * self.seconds / (2.0 * math.pi * self.frequency)
        self.size = 1.0
        rings = self.rings(self.seconds / (count - 1), motion)
        if not np.isfinite(rings).all():
            raise SignalError('the trajectory bends the tool further than its model knows',
                              remedy='move more slowly, or shape it by zv or zvd')
        self.size = max(float(np.abs(rings[0]).max()), TIMING_LEAST * gross, 1e-12)

    def at(self, table: FloatArray, s: FloatArray) -> FloatArray:
        """Give the rows of a table at times of the given trajectory [s]."""
        place = np.clip(s / self.seconds, 0.0, 1.0) * (len(table) - 1)
        k = np.minimum(place.astype(int), len(table) - 2)
        share = (place - k)[:, None]
        return np.asarray((1.0 - share) * table[k] + share * table[k + 1])

    def rings(self, step: float, motion: FloatArray) -> Any:
        """Give the rings at the end of a motion, complex (3, modes)."""
        return np.array([modes.of(follow(row, step, motion)[-1])
                         for row, modes in zip(self.rows, self.modes, strict=True)]) / self.size


def _efforts(model: Model, allowed: FloatArray, motion: MotionState) -> FloatArray:
    """Give efforts over what is allowed: by rate squared, rate and its slope, and the rest."""
    q, dq, ddq = motion.q, motion.dq, motion.ddq
    rates = np.array([TIMING_SLOWEST, 0.5, 1.0])
    *steady, whole, more = (model.predict(np.hstack([q, *states])) for states in (
        *((rate * dq, 0.0 * q) for rate in rates), (dq, ddq), (dq, ddq + dq)))
    square, linear, rest = np.tensordot(np.linalg.inv(np.vander(rates)), steady, 1)
    most = np.maximum(allowed, np.abs([whole, steady[0]]).max(axis=(0, 1)))
    return (np.stack([square + whole - steady[2], linear, more - whole, rest]) / most)[
        :, :, np.isfinite(most)]


def motion_of(rows: FloatArray, rate: FloatArray, slope: FloatArray) -> FloatArray:
    """Give the motion of the flange, see ``tool_motion``, of rows of a path passed at a rate."""
    return np.hstack([rows[:, :6] * rate**2 + rows[:, 6:12] * slope, rows[:, 9:12] * rate,
                      rows[:, 12:15]])


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
        return (self.path.at(self.path.table, self.place @ c), (self.rate @ c)[:, None],
                (self.slope @ c)[:, None])

    def rings(self, c: FloatArray) -> Any:
        """Give the rings of a timing, complex (3, modes)."""
        return self.path.rings(float(self.t[1]), motion_of(*self.parts(c)))

    def changes(self, c: FloatArray) -> Any:
        """Give what each coefficient does to the rings, complex (3, modes, coefficients)."""
        path, step = self.path, float(self.t[1])
        rows, rate, slope = self.parts(c)
        motion, none = motion_of(rows, rate, slope), np.zeros((len(rows), 3))
        ways = np.stack([
            motion_of(path.at(path.slopes, self.place @ c), rate, slope),
            np.hstack([2.0 * rows[:, :6] * rate, rows[:, 9:12], none]),
            np.hstack([rows[:, 6:12], none, none])])
        found = []
        for row, modes in zip(path.rows, path.modes, strict=True):
            ends = end_slopes(row, step, motion, follow(row, step, motion), ways)
            found.append(modes.rows @ sum(ends[:, way] @ basis for way, basis in enumerate(
                (self.place, self.rate, self.slope))))
        return np.array(found) / path.size

    def used(self, c: FloatArray) -> FloatArray:
        """Give the largest accelerations and efforts over what is allowed."""
        rows, rate, slope = self.parts(c)
        square, linear, by_slope, rest = np.split(rows[:, 15:], 4, axis=1)
        return np.abs(square * rate**2 + linear * rate + by_slope * slope + rest).max(axis=0)

    def allowed(self, c: FloatArray, most: FloatArray) -> bool:
        """Say whether joints are no faster than as given, and use no more than most."""
        rate = self.rate @ c
        return bool(rate.max() <= 1.0 and rate.min() > 0.0 and (self.used(c) <= most).all())

    def search(self) -> tuple[FloatArray, FloatArray]:
        """Search the timing after which least rings; with the rings, over those given."""
        c = np.full(self.count, self.path.seconds / self.t[-1])
        here, most = self.rings(c), np.maximum(1.0, self.used(c))
        radius = 0
        for _ in range(TIMING_ROUNDS):
            if (WEIGHT * np.abs(here)).max() <= TIMING_GOOD:
                break
            slopes = self.changes(c)
            while radius < len(TIMING_RADII):
                found = self._better(c, here, slopes, TIMING_RADII[radius], most)
                if found is not None:
                    break
                radius += 1
            else:
                break
            c, here = found
        return c, np.abs(here)

    def _better(self, c: FloatArray, here: FloatArray, slopes: FloatArray, radius: float,
                most: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Solve the linear programme; None where it brings nothing."""
        rows, rate, slope = (part[::TIMING_EVERY] for part in self.parts(c))
        of_rate, of_slope = self.rate[::TIMING_EVERY], self.slope[::TIMING_EVERY]
        square, linear, by_slope, rest = np.split(rows[:, 15:], 4, axis=1)
        used = (square * rate**2 + linear * rate + by_slope * slope + rest).ravel()
        changes = ((2.0 * square * rate + linear)[:, :, None] * of_rate[:, None]
                   + by_slope[:, :, None] * of_slope[:, None]).reshape(-1, self.count)
        near = np.abs(used) + radius * np.abs(changes).sum(axis=1) > ROUNDING
        used, changes = used[near], changes[near]
        weighted = (WEIGHT[:, :, None] * slopes).reshape(-1, self.count)
        now = (WEIGHT * here).ravel()
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
            if self.allowed(tried, most):
                left = self.rings(tried)
                if (WEIGHT * np.abs(left)).max() < (WEIGHT * np.abs(here)).max():
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
