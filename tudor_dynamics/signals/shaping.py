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

"""Input shaping: ZV, ZVD, and moves from rest to rest that leave no oscillation."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals import settings
from tudor_dynamics.signals.motion_profile import MotionPlanner, spline
from tudor_dynamics.signals.settings import FINE, KNOTS, ROUNDING
from tudor_dynamics.typing import FloatArray


# -- Input shapers: a motion as the sum of itself and of itself somewhat later.
#
# An oscillation that the first part leaves is met by those of the next ones. The sum is a mean
# with positive weights: position, speed and acceleration stay within what the motion itself keeps
# to. ZV and ZVD: Singer and Seering, "Preshaping command inputs to reduce system vibration", ASME
# Journal of Dynamic Systems, Measurement, and Control 112(1), 1990; ZV goes back to O. J. M.
# Smith's posicast, 1957.

KINDS = ('zv', 'zvd')


@dataclass(frozen=True, eq=False)
class Impulses:
    """Impulses of a shaper."""

    time: FloatArray  # how late each is, ascending from 0, (n,) [s]
    weight: FloatArray  # positive, 1 in sum, (n,)


def impulses(kind: str, frequency: float, damping: float) -> Impulses:
    """Give the impulses after which a mode does not oscillate: frequency [Hz]."""
    if kind not in KINDS:
        raise SignalError(f'the shaper is {kind!r}; give {" or ".join(KINDS)}')
    if not 0.0 < frequency < math.inf:
        raise SignalError(f'frequency= {frequency:g} Hz: give a frequency above 0 Hz')
    if not 0.0 <= damping < 1.0:
        raise SignalError(f'the shaper damping ratio is {damping:g}; give 0 or more, below 1')
    root = math.sqrt(1.0 - damping**2)
    k = math.exp(-damping * math.pi / root)
    half = 0.5 / (frequency * root)
    weight = np.array([1.0, k] if kind == 'zv' else [1.0, 2.0 * k, k**2])
    return Impulses(half * np.arange(len(weight), dtype=float), weight / weight.sum())


def remains(shaper: Impulses, frequency: float, damping: float) -> float:
    """Give the part of an oscillation that a shaper leaves of a mode: frequency [Hz]."""
    omega = 2.0 * math.pi * frequency
    pole = omega * complex(damping, -math.sqrt(1.0 - damping**2))
    sums = shaper.weight @ np.exp(pole * (shaper.time - shaper.time[-1]))
    return float(abs(sums))


def check_at_rest(given: Trajectory) -> None:
    """Refuse a trajectory that does not lead from rest to rest, as far as its speeds are known."""
    if given.dq is not None and np.abs(given.dq[[0, -1]]).max() > settings.AT_REST:
        raise SignalError('the trajectory does not begin and end at rest',
                          remedy='give a trajectory whose first and last velocities are zero')


def convolved(given: Trajectory, shaper: Impulses) -> Trajectory:
    """Shape a trajectory that begins and ends at rest."""
    # between points that are those of all its copies, the sum of splines is a spline of the same
    # degree: what a controller makes of the result is exact, and within what the given one kept to
    check_at_rest(given)
    begin, end = float(given.t[0]), float(given.t[-1])
    t = np.unique(np.round(np.add.outer(shaper.time, given.t), 9))
    t = t[np.append(np.diff(t) > settings.APART, True)]
    orders = 1 + (given.dq is not None) + (given.ddq is not None and not given.ddq[[0, -1]].any())
    parts = np.zeros((orders, len(t), len(given.joints)))
    curves = [spline(given) if order == 0 else spline(given).derivative(order)
              for order in range(orders)] if len(given.t) > 1 else []
    for late, weight in zip(shaper.time, shaper.weight, strict=True):
        at = np.clip(t - late, begin, end)
        inside = ((t - late > begin) & (t - late < end))[:, None]
        for order, curve in enumerate(curves):
            parts[order] += weight * np.asarray(curve(at)) * (inside if order else 1.0)
    parts[0, [0, -1]], parts[1:, [0, -1]] = given.q[[0, -1]], 0.0
    return Trajectory(given.joints, t, *parts)


class ImpulseShaper:
    """Shapes a motion sample by sample, from rest at q (joints,) [rad]."""

    def __init__(self, shaper: Impulses, q: FloatArray) -> None:
        self.shaper = shaper
        self._t = 0.0
        self._past: deque[tuple[float, FloatArray]] = deque(
            [(0.0, np.stack([q, np.zeros_like(q), np.zeros_like(q)]))])

    @property
    def length(self) -> float:
        """How much longer a motion gets [s]."""
        return float(self.shaper.time[-1])

    def step(self, dt: float, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """Shape one sample of position, speed and acceleration: (3, joints)."""
        self._t += dt
        self._past.append((self._t, np.stack([q, dq, ddq])))
        while len(self._past) > 2 and self._past[1][0] <= self._t - self.length:
            self._past.popleft()
        shaped = np.zeros((3, len(q)))
        for late, weight in zip(self.shaper.time, self.shaper.weight, strict=True):
            shaped += weight * self._at(self._t - float(late))
        return shaped

    def _at(self, t: float) -> FloatArray:
        after = self._past[-1]
        for before in reversed(self._past):
            if before[0] <= t:
                span = after[0] - before[0]
                share = min((t - before[0]) / span, 1.0) if span > 0.0 else 0.0
                return before[1] + share * (after[1] - before[1])
            after = before
        return self._past[0][1]


# -- A move from rest to rest after which links do not oscillate, though their modes change on the
#    way.
#
# Each mode obeys ``y'' + 2 zeta w y' + w^2 y = sum_j b_j ddq_j`` with w, zeta and b of the pose.
# For slow changes its oscillation at the end T is, in complex form (Wentzel, Kramers, Brillouin),
#
#     y(T) + i y'(T) / w = int g(t) sum_j b_j(t) ddq_j(t) dt,
#     g(t) = exp(-int_t^T zeta w) (sin f + i cos f) / sqrt(w(t) w(T)),   f(t) = int_t^T w_d
#
# so that none is one linear condition on the acceleration. With acceleration linear between knots
# the move is a linear programme: limits of speed and acceleration, no way back, no oscillation of
# any mode, and among all such moves the one with the least jerk and the least oscillation of a
# first mode that is a little slower or faster than was thought.

@dataclass(frozen=True, eq=False)
class PathModes:
    """Modes along a path."""

    # (samples, modes): angular frequencies [rad/s] and damping ratios.
    omega: FloatArray
    damping: FloatArray
    drive: FloatArray  # what accelerations drive each mode with, (samples, modes, joints)
    size: FloatArray  # strain by which each mode counts, (modes,)


ModesAlong = Callable[[FloatArray], PathModes]
"""From a path, shape (n_samples, n_joints) [rad], to the modes on it."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A move, its acceleration linear between knots."""

    step: float  # time between knots [s]
    # At the knots, (knots, joints) [rad, rad/s, rad/s^2].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    @property
    def duration(self) -> float:
        """Length of the move [s]."""
        return self.step * (len(self.q) - 1)

    def at(self, t: float | FloatArray) -> FloatArray:
        """Give the motion (3, joints, ...) at times [s]; rest before and after it."""
        k = np.clip(np.asarray(t) / self.step, 0, len(self.q) - 2).astype(int)
        s = np.clip(t - k * self.step, 0.0, self.step)[..., None]
        jerk = (self.ddq[k + 1] - self.ddq[k]) / self.step
        return np.stack([
            self.q[k] + s * (self.dq[k] + s * (0.5 * self.ddq[k] + s * jerk / 6.0)),
            self.dq[k] + s * (self.ddq[k] + 0.5 * s * jerk), self.ddq[k] + s * jerk])


