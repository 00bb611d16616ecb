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
import math
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import arm_from_dict, OPEN, open_values
from tudor_dynamics.arm.schema import one_spelling
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.messages import DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.reader import read_planned
from tudor_dynamics.bags.recording import ChannelSource, moving_joints, Recording, Sources
from tudor_dynamics.errors import ArmError, printable
from tudor_dynamics.files import load_yaml
from tudor_dynamics.identification.dataset import parse_choice
from tudor_dynamics.identification.drafting.judging import (
    Carrier, down, effort_over_gravity, effort_unit, joint_before, Judgement, strain_unit, Survey,
    survey)
from tudor_dynamics.identification.drafting.kinematics import chain_of, chain_of_urdf, GRAVITY
import yaml


# -- The first description of an arm: what bags and kinematics tell, and what they leave open

@dataclass
class Draft:
    """A description that may leave values open, with what is said of its parts."""

    content: dict[str, Any]  # description as plain values, `?` where a value is open
    # Key (`gravity`, `joints.NAME`, `gauges.NAME`, ...) to what the bags show of it.
    remarks: dict[str, str] = field(default_factory=dict)
    bags: tuple[str, ...] = ()  # bags that were looked at
    # What the user should know beside the file, one sentence each.
    notes: list[str] = field(default_factory=list)

    @property
    def unknown(self) -> list[tuple[str | int, ...]]:
        """Where values are still open."""
        return list(open_values(self.content))


def _source_of(joint: str, found: Survey) -> tuple[Carrier | None, dict[str, Any]]:
    """Give where the effort of a joint comes from: the first topic in which it changes."""
    for carrier in sorted((item for item in found.efforts if joint in item.ranges),
                          key=lambda item: not item.changes(joint)):
        source: dict[str, Any] = {'topic': _relative(carrier.topic)}
        if carrier.msgtype == DYNAMIC_JOINT_STATE:
            source['interface'] = carrier.field
        return carrier, source
    for carrier in found.efforts:
        if carrier.msgtype == FLOAT64_MULTI_ARRAY:
            return None, {'topic': _relative(carrier.topic), 'index': OPEN}
    return None, {}


def _relative(topic: str) -> str:
    """Write a topic as descriptions do, so that namespaces and remapping work."""
    return topic[1:] if topic.count('/') == 1 else topic


def _gauges(found: Survey) -> list[tuple[Carrier, str, dict[str, Any]]]:
    """List what may be gauges: where each stands, its key there, and the begin of its entry."""
    entries: list[tuple[Carrier, str, dict[str, Any]]] = []
    for carrier in found.strains:
        for key in carrier.ranges:
            entry: dict[str, Any] = {'name': key, 'topic': _relative(carrier.topic)}
            if carrier.msgtype == FLOAT64_MULTI_ARRAY:
                entry['name'] = f'{carrier.topic.rpartition("/")[2]}_{key}'
                entry['index'] = int(key)
            elif carrier.msgtype == DYNAMIC_JOINT_STATE:
                entry['interface'] = carrier.field
            if entry['name'] not in [other['name'] for _, _, other in entries]:
                entries.append((carrier, key, entry))
    return entries


