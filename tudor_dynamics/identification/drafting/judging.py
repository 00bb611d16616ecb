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

"""What units and places the numbers of a bag have, and the direction of gravity."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter

from tudor_dynamics.arm.description import OPEN
from tudor_dynamics.bags.info import BagReport, STRAIN_WORDS
from tudor_dynamics.bags.messages import (
    DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY, JOINT_STATE)
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray, IndexArray


# -- Samples of a recording that are enough to judge by

MAX_SAMPLES = 400
"""Of each bag, evenly spread: gravity needs poses, not samples."""
WINDOW = 0.15
"""Over which positions are smoothed to differentiate them [s]."""
SLOW = 0.05
"""Speed over which the sign of the friction is smoothed [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Evenly spread samples of a recording."""

    rows: IndexArray  # which rows of the recording they are, (n,)
    # Motion of all joints of a model, of those that were not recorded zero, (n, model)
    # [rad or m, and per s and s^2].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray


def spread(recording: Recording, size: int, index: Sequence[int]) -> Samples:
    """Take samples, with speeds and accelerations of joints that are smooth over `WINDOW`."""
    keep = max(1, len(recording.q) // MAX_SAMPLES)
    parts = []
    for segment in recording.segments:
        width = 2 * max(2, round(WINDOW / recording.dt / 2)) + 1
        if segment.stop - segment.start <= width:
            continue
        moved = [savgol_filter(recording.q[segment], width, 3, deriv=order, delta=recording.dt,
                               axis=0)[::keep] for order in range(3)]
        whole = np.zeros((3, len(moved[0]), size))
        whole[:, :, list(index)] = moved
        parts.append((np.arange(segment.start, segment.stop)[::keep], *whole))
    if not parts:
        none = np.empty((0, size))
        return Samples(np.empty(0, dtype=np.intp), none, none, none)
    return Samples(*(np.concatenate(part) for part in zip(*parts, strict=True)))


# -- Which way is down: the direction of gravity that the efforts follow best.
#
# Efforts are linear in the masses, centres and inertias of the links, whatever these are, for each
# direction of gravity. The usual one counts unless another leaves much less.

SIZE = 9.81
"""Of gravity [m/s^2]."""
USUAL = (0.0, 0.0, -SIZE)
OTHERS = {'none': (0.0, 0.0, 0.0), '-x': (-SIZE, 0.0, 0.0), 'x': (SIZE, 0.0, 0.0),
          '-y': (0.0, -SIZE, 0.0), 'y': (0.0, SIZE, 0.0), 'z': (0.0, 0.0, SIZE)}
"""Axes of the base, and an arm that gravity does not reach. Which way along an axis shows where
the same centres of mass carry and accelerate."""
BETTER = 2.0
"""Another direction counts where it leaves less than one over this of the efforts' variance."""
SIMPLER = 1.05
"""No gravity at all counts where a direction explains hardly more."""


@dataclass(frozen=True)
class Down:
    """A direction of gravity, and why."""

    gravity: tuple[float, float, float]  # in the base frame [m/s^2]
    alike: tuple[tuple[float, float, float], ...]  # all that explain the efforts as well [m/s^2]
    # Evidence with its numbers; empty where nothing speaks against the usual direction.
    reason: str


def _unexplained(rows: FloatArray, dq: FloatArray, effort: FloatArray) -> float:
    """Give what is left of the efforts' variance, on average over the joints."""
    shares = []
    for joint in range(effort.shape[1]):
        y = effort[:, joint]
        if not y.std() > 0.0:
            continue
        x = np.column_stack([rows[:, joint], np.tanh(dq[:, joint] / SLOW), dq[:, joint]])
        x = x[:, np.abs(x).max(axis=0) > 1e-9]
        error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
        shares.append(float(error @ error) / float((y - y.mean()) @ (y - y.mean())))
    return float(np.mean(shares)) if shares else 1.0


def down(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int],
    moving: Sequence[bool],
) -> Down:
    """Judge the direction of gravity."""
    other = pin.Model(model)
    rows: dict[str, list[FloatArray]] = {name: [] for name in ('usual', *OTHERS)}
    speed, measured = [], []
    for recording in recordings:
        assert recording.effort is not None
        taken = spread(recording, model.nq, index)
        speed.append(taken.dq[:, list(index)])
        measured.append(recording.effort[taken.rows])
        for name, gravity in (('usual', USUAL), *OTHERS.items()):
            other.gravity = pin.Motion(np.array(gravity), np.zeros(3))
            data = other.createData()
            rows[name] += [
                pin.computeJointTorqueRegressor(other, data, q, dq, ddq)[list(index)].copy()
                for q, dq, ddq in zip(taken.q, taken.dq, taken.ddq, strict=True)]
    dq, effort = np.vstack(speed), np.vstack(measured)
    if len(effort) < 2:
        return Down(USUAL, (USUAL,), '')
    some = np.flatnonzero(moving)
    left = {name: _unexplained(np.array(found)[:, some], dq[:, some], effort[:, some])
            for name, found in rows.items()}
    best = min(OTHERS, key=lambda name: left[name] * (1.0 if name == 'none' else SIMPLER))
    if left['usual'] <= BETTER * left[best]:
        return Down(USUAL, (USUAL,), '')
    alike = ['none'] if best == 'none' else [
        name for name in OTHERS if name != 'none' and left[name] <= SIMPLER * left[best]]
    names = 'off' if best == 'none' else f'along {" or ".join(alike)}'
    return Down(OTHERS[best], tuple(OTHERS[name] for name in alike), (
        f'{100 * left[best]:.3g} % of the variance of the efforts left with gravity {names}, '
        f'{100 * left["usual"]:.3g} % with it along -z'))