def oscillation(modes: PathModes, step: float, scale: float = 1.0) -> FloatArray:
    """Give each mode's oscillation at the end by acceleration: (samples, modes, joints)."""
    omega = scale * modes.omega
    left = np.zeros((2, *omega.shape))
    for kind, rate in enumerate((omega * np.sqrt(1.0 - modes.damping**2), omega * modes.damping)):
        part = 0.5 * step * (rate[1:] + rate[:-1])
        left[kind, :-1] = np.cumsum(part[::-1], axis=0)[::-1]
    wave = 1j * np.exp(-left[1] - 1j * left[0]) / np.sqrt(omega * omega[-1])
    return np.asarray((modes.size * wave)[:, :, None] * modes.drive)


def plan_shaped(
    start: FloatArray, target: FloatArray, limits: Limits, along: ModesAlong,
) -> Profile:
    """Plan a move that leaves no oscillation: start, target (joints,) [rad]."""
    plain = MotionPlanner(limits, start)
    plain.go(target)
    period = 2.0 * math.pi / float(along(target[None]).omega[0, 0])
    moving = np.abs(target - start) > 1e-9
    if not moving.any():
        raise SignalError('no joint has to move, as the arm is at the target already')
    for more in range(settings.TRIES):
        duration = plain.remaining + (settings.LONGER + 0.25 * more) * period
        s = np.linspace(0.0, 1.0, KNOTS + 1)[:, None]
        path = start + (s**3 * (10.0 - s * (15.0 - 6.0 * s))) * (target - start)
        found = None
        for _ in range(2):  # modes along what is found then
            found = _solve(start, target, limits, _denser(along(path)), duration, moving)
            if found is None:
                break
            path = found.q
        if found is not None:
            return found
    raise SignalError('no move without ringing found; raise joints[].planned or set shaping to zv')


