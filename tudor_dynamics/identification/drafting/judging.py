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

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
import math
import re
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter

from tudor_dynamics.arm.description import OPEN
from tudor_dynamics.bags.info import BagReport, STRAIN_WORDS
from tudor_dynamics.bags.messages import (
    DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY, JOINT_STATE)
from tudor_dynamics.bags.recording import ChannelSource, Recording
from tudor_dynamics.errors import BagError
from tudor_dynamics.identification import settings
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Samples:
    """Evenly spread samples of an output, and how the model moves there."""

    model: pin.Model
    index: list[int]  # places of the recorded joints in the model
    # `q`, `dq`, `ddq` of all joints of the model, of those that were not recorded zero,
    # (n, 3, model) [rad or m, and per s and s^2].
    motion: FloatArray
    measured: FloatArray  # efforts or strains, (n, channels)

    def speed(self, joint: int) -> FloatArray:
        """Give the speed of a recorded joint: (n,)."""
        return self.motion[:, 1, self.index[joint]]

    def under(self, gravity: Sequence[float]) -> pin.Model:
        """Give the model under a gravity in the base frame [m/s^2]."""
        model = pin.Model(self.model)
        model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
        return model

    def rows(self, gravity: Sequence[float]) -> FloatArray:
        """Give the rows of the recorded joints: (n, joints, parameters of the bodies)."""
        model = self.under(gravity)
        data = model.createData()
        # of an only joint Pinocchio gives a row without its first axis
        return np.array([np.reshape(pin.computeJointTorqueRegressor(model, data, *motion), (
            model.nv, -1))[self.index] for motion in self.motion])


def derivatives(recording: Recording) -> Iterator[tuple[slice, FloatArray]]:
    """Give ``q``, ``dq``, ``ddq`` of the long stretches of a recording: (n, 3, joints)."""
    width = 2 * max(2, round(settings.DERIVATIVE_WINDOW / recording.dt / 2)) + 1
    for segment in recording.segments:
        if segment.stop - segment.start > width:
            yield segment, np.stack([savgol_filter(
                recording.q[segment], width, 3, deriv=order, delta=recording.dt, axis=0)
                for order in range(3)], axis=1)


