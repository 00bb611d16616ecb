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

"""The doctor examines one bag: description, samples, stamps, load, then alternatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.arm.kinematics import unit_vector
from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.errors import ArmError
from tudor_dynamics.identification.doctor import samples, settings
from tudor_dynamics.identification.doctor.alternatives import (
    Alternative, choose, driven_by_friction, finding_of, lags, opposite, unchanged, velocity_lag)
from tudor_dynamics.identification.doctor.case import Case, decimate, Explained, gain, relative
from tudor_dynamics.identification.doctor.findings import Finding, found
from tudor_dynamics.identification.doctor.samples import sizes, trends
from tudor_dynamics.load.rows import LoadRows
from tudor_dynamics.signals.preprocessing import Timing, timing
from tudor_dynamics.typing import FloatArray


THOUSAND = 1000.0
BROKEN = ('constant', 'held', 'dying', 'saturated')
"""Findings of channels whose values no description is judged by."""


@dataclass(frozen=True, eq=False)
class Suspect:
    """A finding with the arm as it would be without it."""

    finding: Finding  # what is wrong; its evidence is a size until a bag is at hand
    mended: Arm | None = None  # arm with the remedy; None where that cannot be guessed


def suspects(arm: Arm) -> list[Suspect]:
    """Look at a description alone."""
    suspected = _table(arm)
    mended = next((item.mended for item in suspected if item.mended is not None), arm)
    return suspected + _gauges(mended)


def _table(arm: Arm) -> list[Suspect]:
    rows = arm.spec.kinematics.dh
    if rows is None:
        reach = sum(float(np.linalg.norm(place.translation))
                    for place in list(arm.full_model.jointPlacements)[1:])
        return [] if reach <= settings.LONGEST_ARM else [Suspect(found(
            'dh_in_millimetres', f'the URDF reaches {reach:.4g} m: its lengths look like '
            'millimetres', size=reach, remedy='scale its origins by 0.001'))]
    findings = []
    changed = [list(row) for row in rows]
    reach = sum(abs(a) + abs(d) for a, _, d, _ in rows)
    if reach > settings.LONGEST_ARM:
        changed = [[a / THOUSAND, alpha, d / THOUSAND, theta] for a, alpha, d, theta in changed]
        findings.append(found('dh_in_millimetres', f'the D-H rows reach {reach:.4g} m: their '
                              'lengths look like millimetres', size=reach))
    largest = max(max(abs(alpha), abs(theta)) for _, alpha, _, theta in rows)
    if largest > settings.TURN:
        changed = [[a, math.radians(alpha), d, math.radians(theta)]
                   for a, alpha, d, theta in changed]
        findings.append(found('dh_in_degrees', f'the D-H rows have an angle of {largest:.4g} rad: '
                              'their angles look like degrees', size=largest))
    mended = _rebuilt(arm, {'kinematics': {**arm.spec.kinematics.model_dump(mode='json'),
                                           'dh': changed}}) if findings else None
    return [Suspect(finding, mended) for finding in findings]


def _gauges(arm: Arm) -> list[Suspect]:
    suspected = []
    for gauge in arm.gauges:
        length = link_length(arm, gauge)
        if not gauge.distance > (1.001 * length if length else settings.LONGEST_ARM):
            continue
        millimetres = gauge.distance > 1.0 and gauge.distance / THOUSAND <= (
            length or settings.LONGEST_ARM)
        reach = f', whose link is {length:.4g} m long' if length else ''
        what = f'gauge {gauge.name} sits {gauge.distance:.4g} m behind {gauge.joint}{reach}'
        mended = None
        if millimetres:
            gauges = [one.model_dump(mode='json') | (
                {'distance': one.distance / THOUSAND} if one.name == gauge.name else {})
                for one in arm.gauges]
            mended = _rebuilt(arm, {'gauges': gauges})
        suspected.append(Suspect(found(
            'gauge_in_millimetres' if millimetres else 'gauge_beyond_link',
            what + (': millimetres' if millimetres else ''), channels=(gauge.name,),
            size=gauge.distance), mended))
    return suspected


def link_length(arm: Arm, gauge: GaugeSpec) -> float | None:
    """
    Say how far the link of a gauge reaches along its direction.

    Returns [m], None where the kinematics do not say.
    """
    model = arm.full_model
    joint = model.getJointId(gauge.joint)
    direction = unit_vector(gauge.direction)
    places = [model.jointPlacements[i].translation for i in range(1, model.njoints)
              if model.parents[i] == joint]
    places += [frame.placement.translation for frame in model.frames
               if frame.parentJoint == joint]
    reach = max((float(direction @ place) for place in places), default=0.0)
    return reach if reach > 1e-6 else None


def _rebuilt(arm: Arm, changes: dict[str, Any]) -> Arm | None:
    content = arm.spec.model_dump(mode='json') | changes
    try:
        return arm_from_dict(content, base=Path(arm.source).parent, source=arm.source)
    except ArmError:
        return None


def load_of(
    case: Case, predicted: Mapping[str, FloatArray], bag: str,
) -> Finding | None:
    """
    Explain the residuals of a model by a body at the end of the arm.

    predicted (n, channels); returns None where a load explains little.
    """
    findings = [_of_output(case, output, values, bag) for output, values in predicted.items()]
    return max((item for item in findings if item is not None),
               key=lambda item: item.now or 0.0, default=None)


def _of_output(case: Case, output: str, predicted: FloatArray, bag: str) -> Finding | None:
    measured = case.outputs[output]
    sound = case.sound[output]
    residual = np.where(sound, measured - predicted, 0.0)
    bodies = case.bodies[output]
    # another day's friction and zero are no load
    # nor are filters that are later or earlier than those of the fit
    rates = np.gradient(predicted, case.decimated.t, axis=0)
    own = [np.column_stack([columns[:, 1:] if output == 'effort' else columns, rates[:, i]])
           for i, columns in enumerate(bodies.own(case.motion))]
    rows = LoadRows(case.arm, output).rows(case.motion)
    groups = bodies.groups
    nothing = Explained(np.zeros_like(rows[:, :, :1]), own, groups)
    body = Explained(rows, own, groups)
    sizes = np.sum((measured - measured.mean(axis=0)) ** 2, axis=0)
    before = np.sum(nothing.residuals(residual) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    after = np.sum(body.residuals(residual) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    felt = sound & (before > settings.LOAD_ERROR ** 2)
    if not felt.any():
        return None
    better = gain(np.maximum(before[felt], 1e-9), np.maximum(after[felt], 1e-9))
    if better < settings.LOAD_GAIN:
        return None
    now, then = float(np.sqrt(before[felt].mean())), float(np.sqrt(after[felt].mean()))
    if then > settings.LOAD_SHARE * now:
        return None
    return found('load_unknown', 'the arm carries what the model does not know', bag, now=now,
                 otherwise=then)


@dataclass(frozen=True, eq=False)
class Examined:
    """What was found about a bag."""

    findings: tuple[Finding, ...]  # what is wrong; empty for a clean bag of a right description
    # Bag with its arm, for comparisons with other bags; None where it is too short.
    case: Case | None = None
    # What explains it better than the description, or the description as it is.
    chosen: Alternative | None = None


def examine(arm: Arm, recording: Recording, retimed: Timing | None = None) -> Examined:
    """Look at a bag."""
    clean, findings = look_at_samples(recording, arm.active_joints, arm.gauge_names, retimed)
    findings = not_listed(arm, recording) + findings
    described = suspects(arm)
    mended = next((item.mended for item in reversed(described) if item.mended is not None), arm)
    broken = {name for item in findings if item.kind in BROKEN for name in item.channels}
    decimated = decimate(clean)
    if decimated is None:
        return Examined((*(item.finding for item in described), *findings))
    findings += velocity_lag(clean, decimated)
    case = Case(mended, clean, decimated, broken)
    if not case.outputs:
        return Examined((*(item.finding for item in described), *findings), case)
    chosen, model_findings = _by_model(case)
    for suspect in described:
        wrong = Case(arm, clean, decimated, broken)
        model_findings.insert(0, replace(
            suspect.finding, bag=recording.path, measure='relative residual',
            now=relative(wrong.now), otherwise=relative(case.now)))
    return Examined((*model_findings, *findings), case, chosen)


def look_at_samples(
    recording: Recording, joints: tuple[str, ...], gauges: tuple[str, ...],
    retimed: Timing | None = None,
) -> tuple[Recording, list[Finding]]:
    """Look at what needs no description: samples and stamps."""
    clean, findings = samples.outliers(recording, joints, gauges)
    return clean, [*findings, *samples.flat(clean, joints, gauges),
                   *samples.standstill(clean, samples.moving(clean)), *oddities(recording),
                   *jitter(clean, retimed)]


def jitter(recording: Recording, retimed: Timing | None) -> list[Finding]:
    """Report stamps that jitter on an even sampling."""
    uneven = retimed or timing(recording)
    if uneven is None or not uneven.clear:
        return []
    done = '; even stamps took their place' if retimed is not None else ''
    return [found(
        'jitter', f'stamps jitter by {uneven.jitter * 1e3:.2g} ms on an even sampling of '
        f'{1.0 / recording.dt:.4g} Hz{done}', recording.path, time=0.0, size=uneven.jitter,
        now=uneven.now, otherwise=uneven.even)]


def oddities(recording: Recording) -> list[Finding]:
    """Report what was found while the bag was read: its clock, and velocities that are none."""
    findings = [found(
        'clock_set_back', f'the clock was set back by {item.seconds:.4g} s at '
        f'{item.time:.3f} s; {item.lost} messages with stamps that had been there are left '
        'out, and the record is split', recording.path, time=item.time, size=item.seconds)
        for item in recording.oddities.set_backs]
    zero = recording.oddities.zero_velocities
    return findings if not zero else [*findings, found(
        'velocity_zeros', f'velocities of {", ".join(zero)} are all zero, though the joints '
        'move; velocities are not used', recording.path, zero, time=0.0, size=0.0)]


def not_listed(arm: Arm, recording: Recording) -> list[Finding]:
    """Find joints of the kinematics that move, but are held by the description."""
    moved = {name: span for name, span in recording.oddities.others.items()
             if name in arm.held_joints and span > settings.MOVING_SPAN}
    if not moved:
        return []
    most = max(moved, key=lambda name: moved[name])
    return [replace(found(
        'joint_not_listed', f'{", ".join(moved)} of the kinematics move, but the description '
        f'takes them as held ({most} by {moved[most]:.3g})', recording.path, tuple(moved),
        size=moved[most]), unit='m' if arm.is_prismatic(most) else 'rad')]


def _by_model(case: Case) -> tuple[Alternative, list[Finding]]:
    findings = sizes(case) if 'effort' in case.outputs else []
    if findings:
        case.scale('effort', {name: item.size or 1.0 for item in findings
                              for name in item.channels})
    hinted = driven_by_friction(case)
    usual = unchanged(case)
    chosen = choose(case, hinted) or usual
    if chosen is not usual and _only_a_trend(case, chosen, hinted):
        chosen = usual
    late = lags(case, usual)
    if chosen is not usual and max((gain for _, gain in late), default=0.0) > chosen.gain:
        chosen = usual
    if chosen is not usual:
        findings.append(finding_of(case, chosen))
        late = lags(case, chosen)
    findings += [finding for finding, _ in late]
    trending = _trends(case, chosen)
    if not late and chosen is usual:
        # what dies has no friction to judge it by
        dead = {item.channels[0] for item in trending if item.kind == 'dying'}
        findings += opposite(case, [i for i in hinted if case.arm.active_joints[i] not in dead])
    shown = {name for finding in findings for name in finding.channels}
    return chosen, findings + [item for item in trending if item.channels[0] not in shown]


def _trends(case: Case, chosen: Alternative) -> list[Finding]:
    return [item for name, explained in chosen.explained.items()
            for item in trends(case, name, explained, chosen.outputs[name])]


def _only_a_trend(case: Case, chosen: Alternative, hinted: list[int]) -> bool:
    """Say whether one channel that drifts or dies is all that an alternative makes up for."""
    trended = _trends(case, unchanged(case))
    if not trended:
        return False
    trending = {name for item in trended for name in item.channels}
    better = sum(2.0 * np.log(item.now / item.otherwise) if item.now and item.otherwise else
                 np.inf for item in trended)
    # parameters that channels share spoil others with the one that drifts
    if better < chosen.gain and trending >= {*chosen.channels}:
        return False
    rest = Case(case.arm, case.recording, case.decimated,
                case.broken | trending)
    for name, values in case.outputs.items():  # scaled as those of the case are
        rest.outputs[name] = np.where(rest.sound[name], values, 0.0)
    return choose(rest, hinted) is None
