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

"""The first description of an arm, its open questions, and its YAML."""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
from tudor_dynamics.arm.description import OPEN, open_values
from tudor_dynamics.arm.kinematics import (
    ExactAngles, is_prismatic, model_from_dh, model_from_urdf, read_urdf)
from tudor_dynamics.arm.schema import one_spelling
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.messages import DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.reader import read_planned
from tudor_dynamics.bags.recording import moving_joints, Sources
from tudor_dynamics.errors import ArmError, printable
from tudor_dynamics.files import load_yaml, read_text
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.drafting.judging import (
    Carrier, derivatives, down, effort_over_gravity, effort_unit, joint_before, Judgement,
    named_joint, Samples, spread, strain_unit, Survey, survey, USUAL)
from tudor_dynamics.identification.ringdowns import clear_ring, standstills
import yaml


MAX_BYTES = 100_000
MAX_ROWS = 101  # a hundred joints and a flange
LARGEST_ANGLE = 2 * math.pi + 1e-6  # an angle of a table that is larger was given in degrees [rad]
KINDS = ('revolute', 'continuous', 'prismatic')
QUARTERS = re.compile(r'([+-]?)(\d+(?:\.\d+)?\*)?pi(?:/(\d+(?:\.\d+)?))?')
EXPECTED = ('write a row `[NAME] a alpha d theta [prismatic]` per joint, base first, in m, rad, '
            'm, rad; what stands in [ ] may be left out, and angles written as pi/2')


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
        raise ArmError(f'{" ".join(words)[:60]!r} is not a row of four numbers', place=where,
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
        raise ArmError(str(err), place=path, remedy='correct it') from None
    if isinstance(content, dict):
        content = content.get('kinematics', content)
    if not isinstance(content, dict):
        content = {'dh': content}
    rows, convention = content.get('dh'), content.get('convention', 'standard')
    if convention not in ('standard', 'modified'):
        raise ArmError(f'convention is {convention!r:.40}; give standard or modified', place=path)
    if not isinstance(rows, list):
        raise ArmError("the key 'dh' has no D-H rows", place=path, remedy=EXPECTED)
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
        raise ArmError(f'{len(rows)} rows, not 1 to {MAX_ROWS}', place=path, remedy=EXPECTED)
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
        raise ArmError(f'the {len(rows)} rows are of {", ".join(map(repr, joints))}, but the bag '
                       f'has the joints {", ".join(map(repr, names))}',
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
                f'no bag has the joints {", ".join(self._chain.joints)} of this file; '
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