def spread(
    model: pin.Model, index: list[int], recordings: Sequence[Recording], output: str,
) -> Samples | None:
    """Take samples of all recordings that have an output; None where there are none."""
    motions, measured = [], []
    for recording in recordings:
        values = getattr(recording, output)
        keep = max(1, len(recording.q) // settings.SAMPLES_TO_DRAFT)
        for segment, moved in derivatives(recording) if values is not None else ():
            measured.append(values[segment][::keep])
            motion = np.zeros((len(measured[-1]), 3, model.nq))
            motion[:, :, index] = moved[::keep]
            motions.append(motion)
    if not motions:
        return None
    return Samples(model, index, np.concatenate(motions), np.concatenate(measured))


SIZE = 9.81  # of gravity [m/s^2]
USUAL = (0.0, 0.0, -SIZE)  # of a base that stands upright
OTHERS = {'none': (0.0, 0.0, 0.0), '-x': (-SIZE, 0.0, 0.0), 'x': (SIZE, 0.0, 0.0),
          '-y': (0.0, -SIZE, 0.0), 'y': (0.0, SIZE, 0.0), 'z': (0.0, 0.0, SIZE)}
"""Axes of the base, and an arm that gravity does not reach. Which way along an axis shows where
the same centres of mass carry and accelerate."""


def _unexplained(
    samples: Samples, gravity: Sequence[float], moving: Sequence[int], powers: int = 0,
) -> float:
    """Give the share of the efforts' variance that remains, on average over the joints."""
    shares, rows = [], samples.rows(gravity)
    for joint in moving:
        y, dq = samples.measured[:, joint], samples.speed(joint)
        if not y.std() > 0.0:
            continue
        q = samples.motion[:, 0, samples.index[joint]]
        x = np.column_stack([rows[:, joint], np.tanh(dq / settings.SLOW), dq,
                             *(q ** power for power in range(powers))])
        x = x[:, np.abs(x).max(axis=0) > 1e-9]
        error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
        shares.append(float(error @ error) / float((y - y.mean()) @ (y - y.mean())))
    return float(np.mean(shares)) if shares else 1.0


def down(
    samples: Samples, moving: Sequence[int], has_masses: bool,
) -> tuple[list[float] | None, str, bool]:
    """
    Judge the direction of gravity [m/s^2] by the joints that move: the one efforts follow best.

    Efforts are linear in the masses, centres and inertias of the links, whatever these are, for
    each direction of gravity. The usual one counts unless another leaves much less. Which of
    several, and which way, is shown by the masses that the links have. Evidence is given where
    something speaks against the usual one, and whether no other explains the efforts as well.
    Efforts of joints that the usual one does not load have to follow their positions, and not as
    a spring or a cable makes them do: None where that cannot be said.
    """
    rows, bare = (samples.rows(gravity)[:, moving] for gravity in (USUAL, OTHERS['none']))
    if np.abs(rows - bare).max(initial=0.0) < 1e-9:
        upright, spring = (_unexplained(samples, USUAL, moving, powers) for powers in (1, 2))
        turned = min(_unexplained(samples, gravity, moving, 1) for gravity in OTHERS.values())
        if upright - turned < settings.FOLLOWED:
            return list(USUAL), '', True
        if spring <= settings.BETTER * turned:
            return None, (
                f'{100 * (upright - turned):.2g} % of the variance of the efforts follow the '
                'positions, which gravity across the axes, a spring or a cable explain alike; '
                'these joints do not show gravity along their axes'), False
    usual = _unexplained(samples, USUAL, moving)
    left = {name: _unexplained(samples, gravity, moving) for name, gravity in OTHERS.items()}
    best = min(OTHERS, key=lambda name: left[name] * (1.0 if name == 'none' else settings.SIMPLER))
    if usual <= settings.BETTER * left[best]:
        return list(USUAL), '', True
    alike = ['none'] if best == 'none' else [
        name for name in OTHERS if name != 'none' and left[name] <= settings.SIMPLER * left[best]]
    gravity, certain = np.array(OTHERS[best]), len(alike) == 1
    if has_masses and not certain:
        slopes = {name: list(effort_over_gravity(samples, OTHERS[name]).values())
                  for name in alike}
        chosen = max(slopes, key=lambda name: len(slopes[name]))
        certain = bool(slopes[chosen])
        sign = -1.0 if certain and np.median(slopes[chosen]) < 0.0 else 1.0
        gravity = sign * np.array(OTHERS[chosen])
    names = 'off' if best == 'none' else f'along {" or ".join(alike)}'
    return [float(value) + 0.0 for value in gravity], (
        f'{100 * left[best]:.3g} % of the variance of the efforts left with gravity {names}, '
        f'{100 * usual:.3g} % with it along -z'), certain


EFFORT_WORDS = ('effort', 'torque', 'current', 'tau')
"""Interfaces, and topics of arrays, that have one of these in their names carry efforts."""


@dataclass(frozen=True)
class Carrier:
    """One field of a topic, over all bags."""

    # Topic and type of its messages.
    topic: str
    msgtype: str
    field: str  # such as `effort`, `data`, or an interface
    ranges: dict[str, tuple[float, float]]  # smallest, largest finite value by name
    rate: float  # messages a second [Hz]

    def changes(self, name: str) -> bool:
        """Say whether the value of a name ever changes."""
        low, high = self.ranges.get(name, (0.0, 0.0))
        return high > low

    @property
    def keys(self) -> dict[str, Any]:
        """Name it as descriptions do, so that namespaces and remapping work."""
        topic = self.topic[1:] if self.topic.count('/') == 1 else self.topic
        interface = {'interface': self.field} if self.msgtype == DYNAMIC_JOINT_STATE else {}
        return {'topic': topic, **interface}

    def source(self, name: str) -> ChannelSource:
        """Say where a reader finds the values of a name."""
        return ChannelSource(self.topic, name, self.field, self.msgtype)

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
    fields: tuple[Carrier, ...]  # all of numbers
    seconds: float  # length of all bags [s]


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
        raise BagError(f'{", ".join(report.path for report in reports)}: no topic of type '
                       f'{JOINT_STATE} has positions; record the joint states of the arm')
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
    return Survey(chosen, (*named, *arrays), strains, tuple(found),
                  sum(report.duration for report in reports))


@dataclass(frozen=True)
class Judgement:
    """A value, and why."""

    value: str  # `?` where nothing shows it
    reason: str  # evidence with its number


def effort_over_gravity(samples: Samples, gravity: Sequence[float]) -> dict[int, float]:
    """Give the slope of effort over gravity moment, of the joints that carry something."""
    # friction (sign and size of the speed), an offset and the moment of inertia are taken out of
    # both; a slope counts where gravity explains at least the share `EXPLAINED` of the rest
    model = samples.under(gravity)
    data, nothing = model.createData(), np.zeros(model.nv)
    still, moved = (
        np.array([pin.rnea(model, data, *row).copy() for row in rows])[:, samples.index]
        for rows in (((q, nothing, nothing) for q in samples.motion[:, 0]), samples.motion))
    inertial = moved - still
    largest = still.std(axis=0).max(initial=0.0)
    found = {}
    for joint in np.flatnonzero(still.std(axis=0) >= max(
            settings.CARRIES * largest, 1e-6)).tolist():
        dq = samples.speed(joint)
        others = np.column_stack([np.ones(len(dq)), np.tanh(dq / settings.SLOW), dq,
                                  inertial[:, joint]])
        both = np.column_stack([still[:, joint], samples.measured[:, joint]])
        own, other = (both - others @ np.linalg.lstsq(others, both, rcond=None)[0]).T
        if (own @ other)**2 > settings.EXPLAINED * (own @ own) * (other @ other) > 0.0:
            found[joint] = float((own @ other) / (own @ own))
    return found


def effort_unit(
    slopes: Sequence[float], peaks: Sequence[float], limits: Sequence[float], name: str,
    torque: str,
) -> Judgement:
    """Judge the unit of efforts; limits [N m or N]: 0 or infinite where it says nothing."""
    # A URDF says what the joints of the arm carry. Where the efforts follow that moment one to one
    # they are torques; where they do so at a tenth they are currents. What carries nothing says
    # nothing.
    least, most = settings.TORQUES
    if slopes:
        slope = float(np.median(np.abs(slopes)))
        text = f'{slope:.3g} times the gravity moments of the URDF'
        if least <= slope <= most and 'current' not in name.lower():
            return Judgement(torque, text)
        if settings.CURRENTS <= slope <= most:
            return Judgement('A', f'{text}: currents')
        what = (f'{torque} in thousandths' if 1e3 * least <= slope <= 1e3 * most
                else f'neither A nor {torque}')
        return Judgement(OPEN, f'{text}: {what}? publish A or {torque}')
    if 'current' in name.lower():
        return Judgement('A', f'by the name {name}')
    if max(peaks, default=0.0) > settings.LARGEST_CURRENT:
        return Judgement(torque, f'up to {max(peaks):.4g}, more than drives take in ampere')
    used = [peak / limit for peak, limit in zip(peaks, limits, strict=True)
            if 0.0 < limit < settings.UNLIMITED and peak > 0.0]
    if not used:
        return Judgement(OPEN, f'A, or {torque}? No masses or limits of a URDF to judge by')
    low, high = min(used), max(used)
    if settings.PLAUSIBLE[0] <= low and high <= settings.PLAUSIBLE[1]:
        return Judgement(torque, f'{low:.2g} to {high:.2g} of the limits of the URDF')
    return Judgement(OPEN, f'between {low:.2g} and {high:.2g} of the limits of the URDF: A, or '
                           f'{torque}?')


def strain_unit(low: float, high: float) -> Judgement:
    """Judge the unit of a gauge's readings by their size."""
    span = high - low
    if span > settings.MICROSTRAIN:
        return Judgement('um/m', f'readings span {span:.3g}')
    if 0.0 < span < settings.STRAIN:
        return Judgement('m/m', f'readings span {span:.3g}')
    return Judgement(OPEN, f'readings span {span:.3g}: mV/V, V, N m, um/m or m/m?')


def joint_before(
    samples: Samples, gravity: Sequence[float], gauge: int, names: Sequence[str],
    moving: Collection[str],
) -> Judgement:
    """Judge after which joint a gauge sits: that whose moment its reading follows."""
    # the moment at a joint is linear in masses, centres and inertias after it, whatever these are.
    # Those of the joints before it can follow the same reading with what they have more; so the
    # outermost joint counts that leaves hardly more than the best. A joint after that one which
    # never moved would carry the same, so that nothing tells the two apart
    rows, y = samples.rows(gravity), samples.measured[:, gauge]
    y = y - y.mean()
    left = {}
    for joint, name in enumerate(names):
        x = rows[:, joint] - rows[:, joint].mean(axis=0)
        if name in moving and np.abs(x).max() > 1e-9:
            error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
            left[joint] = float((error @ error) / (y @ y)) if y @ y > 0.0 else 1.0
    if not left or min(left.values()) > settings.NOT_FOLLOWED:
        return Judgement(OPEN, 'its reading follows the moment of no joint')
    chosen = max(joint for joint, share in left.items()
                 if share <= settings.OUTERMOST * min(left.values()) + 0.01)
    text = (f'its reading follows the moment of {names[chosen]} '
            f'({100 * (1 - left[chosen]):.0f} % of its variance)')
    if names[chosen + 1:] and names[chosen + 1] not in moving:
        return Judgement(OPEN, f'{text}; or sits after {names[chosen + 1]}, which never moved?')
    return Judgement(names[chosen], text)


def named_joint(gauge: str, joints: Sequence[str], unknown: Judgement) -> Judgement:
    """Judge by its name after which joint a gauge sits: that of the joint, or its number."""
    numbers = {*re.findall(r'\d+', gauge)}
    found = ([joint for joint in joints if joint.lower() in gauge.lower()]
             or [joint for joint in joints if numbers & {*re.findall(r'\d+', joint)}])
    return unknown if len(found) != 1 else Judgement(
        found[0], f'{unknown.reason}; by its name {gauge}')
