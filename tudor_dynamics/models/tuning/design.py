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
A schedule of gains over payload and pose: the damping ratio asked for, as far as the loop allows.

At each node the described gains of the dampers are taken times one factor, the position gain in
proportion to the first frequency. The damping ratio of the first mode rises with the factor up to
where links and position loop begin to fight; the smallest factor that gives what was asked for is
taken, or the best one. A factor that would excite at twice the delay is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.arm.limits import planned_limits
from tudor_dynamics.control.schedule import Schedule, ScheduleFile
from tudor_dynamics.control.schedule_point import columns_of, Mode, Point
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.tuning.linear_loop import (
    DriveLoop, loop_damping, loop_matrix, LoopDamping, LoopGainsAt)
from tudor_dynamics.models.tuning.small_motion import SmallMotion, TunedArm, Vibrations
from tudor_dynamics.typing import FloatArray

SPACING = math.radians(15.0)
"""Between nodes along a joint, where there are not too many [rad]."""
POSES = 1500
"""Most poses of a grid."""
STIFFNESS = 0.13
"""Position gain over the first angular frequency: the position loop must not fight the damper."""
MEAN = 0.15
"""Corner of the DC blocker: the load is known, what is left changes slowly [Hz]."""
FACTORS = np.geomspace(0.1, 6.0, 22)
"""Of the described gains, for a first look."""
HALVINGS = 7
"""Of an interval in which a factor or a delay is sought."""
ROOM = 2.0
"""Delay from which on gains excite, over the one that they are used with."""
SHORTEST_DELAY, LONGEST_DELAY, FINER = 2e-3, 0.2, 1.2
"""Within which, and in which ratio, delays are looked at [s]."""
LOOKS = 4
"""Delays at which a factor is looked at."""
MODES = 2
"""In the schedule."""


@dataclass(frozen=True)
class Wish:
    """
    What a schedule is for.

    Attributes
    ----------
    damping_ratio : float
        Of the first mode, at every payload and pose.
    delay : float
        Of the loop, from readings to commands in effect [s].
    payloads : tuple of float
        Grid of payloads [kg].

    """

    damping_ratio: float = 0.65
    delay: float = 0.005
    payloads: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4)

    def __post_init__(self) -> None:
        if not 0.02 <= self.damping_ratio <= 0.95:
            raise UsageError(f'--damping-ratio {self.damping_ratio:g}: expected 0.02 to 0.95')
        if not 0.0 <= self.delay <= LONGEST_DELAY:
            raise UsageError(f'--delay {self.delay:g}: expected 0 to {LONGEST_DELAY:g} s')
        payloads = self.payloads
        if not payloads or any(not math.isfinite(p) or p < 0.0 for p in payloads) or list(
                payloads) != sorted(set(payloads)):
            raise UsageError(f'--payloads {list(payloads)}: expected rising masses in kg')


def pose_axes(tuned: TunedArm) -> tuple[FloatArray, ...]:
    """Lay the grid over the planned range of each joint; see ``SPACING`` and ``POSES``."""
    planned = planned_limits(tuned.arm)
    lower = np.where(np.isfinite(planned.lower), planned.lower, -math.pi)
    upper = np.where(np.isfinite(planned.upper), planned.upper, math.pi)
    points = np.maximum(np.ceil((upper - lower) / SPACING).astype(int) + 1, 2)
    while math.prod(points.tolist()) > POSES and points.max() > 2:
        points[int(np.argmax(points))] -= 1
    return tuple(np.linspace(a, b, count) for a, b, count in zip(
        lower, upper, points.tolist(), strict=True))


def design(
    tuned: TunedArm, wish: Wish, progress: Callable[[int, int], None] = lambda done, total: None,
) -> Schedule:
    """
    Compute a schedule.

    Parameters
    ----------
    tuned : TunedArm
        Arm with its elastic model.
    wish : Wish
        What is asked for.
    progress : callable, optional
        Told after each node how many are done, and how many there are.

    Returns
    -------
    Schedule
        Over the planned range of all joints.

    """
    arm = tuned.arm
    assert arm.spec.damper is not None
    axes = pose_axes(tuned)
    shape = (len(wish.payloads), *(len(axis) for axis in axes))
    rows, total = [], math.prod(shape)
    before: dict[tuple[int, ...], FloatArray] = {}
    for index in np.ndindex(*shape):
        q = np.array([axis[i] for axis, i in zip(axes, index[1:], strict=True)])
        small = tuned.at(wish.payloads[index[0]], q)
        near = [before[tuple(int(k) - (j == axis) for j, k in enumerate(index))]
                for axis in range(len(index)) if index[axis] > 0]
        found = small.modes(MODES, near[0] if near else None)
        before[index] = found.shape
        rows.append(tuple(_node(tuned, wish, small, found).row().tolist()))
        progress(len(rows), total)
    joints = arm.active_joints
    damped = tuple(item.joint for item in tuned.dampers)
    return Schedule(ScheduleFile(
        format='tudor_dynamics/schedule', version=1, arm=arm.name, joints=joints, damped=damped,
        gauges=tuple(item.gauge for item in tuned.dampers), damping_ratio=wish.damping_ratio,
        delay=wish.delay, mean_frequency=min(MEAN, arm.spec.damper.mean_frequency),
        payload=wish.payloads, pose=tuple(tuple(axis.tolist()) for axis in axes),
        columns=columns_of(joints, damped, len(found.frequency)), nodes=tuple(rows)), arm.source)


