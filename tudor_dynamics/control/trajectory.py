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
Paths along a trajectory, from where the reference is, as a joint trajectory controller drives it.

A path is checked whole against the hard limits before its first sample moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BPoly, PPoly

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline
from tudor_dynamics.typing import FloatArray

ROUNDING = 1e-6
"""So little beyond a limit is at it: messages of planners in single precision end there
[rad, rad/s, rad/s^2; m, m/s, m/s^2]."""
WRONG_JOINTS, LATE = 'wrong joints', 'all points are in the past'
"""How the reasons begin for which a trajectory is refused by its names, and by its start."""


def of_all(
    trajectory: Trajectory, names: Sequence[str],
    rest: FloatArray,  # positions of those that it does not name
    partial: bool,  # whether it may leave some out
) -> Trajectory:
    """Give a trajectory of all joints in their order; SignalError where names do not fit."""
    given = trajectory.joints
    found = [f'{what}: {", ".join(some)}' for what, some in (
        ('unknown', [name for name in given if name not in names]),
        ('twice', sorted({name for name in given if given.count(name) > 1})),
        ('missing', [name for name in names if name not in given and not partial])) if some]
    if found:
        raise SignalError(f'{WRONG_JOINTS}, {"; ".join(found)}',
                          remedy=f'the joints are {", ".join(names)}')
    places = [names.index(name) for name in given]

    def whole(values: FloatArray | None, others: FloatArray) -> FloatArray | None:
        if values is None:
            return None
        table = np.tile(others, (len(trajectory.t), 1))
        table[:, places] = values
        return table
    q, none = whole(trajectory.q, rest), np.zeros(len(names))
    assert q is not None
    return Trajectory(tuple(names), trajectory.t, q, whole(trajectory.dq, none),
                      whole(trajectory.ddq, none))


def braking(state: MotionState, bounds: Limits, least: float) -> tuple[float, FloatArray]:
    """Give when and where joints rest that brake together, not before a least time [s]."""
    time = max(float(np.max(np.abs(state.dq) / bounds.acceleration)), least)
    return time, np.clip(state.q + 0.5 * time * state.dq, bounds.lower, bounds.upper)


def from_state(trajectory: Trajectory, state: MotionState, begin: float) -> Trajectory:
    """Give the path from a state, at a time since the start [s], through the points after it."""
    left = trajectory.t > begin
    if not left.any():
        msg = f'{LATE}: the last one was due {begin - trajectory.t[-1]:.3g} s ago'
        raise SignalError(msg, remedy='set header.stamp to the time of the start, or to 0 for now')

    def joined(first: FloatArray, rest: FloatArray | None) -> FloatArray | None:
        # what the points do not have is not kept of the state
        return None if rest is None else np.vstack([first, rest[left]])
    return replace(
        trajectory, t=np.append(begin, trajectory.t[left]), effort=None,
        q=np.vstack([state.q, trajectory.q[left]]), dq=joined(state.dq, trajectory.dq),
        ddq=joined(state.ddq, trajectory.ddq))