class _Writer:
    """Puts a draft together, part by part."""

    def __init__(self, bags: Sequence[str], urdf: Path | None, dh: Path | None, out: Path) -> None:
        paths = [parse_choice(bag).path for bag in bags]
        self._paths = list(dict.fromkeys(paths))
        known = chain_of_urdf(urdf, out).joints if urdf is not None else ()
        self._found = survey([describe(path) for path in self._paths], known)
        recorded = tuple(self._found.positions.ranges)
        self._chain = chain_of(urdf, dh, recorded, out)
        self._joints = tuple(joint for joint in self._chain.joints if joint in recorded)
        if not self._joints:
            raise ArmError(
                f'none of the joints {", ".join(self._chain.joints)} is in the bags, whose '
                f'{self._found.positions.topic} has {", ".join(recorded)}', place=urdf or dh,
                remedy='give the URDF of the arm that was recorded, with its names')
        self._sources = {joint: _source_of(joint, self._found) for joint in self._joints}
        self._gauges = _gauges(self._found)
        self._recordings = [self._read(path) for path in self._paths]
        slides = [self._chain.slides(joint) for joint in self._joints]
        moves = np.any([moving_joints(item, slides) for item in self._recordings], axis=0)
        self._moving = tuple(joint for joint, moving in zip(self._joints, moves, strict=True)
                             if moving)
        if not self._moving:
            raise ArmError('no joint moves in the bags', place=self._paths[0],
                           remedy='record a motion')
        self.draft = Draft({'name': self._chain.name or out.stem},
                           bags=tuple(self._paths))
        if self._chain.note:
            self.draft.notes.append(self._chain.note)

    def _read(self, path: str) -> Recording:
        efforts = tuple(
            ChannelSource(carrier.topic, joint, carrier.field, carrier.msgtype)
            for joint, (carrier, _) in self._sources.items() if carrier is not None)
        whole = len(efforts) == len(self._joints)
        plan = Sources(
            self._found.positions.topic, self._joints,
            tuple(self._chain.slides(joint) for joint in self._joints),
            (None,) * len(self._joints),
            efforts if whole else (),
            tuple(entry['name'] for _, _, entry in self._gauges),
            tuple(ChannelSource(carrier.topic, key, carrier.field, carrier.msgtype)
                  for carrier, key, _ in self._gauges))
        return read_planned(path, plan, quiet=True)

    def write(self) -> Draft:
        """Write all parts."""
        content, found = self.draft.content, self._found
        content['kinematics'] = self._chain.content
        content['gravity'] = self._gravity()
        content['joint_topic'] = _relative(found.positions.topic)
        self.draft.remarks['joint_topic'] = (
            f'{found.positions.rate:.4g} Hz, {found.seconds:.4g} s in '
            f'{len(self._paths)} bag{"s" * (len(self._paths) > 1)}')
        content['joints'] = [self._joint(joint) for joint in self._chain.joints]
        if len(self._moving) < len(self._chain.joints):
            content['active_joints'] = list(self._moving)
        gauges = [self._gauge(*item) for item in enumerate(self._gauges)]
        if gauges:
            content['gauges'] = gauges
        elif not any('topic' in joint.get('effort', ()) for joint in content['joints']):
            self.draft.notes.append('neither efforts nor strains are in the bags: nothing can be '
                                    'learned from them, record them as well')
        return self.draft

    @property
    def _with_effort(self) -> list[Recording]:
        return [item for item in self._recordings if item.effort is not None]

    def _gravity(self) -> list[float]:
        """Judge where down is; with the masses of a URDF, which way along its axis, too."""
        model, measured = self._chain.model, self._with_effort
        if model is None or not measured:
            return list(GRAVITY)
        index = self._chain.index(self._joints)
        found = down(model, measured, index, [joint in self._moving for joint in self._joints])
        gravity, told = np.array(found.gravity), len(found.alike) == 1
        model.gravity = pin.Motion(gravity, np.zeros(3))
        if self._chain.has_masses and not told:
            # what masses the links have says which of them it is, and which way
            slopes = {}
            for alike in found.alike:
                model.gravity = pin.Motion(np.array(alike), np.zeros(3))
                slopes[alike] = list(effort_over_gravity(model, measured, index).values())
            best = max(slopes, key=lambda alike: len(slopes[alike]))
            told = bool(slopes[best])
            gravity = np.array(best) * (-1.0 if told and np.median(slopes[best]) < 0.0 else 1.0)
            model.gravity = pin.Motion(gravity, np.zeros(3))
        if found.reason:
            self.draft.remarks['gravity'] = found.reason
            which = '' if told else '; make sure of axis and sign'
            self.draft.notes.append(f'gravity is not along -z of the base: {found.reason}{which}')
        return [float(value) + 0.0 for value in gravity]

    def _unit(self) -> dict[str, Judgement]:
        """Judge the unit of each source of efforts, by all joints that it carries."""
        judged: dict[str, Judgement] = {}
        slopes: dict[int, float] = {}
        model = self._chain.model
        if self._with_effort and model is not None and self._chain.has_masses:
            slopes = effort_over_gravity(model, self._with_effort,
                                         self._chain.index(self._joints))
        for key in dict.fromkeys(str(source) for _, source in self._sources.values()):
            joints = [joint for joint in self._joints if str(self._sources[joint][1]) == key]
            carrier = self._sources[joints[0]][0]
            if carrier is None:
                judged[key] = Judgement(OPEN, 'which place in the array is this joint?')
                continue
            own = {column: slope for column, slope in slopes.items()
                   if self._joints[column] in joints}
            peaks = [max(map(abs, carrier.ranges[joint])) for joint in joints]
            limits = [0.0] * len(joints) if model is None else [
                float(model.effortLimit[model.joints[model.getJointId(joint)].idx_v])
                for joint in joints]
            name = carrier.field if carrier.msgtype == DYNAMIC_JOINT_STATE else carrier.topic
            torque = 'N' if all(map(self._chain.slides, joints)) else 'N m'
            judged[key] = effort_unit(own, peaks, limits, name, torque)
            if model is None and judged[key].value == torque:
                judged[key] = Judgement(OPEN, f'{judged[key].reason}: N m, or N of a joint that '
                                              'slides?')
        return judged

    def _joint(self, joint: str) -> dict[str, Any]:
        entry: dict[str, Any] = {'name': joint}
        if self._chain.kinds and self._chain.kinds[self._chain.joints.index(joint)]:
            entry['type'] = self._chain.kinds[self._chain.joints.index(joint)]
        slides = self._chain.slides(joint)
        unit = 'm' if slides else 'rad'
        if joint not in self._joints:
            self.draft.remarks[f'joints.{joint}'] = 'not in the bags: held at 0'
            return {**entry, **({'effort': {'unit': 'N'}} if slides else {})}
        low, high = self._found.positions.ranges[joint]
        unit = unit if self._chain.model is not None else 'rad or m'
        text = f'{low:.4g} .. {high:.4g} {unit}'
        if joint not in self._moving:
            place = float(np.median(np.concatenate([
                item.q[:, self._joints.index(joint)] for item in self._recordings])))
            entry['hold'] = round(place, 6) + 0.0
            self.draft.remarks[f'joints.{joint}'] = f'does not move ({text}): held'
            return {**entry, **({'effort': {'unit': 'N'}} if slides else {})}
        carrier, source = self._sources[joint]
        if not source:
            self.draft.remarks[f'joints.{joint}'] = f'{text}; no effort in the bags'
            return {**entry, **({'effort': {'unit': 'N'}} if slides else {})}
        judged = self._units[str(source)]
        unit = judged.value
        if unit in ('N m', 'N'):
            unit = 'N' if slides else 'N m'
        entry['effort'] = {**source, 'unit': unit}
        if carrier is not None:
            least, most = carrier.ranges[joint]
            text += f'; effort {least:.4g} .. {most:.4g}'
            if not carrier.changes(joint):
                self.draft.notes.append(f'the effort of {joint} in {carrier.topic} never changes')
        self.draft.remarks[f'joints.{joint}'] = text
        self.draft.remarks['unit'] = judged.reason
        return entry

    @property
    def _units(self) -> dict[str, Judgement]:
        if not hasattr(self, '_judged'):
            self._judged = self._unit()
        return self._judged

    def _gauge(self, number: int, item: tuple[Carrier, str, dict[str, Any]]) -> dict[str, Any]:
        carrier, key, begin = item
        unit = strain_unit(*carrier.ranges[key])
        where = Judgement(OPEN, 'behind which joint?')
        measured = [recording for recording in self._recordings if recording.strain is not None]
        if self._chain.model is not None and measured:
            where = joint_before(self._chain.model, measured, self._chain.index(self._joints),
                                 number, self._joints, self._moving)
        self.draft.remarks[f'gauges.{begin["name"]}'] = f'{unit.reason}; {where.reason}'
        name = begin.pop('name')
        return {'name': name, 'joint': where.value, 'distance': OPEN, **begin, 'unit': unit.value}