def _denser(modes: PathModes) -> PathModes:
    """Interpolate between the knots."""
    fine = np.linspace(0.0, KNOTS, KNOTS * FINE + 1)
    k = np.minimum(fine.astype(int), KNOTS - 1)
    share = fine - k

    def between(values: FloatArray) -> FloatArray:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        return (1.0 - part) * values[k] + part * values[k + 1]
    return PathModes(between(modes.omega), between(modes.damping), between(modes.drive),
                     modes.size)


def _solve(
    start: FloatArray, target: FloatArray, limits: Limits, modes: PathModes,
    duration: float, moving: NDArray[np.bool_],
) -> Profile | None:
    """Solve the linear programme; None where there is no such move."""
    step = duration / KNOTS
    joints = np.flatnonzero(moving)
    way = (target - start)[joints]
    n, inner = len(joints), KNOTS - 1
    count = n * inner
    # knots are hats of acceleration, in units of the limit, forwards
    unit = limits.acceleration[joints] * np.sign(way) * ROUNDING
    fine = np.linspace(0.0, KNOTS, KNOTS * FINE + 1)
    hats = np.maximum(1.0 - np.abs(fine[:, None] - np.arange(1, KNOTS)[None]), 0.0)
    measure = np.full(len(fine), step / FINE)
    measure[[0, -1]] *= 0.5

    def oscillations(scale: float) -> FloatArray:
        weights = oscillation(modes, step / FINE, scale)[:, :, joints] * measure[:, None, None]
        rows = np.einsum('tk,tmj->mjk', hats, weights) * unit[None, :, None]
        flat = rows.reshape(len(modes.size), count)
        return np.vstack([flat.real, flat.imag])

    speed = speed_rows(step)
    reach = step * np.arange(KNOTS - 1, 0, -1) * step  # way by each hat
    plain = oscillations(1.0)
    scale = max(float(np.abs(plain).sum(axis=1).max()) / KNOTS, 1e-12)
    equal = [plain / scale]
    wanted = [np.zeros(len(plain))]
    off = np.vstack([oscillations(other)[[0, len(modes.size)]] / scale
                     for other in (1.0 - settings.SPREAD, 1.0 + settings.SPREAD)])
    change = np.diff(np.pad(np.eye(inner), ((1, 1), (0, 0))), axis=0)
    ends = np.stack([np.ones(inner), reach / reach.sum()])
    bound, right = [], []
    for j, own in enumerate(np.eye(n)):
        equal.append(np.kron(own, ends))
        wanted.append(np.array([0.0, float(abs(way[j])) / (abs(unit[j]) * reach.sum())]))
        block = np.kron(own, change)
        bound += [np.hstack([side * block, -np.ones((KNOTS, 1)), np.zeros((KNOTS, 1))])
                  for side in (1.0, -1.0)]
        right += [np.zeros(KNOTS)] * 2
        block = np.kron(own, speed * abs(unit[j]))
        most = float(limits.velocity[joints[j]]) * ROUNDING
        bound += [np.hstack([side * block / most, np.zeros((2 * KNOTS, 2))])
                  for side in (1.0, -1.0)]
        right += [np.ones(2 * KNOTS), np.zeros(2 * KNOTS)]
    bound += [np.hstack([side * off, np.zeros((len(off), 1)), -np.ones((len(off), 1))])
              for side in (1.0, -1.0)]
    right += [np.zeros(len(off))] * 2
    rows = np.vstack(equal)
    found = solved(
        np.concatenate([np.zeros(count), [1.0, settings.ROBUST]]), bound, right,
        A_eq=csr_matrix(np.hstack([rows, np.zeros((len(rows), 2))])), b_eq=np.concatenate(wanted),
        bounds=[(-1.0, 1.0)] * count + [(0.0, None)] * 2)
    if found is None:
        return None
    ddq = np.zeros((KNOTS + 1, len(start)))
    ddq[1:-1, joints] = found[:count].reshape(n, inner).T * unit
    return integrate(start, target, ddq, step)


