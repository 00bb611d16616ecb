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

"""The first description of an arm: what bags and kinematics tell, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import arm_from_dict
from tudor_dynamics.arm.open_values import OPEN, open_values
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.layouts.carriers import DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.bags.plausibility import moving_joints
from tudor_dynamics.bags.reader import read_planned
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.sources import ChannelSource, Sources
from tudor_dynamics.errors import ArmError
from tudor_dynamics.identification.bag_choice import parse_choice
from tudor_dynamics.library.drafting.chain import chain_of, chain_of_urdf, GRAVITY
from tudor_dynamics.library.drafting.gravity import down
from tudor_dynamics.library.drafting.judging import (
    effort_over_gravity, effort_unit, joint_before, Judgement, strain_unit)
from tudor_dynamics.library.drafting.survey import Carrier, Survey, survey


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
        return read_planned(path, plan, Notes(path, quiet=True))

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