def draft_of(
    bags: Sequence[str], *, urdf: Path | None = None, dh: Path | None = None, out: Path,
) -> Draft:
    """Write the first description of an arm."""
    return _Writer(bags, urdf, dh, out).write()


def check_draft(draft: Draft, out: Path) -> None:
    """Make sure that a description without open values can be used."""
    if not draft.unknown:
        arm_from_dict(draft.content, base=out.parent, source=str(out))


# -- What is asked for the values that a first description leaves open

Question = tuple[str, Callable[[str], Any]]


def question_of(draft: Draft, path: tuple[str | int, ...]) -> Question | None:
    """Give what to ask for an open value; returns None for what cannot be said in a word."""
    entry: Any = draft.content
    for step in path[:-1]:
        entry = entry[step]
    joints = [joint['name'] for joint in draft.content['joints']]

    def one_of(values: Sequence[str]) -> Callable[[str], str]:
        def choose(answer: str) -> str:
            value = str(one_spelling(answer))
            if value not in values:
                raise ValueError(f'one of {", ".join(values)}')
            return value
        return choose

    def length(answer: str) -> float:
        value = float(answer)
        if not 0.0 <= value < math.inf:
            raise ValueError('a distance in m')
        return value

    key = path[-1]
    if key == 'unit' and 'distance' not in entry:
        return 'unit (A, N m, N)', one_of(('A', 'N m', 'N'))
    if key == 'unit':
        return 'unit (um/m, m/m, mV/V, V, N m)', one_of(('um/m', 'm/m', 'mV/V', 'V', 'N m'))
    if key == 'joint':
        return f'joint before it ({", ".join(joints)})', one_of(joints)
    if key == 'distance':
        return 'distance along the link from that joint [m]', length
    if key == 'index':
        return 'place in the array, from 0', int
    return None