def solved(
    cost: FloatArray, bound: list[FloatArray], right: list[FloatArray], **more: Any,
) -> FloatArray | None:
    """Solve a linear programme with blocks of rows below their right sides; None without one."""
    answer = linprog(cost, csr_matrix(np.vstack(bound)), np.concatenate(right), method='highs',
                     options={'maxiter': settings.PROGRAMME_STEPS}, **more)
    return None if answer.x is None or answer.status != 0 else np.asarray(answer.x)


def speed_rows(step: float) -> FloatArray:
    """Give speeds (2 KNOTS, KNOTS - 1) [s] that bound a move, by accelerations at inner knots."""
    row, hat = np.arange(KNOTS)[:, None], np.arange(1, KNOTS)
    return np.vstack([step * (row > hat) + 0.5 * step * (row == hat), step * (row >= hat)])


def integrate(start: FloatArray, target: FloatArray, ddq: FloatArray, step: float) -> Profile:
    """Give the move of accelerations (KNOTS + 1, joints) that lead from rest to rest."""
    dq, q = np.zeros_like(ddq), np.zeros_like(ddq)
    dq[1:] = np.cumsum(0.5 * step * (ddq[1:] + ddq[:-1]), axis=0)
    q[1:] = np.cumsum(step * dq[:-1] + step**2 * (ddq[:-1] / 3.0 + ddq[1:] / 6.0), axis=0)
    q += start
    dq[-1], q[-1] = 0.0, target
    return Profile(step, q, dq, ddq)


# -- A planned move refined against a simulation of what oscillates after it, by linear programmes
#    in turn.
#
# Where modes do not tell what an arm does, as with gears that cross their play on the way, a
# simulation does. Around a move it is linear in small changes of the acceleration, by differences;
# the least largest oscillation within the limits and within a distance in which that holds is a
# linear programme; of some such distances the one that the simulation likes best is gone, and so
# on (sequential linear programming; Nocedal and Wright, "Numerical optimization", 2006, ch. 18).

Oscillations = Callable[[list[Profile]], FloatArray]
"""From moves of one length to what oscillates after each, shape (n_moves, n_samples, n_channels),
each channel in a unit of its own in which 1 is nothing."""