def fixed_ratios(tuned: TunedArm, delay: float, schedule: Schedule) -> FloatArray:
    """
    Give the damping ratios that the fixed gains of the description would have.

    Parameters
    ----------
    tuned : TunedArm
        Arm with its elastic model.
    delay : float
        Of the loop [s].
    schedule : Schedule
        Gives the grid.

    Returns
    -------
    ndarray of the grid's shape
        Of the first mode.

    """
    damper = tuned.arm.spec.damper
    assert damper is not None
    frequency = [schedule.column(f'frequency({mode})') for mode in (1, min(2, schedule.modes))]
    found = np.zeros(frequency[0].shape)
    for index in np.ndindex(*found.shape):
        q = np.array([axis[i] for axis, i in zip(schedule.content.pose, index[1:], strict=True)])
        judge = Judge(tuned, tuned.at(float(schedule.payload[index[0]]), q),
                      *(float(values[index]) for values in frequency))
        judge.position, judge.mean = damper.position_gain, 2.0 * math.pi * damper.mean_frequency
        found[index] = judge(1.0, delay).first
    return found


def _node(tuned: TunedArm, wish: Wish, small: SmallMotion, found: Vibrations) -> Point:
    first = float(found.frequency[0])
    second = float(found.frequency[1]) if len(found.frequency) > 1 else 4.0 * first
    judge = Judge(tuned, small, first, second)
    factor, reached = choose_factor(judge, wish)
    drive, strain = found.drive, found.strain * tuned.scale
    return Point(
        judge.described * factor, judge.position, judge.full_delay(factor), reached,
        small.load * tuned.scale, small.inertia * tuned.scale[:, None],
        tuple(Mode(*item) for item in zip(
            found.frequency.tolist(), found.damping.tolist(), drive, strain, strict=True)))


class Judge:
    """Judges factors of the described gains at one node: first, second [Hz]."""

    def __init__(self, tuned: TunedArm, small: SmallMotion, first: float, second: float) -> None:
        damper = tuned.arm.spec.damper
        assert damper is not None
        self.small, self.first, self.second = small, first, second
        self.described = np.array([item.gain for item in tuned.dampers])
        self.position = min(damper.position_gain, STIFFNESS * 2.0 * math.pi * first)
        self._joints = np.array([tuned.arm.active_joints.index(item.joint)
                                 for item in tuned.dampers], dtype=np.intp)
        self._bandwidth = 2.0 * math.pi * damper.velocity_bandwidth
        self.mean = 2.0 * math.pi * min(MEAN, damper.mean_frequency)
        self._rotor = tuple(tuned.rotor.tolist())

    def __call__(self, factor: float, delay: float) -> LoopDamping:
        """Judge a factor of the described gains at a delay of the loop [s]."""
        gains = LoopGainsAt(factor * self.described, self.position, self.mean, self._joints)
        return loop_damping(
            loop_matrix(self.small, DriveLoop(self._bandwidth, delay, self._rotor), gains),
            self.first, self.second)

    def holds(self, factor: float, delay: float) -> bool:
        """Say whether nothing grows with a factor at a delay [s], with room for more."""
        return all(self(factor, share * delay).decay > 0.0
                   for share in np.linspace(1.0, ROOM, LOOKS))

    def full_delay(self, factor: float) -> float:
        """Give half of the first delay at which a factor of the gains excites [s]."""
        low, high = 0.0, SHORTEST_DELAY
        # from below: gains that excite at some delay may damp again at a longer one
        while high < LONGEST_DELAY and self(factor, high).decay > 0.0:
            low, high = high, FINER * high
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if self(factor, middle).decay > 0.0:
                low = middle
            else:
                high = middle
        return max(low / ROOM, 0.5 * SHORTEST_DELAY)


def choose_factor(judge: Judge, wish: Wish) -> tuple[float, float]:
    """Choose the factor of the described gains at one node."""
    best, reached, before = 0.0, judge(0.0, wish.delay).first, 0.0
    for factor in FACTORS:
        if not judge.holds(float(factor), wish.delay):
            break
        ratio = judge(float(factor), wish.delay).first
        if ratio >= wish.damping_ratio:
            low, high = before, float(factor)
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                if judge(middle, wish.delay).first < wish.damping_ratio:
                    low = middle
                else:
                    high = middle
            return high, judge(high, wish.delay).first
        if ratio > reached:
            best, reached = float(factor), ratio
        before = float(factor)
    return best, reached
