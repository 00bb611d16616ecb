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

"""Motion profiles: sin^2 moves with a new target at any time, and splines through points."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import Limits, planned_limits
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import check_budget, SignalError
from tudor_dynamics.signals import settings
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.typing import finite_array, FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BPoly


# -- Planning and following of sin^2 motions of one joint, compiled

# Columns of the plan of one joint: where it began, then segments.
TARGET, CLOCK, Q = range(3)
FIRST = 3  # duration, speed at the start, acceleration, kind of each segment
SEGMENTS = 5
PLAN = FIRST + 4 * SEGMENTS

PULSE, FADE = 0.0, 1.0


@compiled
def _segment(kind: float, a: float, v: float, length: float, t: float) -> tuple[
        float, float, float]:
    """Give distance, speed and acceleration inside a segment."""
    if length <= 0.0:
        return 0.0, v, 0.0
    w, sign = (2.0 * math.pi / length, -1.0) if kind == PULSE else (math.pi / length, 1.0)
    return (v * t + 0.25 * a * t * t + sign * 0.5 * a / (w * w) * (1.0 - math.cos(w * t)),
            v + 0.5 * a * (t + sign * math.sin(w * t) / w),
            0.5 * a * (1.0 + sign * math.cos(w * t)))


@compiled
def _pulse_time(change: float, a_max: float) -> float:
    """Give the duration of the pulse for a change of speed, within acceleration and jerk."""
    return max(2.0 * change / a_max, math.sqrt(2.0 * math.pi * change / (settings.JERK * a_max)))


@compiled
def stopping_distance(speed: float, a_max: float) -> float:
    """Give the way [rad] on which one pulse takes a speed [rad/s] to rest."""
    return 0.5 * speed * _pulse_time(abs(speed), a_max)


@compiled
def _two_pulses(v: float, peak: float, a_max: float) -> float:
    """Give the distance of the pulses v -> peak -> 0."""
    return 0.5 * ((v + peak) * _pulse_time(peak - v, a_max) + peak * _pulse_time(peak, a_max))


@compiled
def _approach(plan: NDArray, distance: float, speed: float, v_max: float, a_max: float) -> None:
    """Fill the segments after the first: from a speed without acceleration to rest."""
    # In the direction in which the arm still has to go once it has braked.
    braking = _pulse_time(abs(speed), a_max)
    stop = stopping_distance(speed, a_max)
    sign = 1.0 if distance >= stop else -1.0
    d, v = sign * distance, sign * speed
    k = FIRST + 4
    plan[k] = 0.0
    if v < 0.0:
        # It brakes at once and turns only then: one pulse through both would stop later.
        plan[k], plan[k + 1], plan[k + 2], plan[k + 3] = (
            braking, speed, -2.0 * speed / braking, PULSE)
        d, v = sign * (distance - stop), 0.0
    # Two pulses, v -> peak -> 0; the distance grows with the peak.
    low, high = v, max(v_max, v)
    cruise = 0.0
    if _two_pulses(v, high, a_max) <= d:
        low = high
        cruise = (d - _two_pulses(v, high, a_max)) / high
    for _ in range(60):
        peak = 0.5 * (low + high)
        if _two_pulses(v, peak, a_max) < d:
            low = peak
        else:
            high = peak
    peak = 0.5 * (low + high)
    up, down = _pulse_time(peak - v, a_max), _pulse_time(peak, a_max)
    rows = ((up, v, 2.0 * (peak - v) / max(up, 1e-12)), (cruise, peak, 0.0),
            (down, peak, -2.0 * peak / max(down, 1e-12)))
    for i in range(3):
        k += 4
        plan[k], plan[k + 1], plan[k + 2] = rows[i][0], sign * rows[i][1], sign * rows[i][2]
        plan[k + 3] = PULSE


@compiled
def _lasts(plan: NDArray) -> float:
    """Give the time to the end of a plan."""
    total = -plan[CLOCK]
    for i in range(SEGMENTS):
        total += plan[FIRST + 4 * i]
    return total


@compiled
def plan_motion(plan: NDArray, q: float, dq: float, ddq: float, target: float, v_max: float,
                a_max: float) -> None:
    """Plan from the present state of motion to rest at a target."""
    # The acceleration either fades out first, with the jerk of the present pulse, or the pulse
    # goes on to its end, whatever leads to the target sooner. An arm that brakes and has to turn
    # back goes on to brake: it stops no later than it was to before.
    inside, begun, length, first, push, kind = False, plan[CLOCK], 0.0, 0.0, 0.0, PULSE
    for i in range(SEGMENTS):
        k = FIRST + 4 * i
        if begun < plan[k]:
            inside = True
            length, first, push, kind = plan[k], plan[k + 1], plan[k + 2], plan[k + 3]
            break
        begun -= plan[k]
    fade = 0.0
    if ddq != 0.0:
        fade = math.pi * 0.25 * v_max / a_max * min(abs(ddq) / a_max, 1.0)
        if inside and push != 0.0:
            fade = (0.5 if kind == PULSE else 1.0) * length * abs(ddq / push)
        if ddq * dq > 0.0 and abs(ddq) * fade > 2.0 * (v_max - abs(dq)):
            fade = 2.0 * max(v_max - abs(dq), 0.0) / abs(ddq)
        fade = max(fade, 1e-9)
    plan[:] = 0.0
    plan[TARGET], plan[Q] = target, q
    plan[FIRST], plan[FIRST + 1], plan[FIRST + 2], plan[FIRST + 3] = fade, dq, ddq, FADE
    moved, speed, _ = _segment(FADE, ddq, dq, fade, fade)
    _approach(plan, target - q - moved, speed, v_max, a_max)
    if not inside or push == 0.0:
        return
    soonest = _lasts(plan)
    kept = plan.copy()
    moved, _, _ = _segment(kind, push, first, length, begun)
    whole, speed, _ = _segment(kind, push, first, length, length)
    plan[CLOCK], plan[Q] = begun, q - moved
    plan[FIRST], plan[FIRST + 1], plan[FIRST + 2], plan[FIRST + 3] = length, first, push, kind
    _approach(plan, target - q + moved - whole, speed, v_max, a_max)
    turns = push * dq < 0.0 and (target - q + moved - whole) * dq <= 0.0
    if _lasts(plan) > soonest and not turns:
        plan[:] = kept


@compiled
def follow_plan(plan: NDArray, dt: float) -> tuple[float, float, float]:
    """Advance a plan by a step [s] and give position, velocity and acceleration."""
    plan[CLOCK] += dt
    t, q = plan[CLOCK], plan[Q]
    for i in range(SEGMENTS):
        k = FIRST + 4 * i
        length = plan[k]
        inside = min(t, length)
        moved, speed, push = _segment(plan[k + 3], plan[k + 2], plan[k + 1], length, inside)
        q += moved
        t -= length
        if t < 0.0:
            return q, speed, push
    return plan[TARGET], 0.0, 0.0


# -- Online planner of sin^2 motions: a new target at any time, no step in the acceleration.
#
# Each change of speed is one pulse of acceleration a sin^2(pi t/T), so that the jerk is bounded
# and little of the motion lies at the eigenfrequencies of an elastic link: two pulses and a
# stretch of constant speed between them make a move. A target that arrives inside a pulse either
# lets it go on to its end or lets the acceleration fade out along a cosine squared first, whatever
# is sooner there.

@dataclass(frozen=True, eq=False, repr=False)
class Reference(MotionState):
    """A reference motion, sample by sample."""

    dt: float  # sample time [s]


@dataclass(frozen=True)
class Deviation:
    """The joint that is farthest from its reference."""

    joint: str
    away: float  # how far [rad or m]
    seconds: float  # that it takes at planned speed [s]

    @classmethod
    def of(cls, joints: Sequence[str], away: FloatArray, speed: FloatArray) -> Deviation:
        """Find it: away (joints,) [rad or m], speed (joints,), planned [rad/s or m/s]."""
        seconds = np.abs(away) / speed
        j = int(seconds.argmax())
        return cls(joints[j], float(abs(away[j])), float(seconds[j]))

    def __str__(self) -> str:
        return f'{self.joint} is {self.away:.3g} away from its reference'


def motion_limits(arm: Arm) -> Limits:
    """
    Take what is planned for the active joints from an arm description.

    Parameters
    ----------
    arm : Arm
        Description; see ``arm.limits``.

    Raises
    ------
    SignalError
        If a joint has no limit of speed or acceleration.

    """
    planned = planned_limits(arm)
    for joint, velocity, acceleration in zip(arm.joints, planned.velocity, planned.acceleration,
                                             strict=True):
        if not (np.isfinite(velocity) and np.isfinite(acceleration)):
            raise SignalError(f'{arm.source}: joint {joint.name!r} lacks a limit of velocity or '
                              'acceleration, which each planned motion needs; add limits: '
                              '{velocity: ..., acceleration: ...} to its entry in joints')
    return planned


class MotionPlanner:
    """Reference of several joints, step by step, from rest at q (n_joints,) [rad]."""

    def __init__(self, limits: Limits, q: ArrayLike) -> None:
        self.limits = limits
        self.q = np.array(q, dtype=float)
        self.dq, self.ddq = np.zeros_like(self.q), np.zeros_like(self.q)
        self._plans = np.zeros((self.q.size, PLAN))
        self.go(self.q)

    def go(self, target: ArrayLike) -> None:
        """Take new targets [rad], also in the middle of a motion; NaN keeps the one there is."""
        wanted = np.broadcast_to(np.asarray(target, dtype=float), self.q.shape)
        if np.isinf(wanted).any():
            raise SignalError(f'the target {wanted.tolist()} is not finite; give angles in rad')
        for j, plan in enumerate(self._plans):
            if not np.isnan(wanted[j]):
                plan_motion(plan, self.q[j], self.dq[j], self.ddq[j], float(wanted[j]),
                            float(self.limits.velocity[j]), float(self.limits.acceleration[j]))

    def move(self, q: ArrayLike, dq: ArrayLike) -> None:
        """Go on from other positions [rad] and speeds [rad/s] (n_joints,), without a target."""
        self.q[:], self.dq[:], self.ddq[:] = q, dq, 0.0
        self._plans[:] = 0.0
        self._plans[:, Q] = self._plans[:, TARGET] = self.q

    def brake(self, q: ArrayLike | None = None, dq: ArrayLike | None = None) -> None:
        """Brake by one pulse of the planned acceleration a joint; by default from where it is."""
        self.move(self.q if q is None else q, self.dq if dq is None else dq)
        self.go([q + stopping_distance(float(dq), float(a)) for q, dq, a in zip(
            self.q, self.dq, self.limits.acceleration, strict=True)])

    def step(self, dt: float) -> None:
        """Advance ``q``, ``dq`` and ``ddq`` by a step [s]."""
        for j, plan in enumerate(self._plans):
            self.q[j], self.dq[j], self.ddq[j] = follow_plan(plan, dt)

    @property
    def remaining(self) -> float:
        """Time until all joints rest at their targets [s]."""
        lengths = self._plans[:, FIRST::4].sum(axis=1) - self._plans[:, CLOCK]
        return float(max(lengths.max(initial=0.0), 0.0))


def follow_targets(
    start: ArrayLike, switches: Sequence[FloatArray], targets: Sequence[FloatArray],
    limits: Limits, dt: float, samples: int,
) -> Reference:
    """
    Plan through targets that come one after the other, each joint for itself.

    Parameters
    ----------
    start : array of shape (n_joints,)
        Where the joints rest at the start [rad].
    switches, targets : sequence of ndarray
        For each joint, times [s] at which it gets a target [rad].
    limits : Limits
        Of speed and acceleration, one value a joint.
    dt : float
        Sample time [s].
    samples : int
        Number of samples.

    """
    aims = finite_array(start, 'start', len(switches)).copy()
    planner = MotionPlanner(limits, aims)
    check_budget(f'{samples} samples', samples, 24.0 * len(switches), 'ask for fewer')
    due = deque(sorted((
        (time, j, value) for j, times in enumerate(switches) for time, value in zip(
            finite_array(times, 'switches', None),
            finite_array(targets[j], 'targets', len(times)), strict=True)), key=itemgetter(0)))
    q, dq, ddq = (np.zeros((samples, len(switches))) for _ in range(3))
    for k in range(samples):
        if k > 0:
            planner.step(dt)
        while due and due[0][0] <= k * dt + 1e-12:
            _, j, target = due.popleft()
            if target != aims[j]:
                aims[j] = target
                planner.go(np.where(np.arange(len(aims)) == j, target, np.nan))
        q[k], dq[k], ddq[k] = planner.q, planner.dq, planner.ddq
    return Reference(q, dq, ddq, dt)


# -- Splines through the points of a trajectory, as joint_trajectory_controller lays them.
#
# Between two points that both have velocities and accelerations lies a quintic, between two that
# both have velocities a cubic, and a straight line otherwise (ros2_controllers,
# joint_trajectory_controller, "Trajectory Representation").

def spline(trajectory: Trajectory) -> BPoly:
    """Lay polynomials between points; returns positions of all joints over the time [s]."""
    # in Bernstein's basis, for all pieces at once: 30 times as fast as ``BPoly.from_derivatives``,
    # which takes a second and a half for 10 000 points of seven joints
    from scipy.interpolate import BPoly  # slow to import, and few fits have a plan

    h, q = np.diff(trajectory.t)[:, None], trajectory.q
    first, last = q[:-1], q[1:]
    if trajectory.dq is None:
        return BPoly(np.stack([first, last]), trajectory.t)
    if trajectory.ddq is None:
        way = h * trajectory.dq[:-1] / 3.0, h * trajectory.dq[1:] / 3.0
        return BPoly(np.stack([first, first + way[0], last - way[1], last]), trajectory.t)
    way = h * trajectory.dq[:-1] / 5.0, h * trajectory.dq[1:] / 5.0
    bend = h**2 * trajectory.ddq[:-1] / 20.0, h**2 * trajectory.ddq[1:] / 20.0
    return BPoly(np.stack([
        first, first + way[0], first + 2.0 * way[0] + bend[0],
        last - 2.0 * way[1] + bend[1], last - way[1], last]), trajectory.t)


def states(trajectory: Trajectory) -> FloatArray:
    """Give the motion at the points."""
    # where velocities or accelerations are not given, they are those of the splines; where the
    # splines on both sides of a point differ, the mean of both, since the controller draws a
    # straight line from effort to effort. The arm rests before the first point and after the last,
    # which the controller holds: there what is not given is zero
    given = (trajectory.dq, trajectory.ddq)
    return np.hstack([trajectory.q, *(
        _at_points(trajectory, order) if field is None else field
        for order, field in enumerate(given, start=1))])


def _at_points(trajectory: Trajectory, order: int) -> FloatArray:
    """Give a derivative at the points: the mean of both sides, none at the ends."""
    values = np.zeros_like(trajectory.q)
    if len(trajectory.t) < 3 or (order == 2 and trajectory.dq is None):
        return values
    derivative = spline(trajectory).derivative(order)
    inner, widths = trajectory.t[1:-1], np.diff(trajectory.t)
    # the spline takes a point for the begin of the next piece: just before it, for the last one
    before = derivative(inner - 1e-9 * widths[:-1])
    values[1:-1] = 0.5 * (before + derivative(inner))
    return values


def denser(trajectory: Trajectory, rate: float) -> Trajectory:
    """Put more points onto the splines, so that efforts follow what lies between: rate [Hz]."""
    seconds = float(trajectory.t[-1] - trajectory.t[0])
    if not 0.0 < rate < float('inf') or seconds * rate > settings.MOST_POINTS:
        raise SignalError(f'rate= {rate:g} points per second', remedy='give more than 0'
                          if rate <= 0.0 else f'lower it, as {seconds:g} s can have at most '
                          f'{settings.MOST_POINTS} points')
    if len(trajectory.t) < 2:
        return trajectory
    t = np.linspace(trajectory.t[0], trajectory.t[-1], max(1, round(seconds * rate)) + 1)
    curve = spline(trajectory)
    q, dq = np.asarray(curve(t)), np.asarray(curve.derivative(1)(t))
    # of straight lines there is no second derivative
    ddq = np.zeros_like(q) if trajectory.dq is None else np.asarray(curve.derivative(2)(t))
    q[[0, -1]] = trajectory.q[[0, -1]]
    for given, values in ((trajectory.dq, dq), (trajectory.ddq, ddq)):
        if given is None:
            values[[0, -1]] = 0.0
    return Trajectory(trajectory.joints, t, q, dq, ddq)


# -- Excitation

BITS = 7  # of a shift register, whose sequence repeats only after 127 clocks


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of each joint over time."""

    start: FloatArray  # where the joints rest at first, (joints,) [rad]
    # For each joint, when [s] it gets which target [rad].
    times: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]