def largest_oscillation(oscillations: FloatArray) -> FloatArray:
    """Give the largest half range of all channels: oscillations (..., samples, channels)."""
    return np.asarray(0.5 * np.ptp(oscillations, axis=-2).max(axis=-1))


def refine(profile: Profile, limits: Limits, oscillations: Oscillations) -> Profile:
    """Refine a move until next to nothing oscillates after it; limits, length and ends hold."""
    room = _Room(profile, limits)
    farthest = settings.FARTHEST
    here = oscillations([profile])[0]
    left = float(largest_oscillation(here))
    for _ in range(settings.STEPS):
        if left <= 1.0:
            break
        nudges = settings.NUDGE * np.eye(room.size)
        slope = (oscillations([room.changed(row) for row in nudges]) - here) / settings.NUDGE
        ways = [(radius, way) for radius in settings.RADII
                if (way := room.step(here, slope, farthest * radius)) is not None]
        if not ways:
            break
        tried = [room.changed(share * way) for _, way in ways for share in (1.0, 0.5)]
        found = oscillations(tried)
        sizes = largest_oscillation(found)
        best = int(np.argmin(sizes))
        if sizes[best] >= left:
            break
        before, left, here = left, float(sizes[best]), found[best]
        room.profile = tried[best]
        farthest *= ways[best // 2][0] * (1.0 if best % 2 else 2.0)
        farthest = min(max(farthest, settings.SMALLEST), settings.FARTHEST)
        if left > settings.LITTLE * before:
            break
    return room.profile


class _Room:
    """Changes of a move that keep its ends, and how far they may go."""

    def __init__(self, profile: Profile, limits: Limits) -> None:
        self.profile = profile
        self._way = profile.q[-1] - profile.q[0]
        self._joints = np.flatnonzero(np.abs(self._way) > 1e-9)
        # second differences of hats begin and end at rest at the same places
        self._change = 0.5 * np.diff(np.pad(np.eye(KNOTS - 3), ((2, 2), (0, 0))), n=2, axis=0)
        self._most = limits.acceleration * ROUNDING
        self._fastest = limits.velocity * ROUNDING
        self.size = len(self._joints) * self._change.shape[1]

    def changed(self, way: FloatArray) -> Profile:
        """Give the move with so much of each change."""
        ddq = self.profile.ddq.copy()
        ddq[1:-1, self._joints] += self._change @ way.reshape(len(self._joints), -1).T * (
            self._most[self._joints])
        return integrate(self.profile.q[0], self.profile.q[-1], ddq, self.profile.step)

    def step(self, here: FloatArray, slope: FloatArray, farthest: float) -> FloatArray | None:
        """Find the change that leaves least by the slopes, (size, n_samples, n_channels)."""
        samples, channels = here.shape
        middles = np.kron(np.eye(channels), np.ones((samples, 1)))
        rows = np.hstack([slope.transpose(2, 1, 0).reshape(-1, self.size), -middles])
        value = here.T.ravel()
        most = -np.ones((len(value), 1))
        bound = [np.hstack([side * rows, most]) for side in (1.0, -1.0)]
        right = [-value, value]
        speed = speed_rows(self.profile.step)
        count = self._change.shape[1]
        for n, j in enumerate(self._joints):
            ddq = self.profile.ddq[1:-1, j]
            sign = np.sign(self._way[j])
            for table, now, low, high in (
                    (self._change, ddq / self._most[j], -1.0, 1.0),
                    (self._change, 0.0 * ddq, -farthest, farthest),
                    (sign * speed @ self._change * (self._most[j] / self._fastest[j]),
                     sign * speed @ ddq / self._fastest[j], 0.0, 1.0)):  # none goes back
                block = np.zeros((len(table), self.size + channels + 1))
                block[:, n * count:(n + 1) * count] = table
                bound += [block, -block]
                right += [np.maximum(high - now, 0.0), np.maximum(now - low, 0.0)]
        cost = np.zeros(self.size + channels + 1)
        cost[-1] = 1.0
        found = solved(cost, bound, right, bounds=(None, None))
        return None if found is None else found[:self.size]