def answer(draft: Draft, path: tuple[str | int, ...], value: Any) -> None:
    """Put a value in the place of an open one."""
    entry: Any = draft.content
    for step in path[:-1]:
        entry = entry[step]
    entry[path[-1]] = value
    if path[-1] == 'unit' and path[0] == 'joints':  # one driver, one unit
        for joint in draft.content['joints']:
            other = joint.get('effort', {})
            if other.get('unit') == OPEN and all(
                    other.get(key) == entry.get(key) for key in ('topic', 'interface')):
                other['unit'] = value


# -- A first description as YAML with remarks, for people to read and go on with

WIDTH = 99
"""Of remarks [characters]."""
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
    lines, line = [], f'{indent}#'
    for word in printable(text).split():
        if len(line) + 1 + len(word) > WIDTH and not line.endswith('#'):
            lines.append(line)
            line = f'{indent}#'
        line += f' {word}'
    return [*lines, line]


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
    lines += _remark('docs/arm_yaml.md of tudor_dynamics has every key with unit and default.'
                     + (" A value that is '?' cannot be told from the bags: write it; nothing is "
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
    lines += _list('joints', content['joints'], draft)
    if 'active_joints' in content:
        lines += _remark('Those that move in the bags; the others are held.')
        lines.append(f'active_joints: {_flow(content["active_joints"])}')
    if 'gauges' in content:
        lines += _list('gauges', content['gauges'], draft)
    text = '\n'.join(lines) + '\n' + ('' if 'gauges' in content else NO_GAUGES) + LEFT_TO_FIT
    assert load_yaml(text) == content, 'the file reads as what was meant'
    return text