def joint_range(arm: Arm) -> Limits:
    """Give what is planned for the joints of an arm, half a turn where their range has no end."""
    planned = planned_limits(arm)
    return replace(planned, lower=np.where(np.isfinite(planned.lower), planned.lower, -np.pi),
                   upper=np.where(np.isfinite(planned.upper), planned.upper, np.pi))


def binary_sequence(length: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Run a shift register from a random state; returns (length,)."""
    from scipy.signal import max_len_seq  # slow to import

    state = rng.integers(0, 2, BITS)[::-1]
    state[-1] |= not state.any()
    return np.asarray(max_len_seq(BITS, state, length, taps=[1])[0], dtype=bool)


def aprbs(bounds: Limits, duration: float, seed: int, *, clock: float = 1.0) -> Targets:
    """Make an APRBS for each joint: duration, clock [s]."""
    rest = settings.REST
    if not (clock > 0.0 and duration > rest + clock):
        raise SignalError(f'an APRBS of {duration:g} s has no target with {clock:g} s hold time; '
                          f'give more than {rest + max(clock, 0.0):g} s and a positive hold time')
    joints = len(bounds.lower)
    generators = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(joints)]
    start = np.zeros(joints)
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    for j, rng in enumerate(generators):
        clocks = int((duration - rest) / clock)
        bits = binary_sequence(clocks, rng)
        begins = np.flatnonzero(np.concatenate([[True], bits[1:] != bits[:-1]]))
        count = len(begins) + 1  # one for the rest before
        bins = (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
        rng.shuffle(bins)
        levels = bounds.lower[j] + bins * (bounds.upper[j] - bounds.lower[j])
        start[j] = levels[0]
        # Joints do not start together: the clock of each has a phase of its own.
        phase = rng.uniform(0.0, 0.5 * clock)
        times.append(np.asarray(rest + phase + begins * clock, dtype=np.float64))
        values.append(levels[1:])
    return Targets(start, tuple(times), tuple(values))


def fade(t: FloatArray, duration: float, ramp: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fade in and out along a quintic, at rest outside: window, first and second derivative."""
    x = np.clip(np.minimum(t, duration - t) / ramp, 0.0, 1.0)
    sign = np.where(t < 0.5 * duration, 1.0, -1.0) / ramp
    return (x**3 * (10.0 - 15.0 * x + 6.0 * x * x), sign * 30.0 * x * x * (1.0 - x) ** 2,
            (60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)) / ramp**2)