# -- What bags show of an arm: topics, joints, and what may be efforts and strains

EFFORT_WORDS = ('effort', 'torque', 'current', 'tau')
"""Interfaces, and topics of arrays, that have one of these in their names carry efforts."""


@dataclass(frozen=True)
class Carrier:
    """One field of a topic, over all bags."""

    # Topic and type of its messages.
    topic: str
    msgtype: str
    field: str  # such as `effort`, `data`, or an interface
    # Name to the smallest and the largest finite value; only names that have one.
    ranges: dict[str, tuple[float, float]]
    rate: float  # messages a second [Hz]

    def changes(self, name: str) -> bool:
        """Say whether the value of a name ever changes."""
        low, high = self.ranges.get(name, (0.0, 0.0))
        return high > low

    def speaks_of(self, words: Collection[str]) -> bool:
        """Say whether topic or interface have one of some words in their names."""
        text = self.topic if self.msgtype != DYNAMIC_JOINT_STATE else self.field
        return any(word in text.lower() for word in words)


@dataclass(frozen=True)
class Survey:
    """What bags show."""

    positions: Carrier  # of the joints
    efforts: tuple[Carrier, ...]  # what may be efforts, the likeliest first
    strains: tuple[Carrier, ...]  # what may be strains
    seconds: float  # length of all bags [s]
    payloads: tuple[float, ...]  # masses at the tip that the bags tell of themselves [kg]


def carriers(reports: Sequence[BagReport]) -> list[Carrier]:
    """Put the fields of all topics of all bags together."""
    found: dict[tuple[str, str, str], dict[str, tuple[float, float]]] = {}
    rates: dict[str, float] = {}
    for topic in (topic for report in reports for topic in report.topics):
        for channel in topic.channels:
            ranges = found.setdefault((topic.name, topic.type, channel.field), {})
            if channel.minimum is None or channel.maximum is None:
                continue
            low, high = ranges.get(channel.name, (math.inf, -math.inf))
            ranges[channel.name] = min(low, channel.minimum), max(high, channel.maximum)
            rates[topic.name] = max(rates.get(topic.name, 0.0), topic.rate or 0.0)
    return [Carrier(*key, ranges, rates[key[0]]) for key, ranges in found.items() if ranges]


