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

"""Gains by an elastic model: small motion, the linear loop, a schedule, refined moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.damper import STRAIN_SCALE
from tudor_dynamics.control.schedule import columns_of, Mode, Point, Schedule, ScheduleFile
from tudor_dynamics.control.settings import INTEGRAL_SHARE
from tudor_dynamics.errors import ModelError, UsageError
from tudor_dynamics.models.bundle import elastic_of, ModelBundle
from tudor_dynamics.models.elastic.arm import DrivenArm, follow_motions, moment_rows
from tudor_dynamics.models.elastic.kernel import Z
from tudor_dynamics.models.elastic.model import driven_arm, ElasticModel
from tudor_dynamics.models.settings import (
    AFTER_MOVE, DRIVE_NUDGE, EVERY, FACTORS, FINER, HALVINGS, LEAST_DELAY,
    LONGEST_DELAY, LOOKS, MEAN, MOVE_SAMPLE, NOTHING, POSES, ROOM, SHORTEST_DELAY, SLOW,
    SPACING, STIFFNESS)
from tudor_dynamics.signals.motion_profile import joint_range
from tudor_dynamics.signals.shaping import Profile, refine
from tudor_dynamics.typing import FloatArray


# -- Small motion of an elastic arm about rest, its drives moving it: what a controller has before
#    it.
#
# With z the coordinates of gears and links, theta the drives and z0(theta) where the arm rests,
# ``M z'' + D (z' - J theta') + K (z - J theta) = 0``, J = dz0/dtheta: weight is in K and J. About
# the rest that goes along with the drives the links are driven by ``-M J theta''`` alone.


@dataclass(frozen=True, eq=False)
class SmallMotion:
    """An arm about rest at one pose; strains are those of the damped joints' gauges, in m/m."""

    # Of gears and links, with weight, (m, m).
    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    rest: FloatArray  # where they rest by the positions of the drives, (m, joints)
    strain: FloatArray  # strain by coordinate, (damped, m) [1/coordinate]
    load: FloatArray  # strain at rest, (damped,)
    slope: FloatArray  # the same by the positions of the drives, (damped, joints) [1/rad]
    # Torque of the links on each drive by coordinates and positions of the drives,
    # (joints, m + joints) [N m/rad].
    reaction: FloatArray

    @property
    def inertia(self) -> FloatArray:
        """Strain by slow accelerations of the drives, shape (n_damped, n_joints) [s^2/rad]."""
        return np.asarray(-self.strain @ np.linalg.solve(self.stiffness, self.mass @ self.rest))

    def modes(self, count: int, signs: FloatArray | None = None) -> Vibrations:
        """Solve for the slowest modes, drives held: signs (modes, m)."""
        symmetric = 0.5 * (self.stiffness + self.stiffness.T)
        values, vectors = eigh(symmetric, 0.5 * (self.mass + self.mass.T))
        shape = vectors[:, :count].T
        if signs is None:
            signs = shape * np.sign((shape @ self.strain.T).sum(axis=1))[:, None]
        turn = np.where(np.einsum('im,mk,ik->i', shape, self.mass, signs) < 0.0, -1.0, 1.0)
        shape = shape * turn[:, None]
        omega = np.sqrt(np.maximum(values[:count], 1e-6))
        modal = np.einsum('im,mk,ik->i', shape, self.damping, shape)
        return Vibrations(
            omega / (2.0 * math.pi), modal / (2.0 * omega), shape,
            -shape @ self.mass @ self.rest, shape @ self.strain.T)


@dataclass(frozen=True, eq=False)
class Vibrations:
    """Modes of small motion, drives held."""

    # (modes,): undamped frequencies [Hz] and damping ratios.
    frequency: FloatArray
    damping: FloatArray
    shape: FloatArray  # coordinates of each mode, mass-normalised, (modes, m)
    drive: FloatArray  # (modes, joints): right sides by accelerations of the drives
    strain: FloatArray  # strain of each, (modes, damped) [m/m]


