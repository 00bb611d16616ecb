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

"""The first description of an arm: what bags show of it, its open questions, and its YAML."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import compress
import math
import os
from pathlib import Path
import re
import textwrap
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.signal import savgol_filter
from tudor_dynamics.arm.description import OPEN, open_values
from tudor_dynamics.arm.kinematics import (
    ExactAngles, is_prismatic, model_from_dh, model_from_urdf, read_urdf)
from tudor_dynamics.arm.schema import one_spelling
from tudor_dynamics.bags.info import BagReport, describe, STRAIN_WORDS
from tudor_dynamics.bags.messages import (
    DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY, JOINT_STATE)
from tudor_dynamics.bags.reader import read_planned
from tudor_dynamics.bags.recording import ChannelSource, moving_joints, Recording, Sources
from tudor_dynamics.errors import ArmError, BagError, printable
from tudor_dynamics.files import load_yaml, read_text
from tudor_dynamics.identification import settings
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.ringdowns import clear_ring, standstills
from tudor_dynamics.typing import FloatArray
import yaml


# -- What units and places the numbers of a bag have, and the direction of gravity

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


# -- The description, from a table or a URDF and what bags show; its questions, its text

MAX_BYTES = 100_000
MAX_ROWS = 101  # a hundred joints and a flange
LARGEST_ANGLE = 2 * math.pi + 1e-6  # an angle of a table that is larger was given in degrees [rad]
KINDS = ('revolute', 'continuous', 'prismatic')
QUARTERS = re.compile(r'([+-]?)(\d+(?:\.\d+)?\*)?pi(?:/(\d+(?:\.\d+)?))?')
EXPECTED = ('expected a row `a alpha d theta` [m, rad, m, rad] per joint, base first, optionally '
            'with the joint name before it and prismatic after it; angles may be written pi/2')


@dataclass(frozen=True)
class DhRow:
    """One row of a table."""

    values: tuple[float, float, float, float]  # a, alpha, d and theta [m, rad, m, rad]
    joint: str = ''  # name of its joint; empty where the table does not say
    kind: str = ''  # how it moves; empty where the table does not say


def _number(word: str) -> float | None:
    found = QUARTERS.fullmatch(word)
    if found is not None:
        value = math.pi * float((found[2] or '1*')[:-1]) / float(found[3] or 1.0)
        return -value if found[1] == '-' else value
    try:
        return float(word)
    except ValueError:
        return None


def _row(words: list[str], where: str) -> DhRow:
    joint = words.pop(0) if words and _number(words[0]) is None else ''
    kind = words.pop() if words and words[-1] in KINDS else ''
    values = [math.nan if value is None else value for value in map(_number, words)]
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise ArmError(f'{" ".join(words)[:60]!r} is not a row of a D-H table', place=where,
                       remedy=EXPECTED)
    a, alpha, d, theta = values
    if max(abs(alpha), abs(theta)) > LARGEST_ANGLE:
        raise ArmError(f'an angle of {max(alpha, theta, key=abs):g} looks like degrees',
                       place=where, remedy='give radians, such as pi/2')
    return DhRow((a, alpha, d, theta), joint, kind)


def _from_yaml(text: str, path: Path) -> tuple[list[Any], str]:
    """Find the rows in YAML, and whether they are standard or modified."""
    try:
        content = load_yaml(text)
    except ValueError as err:
        raise ArmError(str(err), place=path) from None
    if isinstance(content, dict):
        content = content.get('kinematics', content)
    if not isinstance(content, dict):
        content = {'dh': content}
    rows, convention = content.get('dh'), content.get('convention', 'standard')
    if convention not in ('standard', 'modified'):
        raise ArmError(f'convention {convention!r:.40}; give standard or modified', place=path)
    if not isinstance(rows, list):
        raise ArmError('no D-H rows in dh', place=path, remedy=EXPECTED)
    return rows, convention


def read_table(path: Path) -> tuple[list[DhRow], str]:
    """Read D-H rows, one a joint, base first, and whether they are standard or modified."""
    text = read_text(path, MAX_BYTES, 'the D-H table', ArmError, 'check --dh')
    if path.suffix in ('.yaml', '.yml'):
        found, convention = _from_yaml(text, path)
        lines = [(f'row {number}', list(map(str, row)) if isinstance(row, list) else [])
                 for number, row in enumerate(found[:MAX_ROWS + 1], start=1)]
    else:
        split = [line.partition('#')[0].replace(',', ' ').split() for line in text.splitlines()]
        convention = 'standard'
        lines = [(f'line {number}', words) for number, words in enumerate(split, start=1)
                 if words and 'alpha' not in map(str.lower, words)]
    rows = [_row(words, f'{path}, {where}') for where, words in lines]
    if not 0 < len(rows) <= MAX_ROWS:
        raise ArmError(f'{len(rows)} D-H rows, not 1 to {MAX_ROWS}', place=path, remedy=EXPECTED)
    return rows, convention


@dataclass(frozen=True)
class DraftedChain:
    """Kinematics with the names of their joints."""

    content: dict[str, Any]  # as it stands in a description
    joints: tuple[str, ...]  # all that can move, base first
    model: pin.Model | None = None  # None where nothing is known of the kinematics
    has_masses: bool = False  # whether the links have masses, as those of a URDF
    name: str = ''  # of the robot, where the kinematics say
    note: str = ''  # what the user should know of them
    kinds: dict[str, str] = field(default_factory=dict)  # joint to its type, where a table says

    def slides(self, joint: str) -> bool:
        """Say whether a joint moves along its axis."""
        return self.model is not None and is_prismatic(self.model, joint)


def chain_of_urdf(path: Path, out: Path) -> DraftedChain:
    """Take the kinematics of a URDF."""
    snapped = ExactAngles()
    model = model_from_urdf(read_urdf(path), str(path), snapped)
    joints = tuple(model.names)[1:]
    if not joints:
        raise ArmError('no joint of this URDF moves', place=path, remedy='give the URDF of an arm')
    relative = os.path.relpath(path.resolve(), out.parent.resolve())
    masses = any(inertia.mass > 0.0 for inertia in list(model.inertias)[1:])
    return DraftedChain({'urdf': relative}, joints, model, masses, model.name, snapped.note())


def chain_of_table(path: Path | None, names: Sequence[str]) -> DraftedChain:
    """Take the kinematics of a table of D-H rows, or leave them open."""
    if path is None:
        return DraftedChain({'dh': OPEN}, tuple(names))
    rows, convention = read_table(path)
    flange = int(convention == 'modified' and len(rows) == len(names) + 1)
    joints = [row.joint for row in rows[:len(rows) - flange]]
    if not all(joints):
        joints = list(names)
    if len(joints) + flange != len(rows) or not set(joints) <= set(names):
        raise ArmError(f'{len(rows)} rows, for {", ".join(joints)}, do not match the joints '
                       f'{", ".join(names)} of the bag',
                       place=path, remedy='give one row per joint, base first, each with its name')
    model = model_from_dh([row.values for row in rows], joints,
                          [row.kind or 'revolute' for row in rows], convention)
    content: dict[str, Any] = {'dh': [list(row.values) for row in rows]}
    if convention != 'standard':
        content['convention'] = convention
    kinds = {joint: row.kind for joint, row in zip(joints, rows, strict=False) if row.kind}
    note = '' if all(row.joint for row in rows[:len(joints)]) else (
        f'the rows of {path} are taken as those of {", ".join(joints)}, base first, as the bag '
        'names them: make sure of it')
    return DraftedChain(content, tuple(joints), model, note=note, kinds=kinds)


@dataclass
class Draft:
    """A description that may leave values open, with what is said of its parts."""

    content: dict[str, Any]  # description as plain values, `?` where a value is open
    remarks: dict[str, str] = field(default_factory=dict)  # key to what bags show of it
    bags: tuple[str, ...] = ()  # bags that were looked at
    notes: list[str] = field(default_factory=list)  # for the user, one sentence each

    @property
    def unknown(self) -> list[tuple[str | int, ...]]:
        """Where values are still open."""
        return list(open_values(self.content))


def _source_of(joint: str, found: Survey) -> tuple[Carrier | None, dict[str, Any]]:
    """Give where the effort of a joint comes from: the first topic in which it changes."""
    for carrier in sorted((item for item in found.efforts if joint in item.ranges),
                          key=lambda item: not item.changes(joint)):
        return carrier, carrier.keys
    return None, next(({**carrier.keys, 'index': OPEN} for carrier in found.efforts
                       if carrier.msgtype == FLOAT64_MULTI_ARRAY), {})


def _gauges(found: Survey) -> list[tuple[Carrier, str, dict[str, Any]]]:
    """List what may be gauges: where each stands, its key there, and the begin of its entry."""
    entries: list[tuple[Carrier, str, dict[str, Any]]] = []
    for carrier in found.strains:
        for key in carrier.ranges:
            entry: dict[str, Any] = {'name': key, **carrier.keys}
            if carrier.msgtype == FLOAT64_MULTI_ARRAY:
                entry['name'] = f'{carrier.topic.rpartition("/")[2]}_{key}'
                entry['index'] = int(key)
            if entry['name'] not in [other['name'] for _, _, other in entries]:
                entries.append((carrier, key, entry))
    return entries


class _Writer:
    """Puts a draft together, part by part."""

    def __init__(self, bags: Sequence[str], urdf: Path | None, dh: Path | None, out: Path) -> None:
        paths = tuple(dict.fromkeys(parse_choice(bag).path for bag in bags))
        chain = None if urdf is None else chain_of_urdf(urdf, out)
        self._found = survey([describe(path) for path in paths], chain.joints if chain else ())
        recorded = tuple(self._found.positions.ranges)
        self._chain = chain or chain_of_table(dh, recorded)
        self._joints = tuple(joint for joint in self._chain.joints if joint in recorded)
        if not self._joints:
            raise ArmError(
                f'no bag has its joints {", ".join(self._chain.joints)}; '
                f'{self._found.positions.topic} has {", ".join(recorded)}', place=urdf or dh,
                remedy='give the URDF of the recorded arm, with the joint names of the bags')
        self._sources = {joint: _source_of(joint, self._found) for joint in self._joints}
        self._gauges = _gauges(self._found)
        slides = tuple(map(self._chain.slides, self._joints))
        efforts = tuple(carrier.source(joint) for joint, (carrier, _) in self._sources.items()
                        if carrier is not None)
        plan = Sources(
            self._found.positions.topic, self._joints, slides, (None,) * len(self._joints),
            efforts if len(efforts) == len(self._joints) else (),
            tuple(entry['name'] for _, _, entry in self._gauges),
            tuple(carrier.source(key) for carrier, key, _ in self._gauges))
        self._recordings = [read_planned(path, plan, quiet=True) for path in paths]
        self._moved = [(item, segment, moved) for item in self._recordings
                       for segment, moved in derivatives(item)]
        moves = np.any([moving_joints(item, slides) for item in self._recordings], axis=0)
        self._moving = list(compress(self._joints, moves))
        if not self._moving:
            raise ArmError('no joint moves in the bags', place=paths[0], remedy='record a motion')
        self.draft = Draft({'name': self._chain.name or out.stem}, bags=paths,
                           notes=[self._chain.note] if self._chain.note else [])

    def _samples(self, output: str) -> Samples | None:
        model = self._chain.model
        return None if model is None else spread(
            model, [int(model.joints[model.getJointId(joint)].idx_q) for joint in self._joints],
            self._recordings, output)

    def write(self) -> Draft:
        """Write all parts."""
        content, found, bags = self.draft.content, self._found, self.draft.bags
        efforts, strains = self._samples('effort'), self._samples('strain')
        content['kinematics'] = self._chain.content
        gravity = self._gravity(efforts)
        self._down = list(USUAL) if gravity is None else gravity
        content['gravity'] = OPEN if gravity is None else gravity
        content['joint_topic'] = found.positions.keys['topic']
        self.draft.remarks['joint_topic'] = (
            f'{found.positions.rate:.4g} Hz, {found.seconds:.4g} s in '
            f'{len(bags)} bag{"s" * (len(bags) > 1)}')
        units = self._units(efforts)
        content['joints'] = [self._joint(joint, units) for joint in self._chain.joints]
        if len(self._moving) < len(self._chain.joints):
            content['active_joints'] = self._moving
        if self._gauges:
            content['gauges'] = [self._gauge(number, strains)
                                 for number in range(len(self._gauges))]
        elif not any('topic' in joint.get('effort', ()) for joint in content['joints']):
            self.draft.notes.append('neither efforts nor strains are in the bags: nothing can be '
                                    'learned from them, record them as well')
        used = [found.positions, *found.strains, *(item for item, _ in self._sources.values())]
        if unused := [f'{item.field} of {item.topic}' for item in found.fields if item not in used
                      and (item.topic, item.field) != (found.positions.topic, 'velocity')]:
            self.draft.notes.append(f'numbers that are not used: {", ".join(unused)}')
        # strain that goes on ringing where the joints stand
        for gauge, entry in enumerate(content.get('gauges', ())):
            rings = [ring for item, segment, moved in self._moved
                     for part in standstills(item.t[segment], moved[:, 1])
                     if item.strain is not None
                     and (ring := clear_ring(item.strain[segment][part, gauge], item.dt)[1])]
            if rings:
                loudest = max(rings, key=lambda ring: ring.amplitude)
                self.draft.notes.append(
                    f'the link with gauge {entry["name"]} (joint {entry["joint"]}) rings at '
                    f'{loudest.frequency:.2f} Hz while the joints stand still: for an elastic '
                    'model, add it to links of the description (docs/explanation/elastic.md)')
        return self.draft

    def _gravity(self, efforts: Samples | None) -> list[float] | None:
        if efforts is None:
            return list(USUAL)
        gravity, reason, certain = down(
            efforts, [self._joints.index(joint) for joint in self._moving],
            self._chain.has_masses)
        if reason:
            self.draft.remarks['gravity'] = reason
            which = '' if certain or gravity is None else '; make sure of axis and sign'
            self.draft.notes.append('gravity is not ' + (
                'known' if gravity is None else 'along -z of the base') + f': {reason}{which}')
        return gravity

    def _units(self, efforts: Samples | None) -> dict[str, Judgement]:
        """Judge the unit of each source of efforts, by all joints that it carries."""
        judged: dict[str, Judgement] = {}
        model = self._chain.model
        slopes = {} if efforts is None or not self._chain.has_masses else {
            self._joints[column]: slope for column, slope in effort_over_gravity(
                efforts, self._down).items()}
        for key in dict.fromkeys(str(source) for _, source in self._sources.values()):
            joints = [joint for joint in self._joints if str(self._sources[joint][1]) == key]
            carrier = self._sources[joints[0]][0]
            if carrier is None:
                judged[key] = Judgement(OPEN, 'which place in the array is this joint?')
                continue
            peaks = [max(map(abs, carrier.ranges[joint])) for joint in joints]
            limits = [0.0] * len(joints) if model is None else [
                float(model.effortLimit[model.joints[model.getJointId(joint)].idx_v])
                for joint in joints]
            name = carrier.field if carrier.msgtype == DYNAMIC_JOINT_STATE else carrier.topic
            torque = 'N' if all(map(self._chain.slides, joints)) else 'N m'
            judged[key] = effort_unit(
                [slope for joint, slope in slopes.items() if joint in joints], peaks, limits,
                name, torque)
            if model is None and judged[key].value == torque:
                judged[key] = Judgement(OPEN, f'{judged[key].reason}: N m, or N of a joint that '
                                              'slides?')
        return judged

    def _joint(self, joint: str, units: dict[str, Judgement]) -> dict[str, Any]:
        remarks, slides = self.draft.remarks, self._chain.slides(joint)
        entry: dict[str, Any] = {'name': joint}
        effort: dict[str, Any] = {'unit': 'N'} if slides else {}
        if joint in self._chain.kinds:
            entry['type'] = self._chain.kinds[joint]
        if joint not in self._joints:
            text = 'not in the bags: held at 0'
        else:
            low, high = self._found.positions.ranges[joint]
            unit = 'rad or m' if self._chain.model is None else 'm' if slides else 'rad'
            text = f'{low:.4g} .. {high:.4g} {unit}'
            carrier, source = self._sources[joint]
            if joint not in self._moving:
                place = float(np.median(np.concatenate([
                    item.q[:, self._joints.index(joint)] for item in self._recordings])))
                entry['hold'] = round(place, 6) + 0.0
                text = f'does not move ({text}): held'
            elif not source:
                text += '; no effort in the bags'
            else:
                judged = units[str(source)]
                unit = judged.value
                if unit in ('N m', 'N'):
                    unit = 'N' if slides else 'N m'
                effort = {**source, 'unit': unit}
                remarks['unit'] = judged.reason
                if carrier is not None:
                    least, most = carrier.ranges[joint]
                    text += f'; effort {least:.4g} .. {most:.4g}'
                    if not carrier.changes(joint):
                        self.draft.notes.append(
                            f'effort of {joint} in {carrier.topic} is constant: check the driver')
            if joint in self._moving and self._moved:
                entry['limits'] = self._limits(joint)
        remarks[f'joints.{joint}'] = text
        return {**entry, **({'effort': effort} if effort else {})}

    def _limits(self, joint: str) -> dict[str, float]:
        """Give what the motion reached, of what the URDF does not limit."""
        place, model = self._joints.index(joint), self._chain.model
        q, dq, ddq = np.concatenate([moved[:, :, place] for _, _, moved in self._moved]).T
        found = {'lower': q.min(), 'upper': q.max(), 'velocity': np.abs(dq).max(),
                 'acceleration': np.abs(ddq).max()}
        if model is not None:
            at = model.joints[model.getJointId(joint)]
            if model.lowerPositionLimit[at.idx_q] < model.upperPositionLimit[at.idx_q] < UNBOUNDED:
                del found['lower'], found['upper']
            if 0.0 < model.velocityLimit[at.idx_v] < UNBOUNDED:
                del found['velocity']
        return {key: float(f'{value:.4g}') for key, value in found.items()}

    def _gauge(self, number: int, strains: Samples | None) -> dict[str, Any]:
        carrier, key, begin = self._gauges[number]
        unit = strain_unit(*carrier.ranges[key])
        where = Judgement(OPEN, 'after which joint?') if strains is None else joint_before(
            strains, self._down, number, self._joints, self._moving)
        if where.value == OPEN:
            where = named_joint(begin['name'], self._joints, where)
        self.draft.remarks[f'gauges.{begin["name"]}'] = f'{unit.reason}; {where.reason}'
        name = begin.pop('name')
        return {'name': name, 'joint': where.value, 'distance': OPEN, **begin, 'unit': unit.value}


def draft_of(
    bags: Sequence[str], *, urdf: Path | None = None, dh: Path | None = None, out: Path,
) -> Draft:
    """Write the first description of an arm."""
    return _Writer(bags, urdf, dh, out).write()


Question = tuple[str, Callable[[str], Any]]


def _one_of(values: Sequence[str], answer: str) -> str:
    value = str(one_spelling(answer))
    if value not in values:
        raise ValueError(f'answer one of {", ".join(values)}')
    return value


def _length(answer: str) -> float:
    value = float(answer)
    if not 0.0 <= value < math.inf:
        raise ValueError('answer a distance in m, 0 or more')
    return value


def question_of(draft: Draft, path: tuple[str | int, ...]) -> Question | None:
    """Give what to ask for an open value; returns None for what cannot be said in a word."""
    key = path[-1]
    if key == 'distance':
        return 'distance along the link from that joint [m]', _length
    if key == 'index':
        return 'place in the array, from 0', int
    gauge = ('um/m', 'm/m', 'mV/V', 'V', 'N m')
    known = {'unit': gauge if 'distance' in _entry(draft, path) else ('A', 'N m', 'N'),
             'joint': [joint['name'] for joint in draft.content['joints']]}.get(str(key))
    what = 'joint before it' if key == 'joint' else 'unit'
    return None if known is None else (f'{what} ({", ".join(known)})', partial(_one_of, known))


def _entry(draft: Draft, path: tuple[str | int, ...]) -> Any:
    entry: Any = draft.content
    for step in path[:-1]:
        entry = entry[step]
    return entry


def answer(draft: Draft, path: tuple[str | int, ...], value: Any) -> None:
    """Put a value in the place of an open one."""
    entry = _entry(draft, path)
    entry[path[-1]] = value
    if path[-1] == 'unit' and path[0] == 'joints':  # one driver, one unit
        for joint in draft.content['joints']:
            other = joint.get('effort', {})
            if other.get('unit') == OPEN and all(
                    other.get(key) == entry.get(key) for key in ('topic', 'interface')):
                other['unit'] = value


UNBOUNDED = 1e6  # range or speed from which on a URDF limits nothing [rad or m, and per s]
WIDTH = 99  # of remarks [characters]
LEFT_TO_FIT = """\
# Friction, filters and estimator are left to tudor fit, which chooses by parts of the bags that it
# leaves out, and says in its report what each choice brought. To fix them, for each joint:
#   friction: [viscous, coulomb]        # also offset, stribeck, cube_root, square
#   asymmetric: true                    # other coefficients in each direction
# and for the signals:
# preprocessing: {filter: causal, velocity_cutoff: 80, acceleration_cutoff: 20, rate: 20}
"""
NO_GAUGES = """\
# gauges:                               # for strains: where each gauge sits on its link
#   - {name: NAME, joint: JOINT, distance: 0.05}
"""


def _flow(value: Any) -> str:
    for unicode in (True, False):  # a line break of Unicode in a name has to be escaped
        text: str = yaml.safe_dump(value, default_flow_style=True, sort_keys=False,
                                   allow_unicode=unicode, width=10**6)
        text = text.removesuffix('...\n').strip()
        if load_yaml(f'[{text}]') == [value]:
            break
    return text


def _remark(text: str, indent: str = '') -> list[str]:
    """Break a remark into lines of comment."""
    return textwrap.wrap(' '.join(printable(text).split()), WIDTH, initial_indent=f'{indent}# ',
                         subsequent_indent=f'{indent}# ', break_long_words=False,
                         break_on_hyphens=False)


def _list(key: str, entries: list[dict[str, Any]], draft: Draft) -> list[str]:
    lines = [f'{key}:']
    for entry in entries:
        remark = draft.remarks.get(f'{key}.{entry["name"]}')
        lines += _remark(remark, '  ') if remark else []
        lines.append(f'  - {_flow(entry)}')
    return lines


def _kinematics(content: dict[str, Any]) -> list[str]:
    rows = content.get('dh')
    if not isinstance(rows, list):
        more = [] if 'urdf' in content else _remark(
            'One row a joint, base first: dh: [[a, alpha, d, theta_offset], ...] in m and rad; or '
            'urdf: FILE. tudor init takes either, by --dh or --urdf.')
        return [*more, f'kinematics: {_flow(content)}']
    lines = ['kinematics:', '  dh:'.ljust(39) + ' # [a, alpha, d, theta_offset]']
    lines += [f'    - {_flow(row)}' for row in rows]
    return [*lines, *(f'  {key}: {_flow(value)}' for key, value in content.items() if key != 'dh')]


def text_of(draft: Draft) -> str:
    """Write a description."""
    content, remarks = draft.content, draft.remarks
    lines = _remark(f'Arm description of {content["name"]}, written by tudor init from '
                    f'{", ".join(draft.bags)}.')
    lines += _remark('docs/reference/arm_yaml.md (tudor_dynamics) has keys, units and defaults.'
                     + (" A value that is '?' is not known from the bags: write it; nothing is "
                        'read from this file before.' if draft.unknown else ''))
    for note in draft.notes:
        lines += _remark(f'{note[0].upper()}{note[1:]}.')
    lines += [f'name: {_flow(content["name"])}', *_kinematics(content['kinematics'])]
    lines += _remark(
        'In the base frame [m/s^2]. ' + (
            f'Judged: {remarks["gravity"]}.' if 'gravity' in remarks else
            'Assumed: the base stands upright; another one for an arm that hangs or leans.'))
    lines.append(f'gravity: {_flow(content["gravity"])}')
    lines.append(f'joint_topic: {_flow(content["joint_topic"])}'.ljust(39)
                 + f' # {printable(remarks.get("joint_topic", ""))}')
    if 'unit' in remarks:
        lines += _remark(f'Unit of the efforts: {remarks["unit"]}.')
    lines += _remark('Limits are those of the motion seen, where the URDF has none: put what the '
                     'drives may do in their place, before motion is planned.')
    lines += _list('joints', content['joints'], draft)
    if 'active_joints' in content:
        lines += _remark('Those that move in the bags; the others are held.')
        lines.append(f'active_joints: {_flow(content["active_joints"])}')
    if 'gauges' in content:
        lines += _list('gauges', content['gauges'], draft)
    text = '\n'.join(lines) + '\n' + ('' if 'gauges' in content else NO_GAUGES) + LEFT_TO_FIT
    assert load_yaml(text) == content, 'the file reads as what was meant'
    return text