def survey(reports: Sequence[BagReport], known: Collection[str] = ()) -> Survey:
    """Say what bags show."""
    found = carriers(reports)
    strains = tuple(item for item in found if item.speaks_of(STRAIN_WORDS) and (
        item.msgtype != JOINT_STATE or item.field == 'position'))
    positions = [item for item in found if item.msgtype == JOINT_STATE
                 and item.field == 'position' and item not in strains]
    if not positions:
        msg = (f'no topic of type {JOINT_STATE} has positions, in '
               f'{", ".join(report.path for report in reports)}; record the joint states')
        raise BagError(msg)
    chosen = max(positions, key=lambda item: (
        len(set(item.ranges) & set(known)), any(map(item.changes, item.ranges)),
        item.topic.endswith('joint_states'), item.rate))
    named = [item for item in found if item not in strains and (
        item.msgtype == JOINT_STATE and item.field == 'effort'
        or item.msgtype == DYNAMIC_JOINT_STATE and item.speaks_of(EFFORT_WORDS))
        and set(item.ranges) & set(chosen.ranges)]
    arrays = [item for item in found if item.msgtype == FLOAT64_MULTI_ARRAY
              and item.field == DATA and item not in strains and item.speaks_of(EFFORT_WORDS)]
    named.sort(key=lambda item: (item.msgtype != JOINT_STATE, item.topic != chosen.topic))
    return Survey(chosen, (*named, *arrays), strains, sum(report.duration for report in reports),
                  tuple(sorted({report.payload for report in reports
                                if report.payload is not None})))


# -- What units and places the numbers of a bag have, judged by the gravity of the arm.
#
# A URDF says what the joints of the arm carry. Where the efforts follow that moment one to one
# they are torques; where they do so at a tenth they are currents. What carries nothing says
# nothing.

FOLLOWS = 0.5
"""Share of what friction leaves of an effort that gravity explains, to be evidence of its unit."""
TORQUES = (0.5, 2.0)
"""Effort over gravity moment where efforts are torques: masses of a URDF are often rough."""
CURRENTS = 0.005
"""Below `TORQUES` and above this, efforts are currents of drives with a gear [A/(N m)]."""
LARGEST_CURRENT = 100.0
"""Efforts beyond this are no currents of an arm [A]."""
PLAUSIBLE = (0.02, 1.5)
"""Largest effort over the limit of the URDF, where efforts are what the limit means."""
MICROSTRAIN, STRAIN = 5.0, 0.01
"""Ranges of readings above the first are um/m, below the second m/m; between, units of bridges."""
OUTERMOST = 1.5
"""A gauge sits behind the outermost joint whose moment leaves at most so many times the least."""
UNTOLD = 0.3
"""Variance of a reading that no gravity moment explains: then none of them tells its place."""


@dataclass(frozen=True)
class Judgement:
    """A value, and why."""

    value: str  # `?` where it could not be told
    reason: str  # evidence with its number


def effort_over_gravity(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int],
) -> dict[int, float]:
    """
    Give the slope of effort over gravity moment, of the joints that carry something.

    Friction (sign and size of the speed), an offset and the moment of inertia are taken out of
    both; a slope counts where gravity explains at least the share `FOLLOWS` of what is left.

    model: joints that are not recorded stand at zero.
    """
    data, nothing = model.createData(), np.zeros(model.nv)
    gravity, inertial, speed, measured = [], [], [], []
    for recording in recordings:
        assert recording.effort is not None
        some = spread(recording, model.nq, index)
        for q, dq, ddq in zip(some.q, some.dq, some.ddq, strict=True):
            still = np.array(pin.rnea(model, data, q, nothing, nothing))
            gravity.append(still[list(index)])
            inertial.append((pin.rnea(model, data, q, dq, ddq) - still)[list(index)])
        speed.append(some.dq[:, list(index)])
        measured.append(recording.effort[some.rows])
    moments, rest = np.array(gravity), np.array(inertial)
    dq, effort = np.vstack(speed), np.vstack(measured)
    largest = moments.std(axis=0).max(initial=0.0)
    found = {}
    for joint in range(len(index)):
        if not len(moments) or moments[:, joint].std() < max(0.02 * largest, 1e-6):
            continue
        others = np.column_stack([np.ones(len(dq)), np.tanh(dq[:, joint] / SLOW), dq[:, joint],
                                  rest[:, joint]])
        both = np.column_stack([moments[:, joint], effort[:, joint]])
        own, other = (both - others @ np.linalg.lstsq(others, both, rcond=None)[0]).T
        if (own @ other)**2 > FOLLOWS * (own @ own) * (other @ other) > 0.0:
            found[joint] = float((own @ other) / (own @ own))
    return found