class TunedArm:
    """An elastic arm whose small motion is asked for by payload and pose."""

    # Small motion is that without the play of gears: in it an arm has no frequency of its own, and
    # where gears bear, none is felt. The load at rest has it, which turns the links. Without a
    # model of the strain, links, gears and gauges are those described.

    def __init__(self, arm: Arm, model: ElasticModel | None = None) -> None:
        self.arm = arm
        self.dampers = [item for item in arm.damper.joints if item.joint in arm.active_joints]
        self._index = index = [arm.gauge_names.index(item.gauge) for item in self.dampers]
        self.scale = np.array([STRAIN_SCALE.get(arm.gauges[i].unit, 0.0) for i in index])
        """Units of the gauges per m/m, shape (n_damped,)."""
        if not self.scale.all():
            name = arm.gauge_names[index[int(np.argmin(self.scale))]]
            raise ModelError(f'gauge {name!r} has no unit of strain', place=arm.source,
                             remedy=f'set its gauges[].unit to {" or ".join(STRAIN_SCALE)}')
        values = model.values if model is not None else {}
        self._driven, self._loose = driven_arm(arm, values), driven_arm(arm, values)
        plays = {name: 0.0 for name in self._driven.parameters if name.startswith('play(')}
        self._driven.set_parameters(plays)
        self._gain, self._offset = self._gauges(model)[:, index] / self.scale
        motors = {motor.joint: motor.reflected_inertia for motor in arm.spec.motors}
        self.rotor = np.array([motors.get(name, 0.0) for name in arm.active_joints])
        """Inertia of each drive, 0 where it is not known [kg m^2]."""

    def _gauges(self, model: ElasticModel | None) -> FloatArray:
        """Give gains and offsets of all gauges, (2, gauges)."""
        if model is not None and model.coefficients_ is not None:
            return np.array(model.coefficients_).T
        sensors = {sensor.gauge: sensor for sensor in self.arm.spec.sensors}
        missing = [name for name in self.arm.gauge_names if name not in sensors]
        if missing:
            raise ModelError(f'the gains of the gauges {", ".join(missing)} are not known',
                             place=self.arm.source, remedy='add sensors[].gain, or give a model')
        known = [sensors[name] for name in self.arm.gauge_names]
        return np.array([[sensor.gain for sensor in known], [sensor.offset for sensor in known]])

    def at(self, payload: float, q: FloatArray) -> SmallMotion:
        """Linearise about rest with a mass [kg] at the tip, the drives at ``q`` [rad]."""
        driven = self._driven
        self._carry(payload)
        rests = [[self._rest(driven, q + side * DRIVE_NUDGE * unit) for side in (1.0, -1.0)]
                 for unit in np.eye(len(q))]
        rest = np.array([(up[0] - down[0]) / (2.0 * DRIVE_NUDGE) for up, down in rests]).T
        slope = np.array([(up[1] - down[1]) / (2.0 * DRIVE_NUDGE) for up, down in rests]).T
        small = driven.linearised(q)
        _, load = self._rest(self._loose, q)
        free = driven.tables.equations.free
        rows = moment_rows(driven.mechanism, driven.gauges, free)
        own = np.array([int(np.flatnonzero(free == place)[0])
                        for place in driven.tables.gears.place])
        push = small.stiffness @ rest  # of the gears, by the positions of the drives
        reaction = np.hstack([push.T, -np.diag(push[own, np.arange(len(q))])])
        return SmallMotion(small.mass, small.damping, small.stiffness, rest,
                           rows[self._index] * self._gain[:, None],
                           load * self._gain + self._offset, slope * self._gain[:, None], reaction)

    def strains(self, payload: float, motions: FloatArray, dt: float) -> FloatArray:
        """Simulate motions of drives [rad], (motions, samples, joints); strain [m/m] of each."""
        self._carry(payload)
        moments = follow_motions(self._loose, motions, dt)
        return moments[..., self._index] * self._gain + self._offset

    def _carry(self, payload: float) -> None:
        for each in (self._driven, self._loose):
            if each.parameters['payload'] != payload:
                each.set_parameters({'payload': payload})

    def _rest(self, driven: DrivenArm, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        moment = driven.follow(q[None], np.zeros(1)).moment[0]
        z = driven.tables.equations.vectors[Z][driven.tables.equations.free].copy()
        return z, moment[self._index]


# -- The loop of damper, position loop, drives and links as a linear system, and its damping.
#
# What is commanded is ``-K_p theta - k (strain - mean)``, late by the delay of the loop (Pade's
# approximation of second order); the drive follows by its PI velocity loop against what the links
# press on its rotor. The mean follows the strain as the DC blocker does, and the load as the
# schedule says.


@dataclass(frozen=True, eq=False)
class FeedbackLoop:
    """What stands between readings and links: gains to be judged, and the drives."""

    strain: FloatArray  # gains of the dampers, (damped,) [rad/s per m/m]
    joints: NDArray[np.intp]  # drive that each damper commands, (damped,)
    position: float  # speed per position error [1/s]
    mean: float  # corner of the DC blocker [rad/s]
    delay: float  # from readings to commands in effect [s]
    bandwidth: float  # of the velocity loop [rad/s]
    rotor: FloatArray  # inertia of each drive; 0 for one that nothing holds up [kg m^2]


def loop_matrix(small: SmallMotion, loop: FeedbackLoop) -> FloatArray:
    """Give the matrix of the closed loop; returns (2 m + 5 joints + damped,)."""
    m, n, d = len(small.mass), small.rest.shape[1], len(loop.strain)
    parts = np.cumsum([0, m, m, n, n, n, d, n, n])
    z, dz, th, w, held, mean, old, older = (
        slice(a, b) for a, b in zip(parts[:-1], parts[1:], strict=True))
    a = np.zeros((parts[-1], parts[-1]))
    inverse = np.linalg.inv(small.mass)
    a[z, dz] = np.eye(m)
    a[dz, z], a[dz, dz] = -inverse @ small.stiffness, -inverse @ small.damping
    a[dz, th] = inverse @ small.stiffness @ small.rest
    a[dz, w] = inverse @ small.damping @ small.rest
    a[th, w] = np.eye(n)
    a[w, w] = -loop.bandwidth * np.eye(n)
    a[w, held] = INTEGRAL_SHARE * loop.bandwidth**2 * np.eye(n)
    a[held, w] = -np.eye(n)
    for j, inertia in enumerate(loop.rotor.tolist()):
        if inertia > 0.0:
            a[parts[3] + j, z] += small.reaction[j, :m] / inertia
            a[parts[3] + j, th] += small.reaction[j, m:] / inertia
    a[mean, z], a[mean, mean] = loop.mean * small.strain, -loop.mean * np.eye(d)
    a[mean, w] = small.slope
    command = np.zeros((n, parts[-1]))
    command[:, th] = -loop.position * np.eye(n)
    for i, (joint, gain) in enumerate(zip(loop.joints, loop.strain, strict=True)):
        command[joint, z] -= gain * small.strain[i]
        command[joint, parts[5] + i] += gain
    late = max(loop.delay, LEAST_DELAY)
    a[old, older] = np.eye(n)
    a[older, old] = -12.0 / late**2 * np.eye(n)
    a[older, older] = -6.0 / late * np.eye(n)
    a[older] += command
    command[:, older] -= 12.0 / late * np.eye(n)
    a[w] += loop.bandwidth * command
    a[held] += command
    return a


@dataclass(frozen=True, eq=False)
class LoopDamping:
    """How a loop oscillates."""

    first: float  # least damping ratio of the first mode, 1 where nothing oscillates there
    decay: float  # of what dies out slowest [1/s]; negative where it grows


def loop_damping(matrix: FloatArray, first: float, second: float) -> LoopDamping:
    """Judge a loop by its poles: matrix (n, n), first, second [Hz]."""
    poles = np.linalg.eigvals(matrix)
    size = np.abs(poles) / (2.0 * math.pi)
    slow = ((poles.imag > 1e-6 * np.abs(poles)) & (size > SLOW * first)
            & (size <= math.sqrt(first * second)))
    ratio = -poles.real / np.maximum(np.abs(poles), 1e-12)
    return LoopDamping(float(ratio[slow].min()) if slow.any() else 1.0, float(-poles.real.max()))


# -- A schedule of gains over payload and pose: the damping ratio asked for, as far as the loop
#    allows.
#
# At each node the described gains of the dampers are taken times one factor, the position gain in
# proportion to the first frequency. The damping ratio of the first mode rises with the factor up
# to where links and position loop begin to fight; the smallest factor that gives what was asked
# for is taken, or the best one. A factor that would excite at twice the delay is none.

MODES = 2  # in the schedule


@dataclass(frozen=True)
class Wish:
    """What a schedule is for."""

    damping_ratio: float = 0.65  # of the first mode, at every payload and pose
    delay: float = 0.005  # of the loop, from readings to commands in effect [s]
    payloads: tuple[float, ...] = (0.0, 0.1, 0.2, 0.3, 0.4)  # [kg]

    def __post_init__(self) -> None:
        if not 0.02 <= self.damping_ratio <= 0.95:
            raise UsageError(f'damping_ratio= {self.damping_ratio:g}: give 0.02 to 0.95')
        if not 0.0 <= self.delay <= LONGEST_DELAY:
            raise UsageError(f'delay= {self.delay:g} s: give 0 to {LONGEST_DELAY:g} s')
        payloads = self.payloads
        if not payloads or any(not math.isfinite(p) or p < 0.0 for p in payloads) or list(
                payloads) != sorted(set(payloads)):
            raise UsageError(f'payloads= {" ".join(f"{mass:g}" for mass in payloads)}: give '
                             'masses of 0 kg or more, each larger than the one before')


def design(
    tuned: TunedArm, wish: Wish, progress: Callable[[int, int], None] = lambda done, total: None,
) -> Schedule:
    """Compute a schedule; progress: called with the nodes of the grid that are done, and all."""
    arm, planned = tuned.arm, joint_range(tuned.arm)  # which the grid is laid over
    points = np.maximum(np.ceil((planned.upper - planned.lower) / SPACING).astype(int) + 1, 2)
    while math.prod(points.tolist()) > POSES and points.max() > 2:
        points[int(np.argmax(points))] -= 1
    axes = tuple(map(np.linspace, planned.lower, planned.upper, points.tolist()))
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
        first = float(found.frequency[0])
        second = float(found.frequency[1]) if len(found.frequency) > 1 else 4.0 * first
        judge = Judge(tuned, small, first, second)
        factor, reached = choose_factor(judge, wish)
        rows.append(tuple(Point(
            judge.described * factor, judge.position, judge.full_delay(factor), reached,
            small.load * tuned.scale, small.inertia * tuned.scale[:, None],
            tuple(Mode(*item) for item in zip(
                found.frequency.tolist(), found.damping.tolist(), found.drive,
                found.strain * tuned.scale, strict=True))).row().tolist()))
        progress(len(rows), total)
    joints = arm.active_joints
    damped = tuple(item.joint for item in tuned.dampers)
    return Schedule(ScheduleFile(
        format='tudor_dynamics/schedule', version=1, arm=arm.name, joints=joints, damped=damped,
        gauges=tuple(item.gauge for item in tuned.dampers), damping_ratio=wish.damping_ratio,
        delay=wish.delay, mean_frequency=min(MEAN, arm.damper.mean_frequency),
        payload=wish.payloads, pose=tuple(tuple(axis.tolist()) for axis in axes),
        columns=columns_of(joints, damped, len(found.frequency)), nodes=tuple(rows)), arm.source)


def fixed_ratios(tuned: TunedArm, delay: float, schedule: Schedule) -> FloatArray:
    """Give the damping ratios of the fixed gains on the grid of a schedule; delay [s]."""
    damper = tuned.arm.damper
    frequency = [schedule.column(f'frequency({mode})') for mode in (1, min(2, schedule.modes))]
    found = np.zeros(frequency[0].shape)
    for index in np.ndindex(*found.shape):
        q = np.array([axis[i] for axis, i in zip(schedule.content.pose, index[1:], strict=True)])
        judge = Judge(tuned, tuned.at(float(schedule.payload[index[0]]), q),
                      *(float(values[index]) for values in frequency))
        judge.position, judge.mean = damper.position_gain, 2.0 * math.pi * damper.mean_frequency
        found[index] = judge(1.0, delay).first
    return found


class Judge:
    """Judges factors of the described gains at one node: first, second [Hz]."""

    def __init__(self, tuned: TunedArm, small: SmallMotion, first: float, second: float) -> None:
        damper = tuned.arm.damper
        self.small, self.first, self.second = small, first, second
        self.described = np.array([item.gain for item in tuned.dampers])
        self.position = min(damper.position_gain, STIFFNESS * 2.0 * math.pi * first)
        self._joints = np.array([tuned.arm.active_joints.index(item.joint)
                                 for item in tuned.dampers], dtype=np.intp)
        self._bandwidth = 2.0 * math.pi * damper.velocity_bandwidth
        self.mean = 2.0 * math.pi * min(MEAN, damper.mean_frequency)
        self._rotor = tuned.rotor

    def __call__(self, factor: float, delay: float) -> LoopDamping:
        """Judge a factor of the described gains at a delay of the loop [s]."""
        loop = FeedbackLoop(factor * self.described, self._joints, self.position, self.mean, delay,
                            self._bandwidth, self._rotor)
        return loop_damping(loop_matrix(self.small, loop), self.first, self.second)

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
        low, _ = halved(low, high, lambda delay: self(factor, delay).decay > 0.0)
        return max(low / ROOM, 0.5 * SHORTEST_DELAY)


def halved(low: float, high: float, below: Callable[[float], bool]) -> tuple[float, float]:
    """Narrow an interval in which something ends to be true."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if below(middle):
            low = middle
        else:
            high = middle
    return low, high


def choose_factor(judge: Judge, wish: Wish) -> tuple[float, float]:
    """Choose the factor of the described gains at one node."""
    best, reached, before = 0.0, judge(0.0, wish.delay).first, 0.0
    for factor in FACTORS.tolist():
        if not judge.holds(factor, wish.delay):
            break
        ratio = judge(factor, wish.delay).first
        if ratio >= wish.damping_ratio:
            _, high = halved(before, factor, lambda middle: judge(
                middle, wish.delay).first < wish.damping_ratio)
            return high, judge(high, wish.delay).first
        if ratio > reached:
            best, reached = factor, ratio
        before = factor
    return best, reached


# -- Planned moves refined by an elastic model with the play of its gears.
#
# Small motion knows nothing of play: a gear that is unloaded on the way lets its link fall, and
# that rings. The model in full foresees it, and what it foresees is planned against.


class MoveRefiner:
    """Refines moves by simulating them with an arm that nobody else uses meanwhile."""

    def __init__(self, tuned: TunedArm) -> None:
        self._tuned = tuned
        # compiled now, not when a robot waits for its first move
        tuned.strains(0.0, np.zeros((1, 2, len(tuned.arm.active_joints))), MOVE_SAMPLE)

    def __call__(self, profile: Profile, limits: Limits, payload: float, period: float) -> Profile:
        """Refine a move: payload [kg], period [s]."""
        t = np.arange(0.0, profile.duration + AFTER_MOVE + period, MOVE_SAMPLE)
        after = np.flatnonzero(t > profile.duration + AFTER_MOVE)[::EVERY]

        def oscillations(moves: list[Profile]) -> FloatArray:
            motions = np.array([move.at(t)[0] for move in moves])
            return self._tuned.strains(payload, motions, MOVE_SAMPLE)[:, after] / NOTHING
        return refine(profile, limits, oscillations)


def refiner_of(arm: Arm, bundle: ModelBundle) -> MoveRefiner:
    """Give what refines moves by the elastic model of a bundle."""
    model = elastic_of(bundle, 'strain')
    if model is None:
        raise ModelError('moves are refined by an elastic model of strain, which the model folder '
                         'lacks', remedy='run `tudor fit --models elastic` on bags with strain')
    return MoveRefiner(TunedArm(arm, model))