class Path:
    """Path from a state through the points of a trajectory, at rest after the last one."""

    def __init__(self, state: MotionState, trajectory: Trajectory, begin: float = 0.0) -> None:
        joined = from_state(trajectory, state, begin)
        if joined.dq is not None and np.any(np.abs(joined.dq[-1]) > ROUNDING):
            raise SignalError('the last point is in motion', remedy='end the trajectory at rest')
        self.begin, self.end = begin, float(trajectory.t[-1])  # since the trajectory's start [s]
        self.target = trajectory.q[-1]
        self._names = trajectory.joints
        self._smooth = trajectory.dq is not None
        self._q = spline(joined)
        self._dq, self._ddq = self._q.derivative(), self._q.derivative(2)

    def at(self, time: float) -> MotionState:
        """Give the state at a time since the start of the trajectory [s]."""
        if time >= self.end:
            rest = np.zeros_like(self.target)
            return MotionState(self.target.copy(), rest, rest.copy())
        time = max(time, self.begin)
        return MotionState(self._q(time), self._dq(time), self._ddq(time))

    def beyond(self, limits: Limits) -> str:
        """Say where the path leaves limits; empty where it keeps to them."""
        parts = [('position', self._q, limits.lower, limits.upper),
                 ('velocity', self._dq, -limits.velocity, limits.velocity)]
        if self._smooth:  # straight lines jump in velocity at the points
            parts.append(('acceleration', self._ddq, -limits.acceleration, limits.acceleration))
        for what, curve, lower, upper in parts:
            lower, upper = lower - ROUNDING, upper + ROUNDING
            # a Bernstein polynomial stays within its coefficients: beyond them, look closer
            suspect = ((curve.c < lower) | (curve.c > upper)).any(axis=(0, 1))
            for k in np.flatnonzero(suspect):
                values = _extremes(curve, int(k))
                wrong = values[(values < lower[k]) | (values > upper[k])]
                if wrong.size:
                    return (f'{self._names[k]} reaches {what} {wrong[np.abs(wrong).argmax()]:.4g}'
                            f', outside {lower[k]:.4g} .. {upper[k]:.4g}')
        return ''


class Follower:
    """Drives along trajectories, one after the other, each from its start on."""

    def __init__(self, bounds: Limits) -> None:
        self.bounds = bounds  # what a path may not leave
        self.path: Path | None = None  # what is driven
        self._time = 0.0
        self.coming: Trajectory | None = None  # what begins later
        self._since = 0.0

    @property
    def progress(self) -> tuple[float, float] | None:
        """Time since the start of a trajectory, below 0 before it, and when it ends [s]."""
        if self.path is not None:
            return self._time, self.path.end
        return None if self.coming is None else (self._since, float(self.coming.t[-1]))

    @property
    def state(self) -> MotionState | None:
        """Where the path is now, with its acceleration."""
        return None if self.path is None else self.path.at(self._time)

    def take(self, trajectory: Trajectory, since: float, state: MotionState, resting: bool) -> str:
        """
        Take a trajectory that began a time ago, or begins later where that is below zero [s].

        What is driven goes on until then. Empty if it is taken, otherwise why not: of a later one
        it is checked here what is known here, and the rest where it begins. state: of the
        reference; resting: whether it is to stay there.
        """
        if since >= 0.0:
            return self._begin(trajectory, since, state)
        if self.path is not None:
            state = self.path.at(self._time - since)
        elif not resting:  # on the way to a goal: its own points are known
            state = Path(state, trajectory).at(float(trajectory.t[0]))
        why = Path(state, trajectory).beyond(self.bounds)
        if not why:
            self.coming, self._since = trajectory, since
        return why

    def leave(self) -> None:
        """Follow nothing any more, and begin nothing later."""
        self.path = self.coming = None

    def step(self, dt: float, state: MotionState) -> tuple[MotionState | None, str]:
        """Give the next state, None without a trajectory, and why one due now does not begin."""
        if self.coming is not None:
            trajectory = self.coming
            self._since += dt
            if self._since > 0.0:
                self.coming = None
                self._time += dt - self._since  # what is driven goes on until the start
                if why := self._begin(trajectory, 0.0, state):
                    self.leave()
                    return None, why
                self._time = self._since - dt
        if self.path is None:
            return None, ''
        self._time += dt
        reached = self.path.at(self._time)
        if self._time >= self.path.end:
            self.path = None
        return reached, ''

    def _begin(self, trajectory: Trajectory, since: float, state: MotionState) -> str:
        path = Path(self.state or state, trajectory, since)
        why = path.beyond(self.bounds)
        if not why:
            self.path, self._time, self.coming = path, since, None
        return why


def _extremes(curve: BPoly, joint: int) -> FloatArray:
    """Give the values of a joint at both ends of all pieces, and where it turns between."""
    own = BPoly(curve.c[:, :, joint], curve.x)
    ends = np.concatenate([own.c[0], own.c[-1]])
    if len(own.c) < 3:
        return ends
    times = PPoly.from_bernstein_basis(own.derivative()).roots(extrapolate=False)
    return np.concatenate([ends, own(times[np.isfinite(times)])])