def effort_unit(
    slopes: Mapping[int, float], peaks: Sequence[float], limits: Sequence[float], name: str,
    torque: str,
) -> Judgement:
    """Judge the unit of efforts; limits [N m or N]: 0 or infinite where it says nothing."""
    if slopes:
        slope = float(np.median([abs(value) for value in slopes.values()]))
        text = f'{slope:.3g} times the gravity moments of the URDF'
        if TORQUES[0] <= slope <= TORQUES[1] and 'current' not in name.lower():
            return Judgement(torque, text)
        if CURRENTS <= slope <= TORQUES[1]:
            return Judgement('A', f'{text}: currents')
        what = (f'{torque} in thousandths' if 500.0 <= slope <= 2000.0
                else f'neither A nor {torque}')
        return Judgement(OPEN, f'{text}: {what}? publish A or {torque}')
    if 'current' in name.lower():
        return Judgement('A', f'by the name {name}')
    if max(peaks, default=0.0) > LARGEST_CURRENT:
        return Judgement(torque, f'up to {max(peaks):.4g}, more than drives take in ampere')
    told = [peak / limit for peak, limit in zip(peaks, limits, strict=True)
            if 0.0 < limit < 1e6 and peak > 0.0]
    if told and PLAUSIBLE[0] <= min(told) and max(told) <= PLAUSIBLE[1]:
        return Judgement(torque, f'{min(told):.2g} to {max(told):.2g} of the limits of the URDF')
    if told:
        return Judgement(OPEN, f'between {min(told):.2g} and {max(told):.2g} of the limits of the '
                               f'URDF: A, or {torque}?')
    return Judgement(OPEN, f'A, or {torque}? No masses or limits of a URDF to judge by')


def strain_unit(low: float, high: float) -> Judgement:
    """Judge the unit of a gauge's readings by their size."""
    span = high - low
    if span > MICROSTRAIN:
        return Judgement('um/m', f'readings span {span:.3g}')
    if 0.0 < span < STRAIN:
        return Judgement('m/m', f'readings span {span:.3g}')
    return Judgement(OPEN, f'readings span {span:.3g}: mV/V, V, N m, um/m or m/m?')


def joint_before(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int], gauge: int,
    names: Sequence[str], moving: Collection[str],
) -> Judgement:
    """
    Judge behind which joint a gauge sits: that whose moment its reading follows.

    The moment at a joint is linear in masses, centres and inertias behind it, whatever these are.
    Those of the joints before it can follow the same reading with what they have more; so the
    outermost joint counts that leaves hardly more than the best. A joint behind that one which
    never moved would carry the same, so that the two cannot be told apart.
    """
    data = model.createData()
    rows: list[FloatArray] = []
    readings: list[FloatArray] = []
    for recording in recordings:
        assert recording.strain is not None
        some = spread(recording, model.nq, index)
        rows += [pin.computeJointTorqueRegressor(model, data, q, dq, ddq)[list(index)]
                 for q, dq, ddq in zip(some.q, some.dq, some.ddq, strict=True)]
        readings.append(recording.strain[some.rows, gauge])
    columns, y = np.array(rows), np.concatenate(readings)
    y = y - y.mean()
    left = {}
    for joint in range(len(index)):
        if names[joint] not in moving:
            continue
        x = columns[:, joint]
        x = x - x.mean(axis=0)
        if np.abs(x).max() > 1e-9:
            error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
            left[joint] = float((error @ error) / (y @ y)) if y @ y > 0.0 else 1.0
    if not left or min(left.values()) > UNTOLD:
        return Judgement(OPEN, 'its reading follows the moment of no joint')
    chosen = max(joint for joint, share in left.items()
                 if share <= OUTERMOST * min(left.values()) + 0.01)
    text = (f'its reading follows the moment of {names[chosen]} '
            f'({100 * (1 - left[chosen]):.0f} % of its variance)')
    if names[chosen + 1:] and names[chosen + 1] not in moving:
        return Judgement(OPEN, f'{text}; or sits behind {names[chosen + 1]}, which never moved?')
    return Judgement(names[chosen], text)
