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
from tudor_dynamics.identification.doctor import samples
from tudor_dynamics.identification.doctor.case import Case, Explained, gain, relative, thin
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.doctor.samples import sizes, trends
from tudor_dynamics.identification.doctor.structure import (
    Alternative, choose, driven_by_friction, lag_told, opposite, output_lag, told, unchanged,
    velocity_lag)
from tudor_dynamics.load.rows import LoadRows
from tudor_dynamics.signals.preprocessing import Timing, timing
from tudor_dynamics.typing import FloatArray


# -- What a description says of itself: lengths, angles and gauges that no arm has

LONGEST = 20.0
"""No arm reaches farther [m]."""
TURN = 2.0 * math.pi + 0.05
"""No angle of a table is larger [rad]."""
THOUSAND = 1000.0


@dataclass(frozen=True, eq=False)
class Suspect:
    """A finding with the arm as it would be without it."""

    finding: Finding  # what is wrong; its evidence is a size until a bag is at hand
    mended: Arm | None = None  # arm with the remedy; None where that cannot be guessed


def suspects(arm: Arm) -> list[Suspect]:
    """Look at a description alone."""
    found = _table(arm)
    mended = next((item.mended for item in found if item.mended is not None), arm)
    return found + _gauges(mended)


def _table(arm: Arm) -> list[Suspect]:
    rows = arm.spec.kinematics.dh
    if rows is None:
        offsets = [float(np.linalg.norm(place.translation))
                   for place in list(arm.full_model.jointPlacements)[1:]]
        reach = sum(offsets)
        if reach <= LONGEST:
            return []
        return [Suspect(Finding(
            'dh_in_millimetres', f'the URDF reaches {reach:.4g} m: its lengths look like '
            'millimetres', 'scale its origins by 0.001', size=reach, unit='m'))]
    found = []
    changed = [list(row) for row in rows]
    reach = sum(abs(a) + abs(d) for a, _, d, _ in rows)
    if reach > LONGEST:
        changed = [[a / THOUSAND, alpha, d / THOUSAND, theta] for a, alpha, d, theta in changed]
        found.append(('dh_in_millimetres', f'the D-H rows reach {reach:.4g} m: their lengths look '
                      'like millimetres', 'give a and d in metres', reach, 'm'))
    largest = max(max(abs(alpha), abs(theta)) for _, alpha, _, theta in rows)
    if largest > TURN:
        changed = [[a, math.radians(alpha), d, math.radians(theta)]
                   for a, alpha, d, theta in changed]
        found.append(('dh_in_degrees', f'the D-H rows have an angle of {largest:.4g} rad: their '
                      'angles look like degrees', 'give alpha and theta in radians', largest,
                      'rad'))
    mended = _rebuilt(arm, {'kinematics': {**arm.spec.kinematics.model_dump(mode='json'),
                                           'dh': changed}}) if found else None
    return [Suspect(Finding(kind, what, remedy, size=size, unit=unit), mended)
            for kind, what, remedy, size, unit in found]


def _gauges(arm: Arm) -> list[Suspect]:
    found = []
    for gauge in arm.gauges:
        length = link_length(arm, gauge)
        if not gauge.distance > (1.001 * length if length else LONGEST):
            continue
        millimetres = gauge.distance > 1.0 and gauge.distance / THOUSAND <= (length or LONGEST)
        reach = f', whose link is {length:.4g} m long' if length else ''
        what = f'gauge {gauge.name} sits {gauge.distance:.4g} m behind {gauge.joint}{reach}'
        mended = None
        if millimetres:
            gauges = [one.model_dump(mode='json') | (
                {'distance': one.distance / THOUSAND} if one.name == gauge.name else {})
                for one in arm.gauges]
            mended = _rebuilt(arm, {'gauges': gauges})
        found.append(Suspect(Finding(
            'gauge_in_millimetres' if millimetres else 'gauge_beyond_link',
            what + (': millimetres' if millimetres else ''),
            'give gauges[].distance in metres, from the axis of the joint along its link',
            channels=(gauge.name,), size=gauge.distance, unit='m'), mended))
    return found


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


# -- Find what the arm carries and the model does not know

LEAST_GAIN = 1.0
"""Sum of log ratios by which a load has to lessen what the model leaves."""
EXPLAINED = 0.5
"""Part of the model's relative error that a load leaves at most."""
LEAST_ERROR = 0.1
"""Relative error, friction left out, below which a model is as it was."""


def load_of(
    case: Case, predicted: Mapping[str, FloatArray], bag: str,
) -> Finding | None:
    """
    Explain what a model leaves over by a body at the end of the arm.

    predicted (n, channels); returns None where a load explains little.
    """
    best: Finding | None = None
    for output, values in predicted.items():
        found = _of_output(case, output, values, bag)
        if found is not None and (best is None or (found.now or 0.0) > (best.now or 0.0)):
            best = found
    return best


def _of_output(case: Case, output: str, predicted: FloatArray, bag: str) -> Finding | None:
    measured = case.outputs[output]
    sound = case.sound[output]
    left = np.where(sound, measured - predicted, 0.0)
    bodies = case.bodies[output]
    # another day's friction and zero are no load
    # nor are filters that are later or earlier than those of the fit
    rates = np.gradient(predicted, case.thinned.t, axis=0)
    own = [np.column_stack([columns[:, 1:] if output == 'effort' else columns, rates[:, i]])
           for i, columns in enumerate(bodies.own(case.motion))]
    rows = LoadRows(case.arm, output).rows(case.motion)
    groups = bodies.groups
    nothing = Explained(np.zeros_like(rows[:, :, :1]), own, groups)
    body = Explained(rows, own, groups)
    sizes = np.sum((measured - measured.mean(axis=0)) ** 2, axis=0)
    before = np.sum(nothing.residuals(left) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    after = np.sum(body.residuals(left) ** 2, axis=0) / np.maximum(sizes, 1e-300)
    felt = sound & (before > LEAST_ERROR ** 2)
    if not felt.any():
        return None
    better = gain(np.maximum(before[felt], 1e-9), np.maximum(after[felt], 1e-9))
    if better < LEAST_GAIN:
        return None
    now, then = float(np.sqrt(before[felt].mean())), float(np.sqrt(after[felt].mean()))
    if then > EXPLAINED * now:
        return None
    return Finding(
        'load_unknown', 'the arm carries what the model does not know',
        'fit a model to bags with this load; bags of two loads and --payload-of BAG=KG give one '
        'of all loads', bag, (), None, None, '', 'relative error', now, then)


# -- The doctor looks at one bag: description, samples, stamps, then alternatives

HELD_SPAN = 0.02
"""A joint that moves farther is not held [rad or m]."""
BROKEN = ('constant', 'held', 'dying', 'saturated')
"""What makes the values of a channel none to judge a description by."""


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
    thinned = thin(clean)
    if thinned is None:
        return Examined((*(item.finding for item in described), *findings))
    found = velocity_lag(clean, thinned)
    if found is not None:
        findings.append(found)
    case = Case(mended, clean, thinned, broken)
    if not case.outputs:
        return Examined((*(item.finding for item in described), *findings), case)
    chosen, model_findings = _by_model(case)
    for suspect in described:
        wrong = Case(arm, clean, thinned, broken)
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
    findings += samples.flat(clean, joints, gauges)
    findings += samples.standstill(clean, samples.moving(clean))
    findings += odd_bag(recording)
    uneven = retimed or timing(clean)
    if uneven is not None and uneven.clear:
        done = '; even stamps took their place' if retimed is not None else ''
        findings.append(Finding(
            'jitter', f'stamps jitter by {uneven.jitter * 1e3:.2g} ms on an even sampling of '
            f'{1.0 / recording.dt:.4g} Hz{done}', 'stamp in the driver when the sample is taken',
            recording.path, (), 0.0, uneven.jitter, 's', 'roughness of the positions',
            uneven.now, uneven.even))
    return clean, findings


def odd_bag(recording: Recording) -> list[Finding]:
    """Tell of what was found while the bag was read: its clock, and velocities that are none."""
    findings = []
    for item in recording.oddities.set_backs:
        findings.append(Finding(
            'clock_set_back', f'the clock was set back by {item.seconds:.4g} s at '
            f'{item.time:.3f} s; {item.lost} messages with stamps that had been there are left '
            'out, and the record is split', 'let the clock settle before recording; steer '
            'clocks slowly (chrony without steps)', recording.path, (), item.time,
            item.seconds, 's'))
    zero = recording.oddities.zero_velocities
    if zero:
        findings.append(Finding(
            'velocity_zeros', f'velocities of {", ".join(zero)} are all zero, though the joints '
            'move; velocities are not used', 'let the driver publish velocities, or none',
            recording.path, zero, 0.0, 0.0))
    return findings


def not_listed(arm: Arm, recording: Recording) -> list[Finding]:
    """Find joints of the kinematics that move, but are held by the description."""
    moved = {name: span for name, span in recording.oddities.others.items()
             if name in arm.held_joints and span > HELD_SPAN}
    if not moved:
        return []
    most = max(moved, key=lambda name: moved[name])
    return [Finding(
        'joint_not_listed', f'{", ".join(moved)} of the kinematics move, but the description '
        f'takes them as held ({most} by {moved[most]:.3g})', 'list them under joints, and under '
        'active_joints where that is given', recording.path, tuple(moved), None, moved[most],
        'm' if arm.is_prismatic(most) else 'rad')]


def _by_model(case: Case) -> tuple[Alternative, list[Finding]]:
    findings = sizes(case) if 'effort' in case.outputs else []
    if findings:
        case.scale('effort', {name: item.size or 1.0 for item in findings
                              for name in item.channels})
    hinted: list[int] = []
    if 'effort' in case.outputs:
        hinted = driven_by_friction(case, case.usual['effort'], case.outputs['effort'])
    usual = unchanged(case)
    chosen = choose(case, hinted) or usual
    if chosen is not usual and _only_a_trend(case, chosen, hinted):
        chosen = usual
    lags = _lags(case, usual)
    if chosen is not usual and max((gain for _, gain in lags), default=0.0) > chosen.gain:
        chosen = usual
    if chosen is not usual:
        findings.append(told(case, chosen))
        lags = _lags(case, chosen)
    findings += [finding for finding, _ in lags]
    trending = [item for name, explained in chosen.explained.items()
                for item in trends(case, name, explained, chosen.outputs[name])]
    if not lags and chosen is usual:
        # what dies has no friction to judge it by
        dead = {item.channels[0] for item in trending if item.kind == 'dying'}
        findings += opposite(case, [i for i in hinted if case.arm.active_joints[i] not in dead])
    shown = {name for finding in findings for name in finding.channels}
    findings += [item for item in trending if item.channels[0] not in shown]
    return chosen, findings


def _only_a_trend(case: Case, chosen: Alternative, hinted: list[int]) -> bool:
    """Say whether one channel that drifts or dies is all that an alternative makes up for."""
    found = [item for output, explained in case.usual.items()
             for item in trends(case, output, explained, case.outputs[output])]
    if not found:
        return False
    trending = {name for item in found for name in item.channels}
    better = sum(2.0 * np.log(item.now / item.otherwise) if item.now and item.otherwise else
                 np.inf for item in found)
    # parameters that channels share spoil others with the one that drifts
    if better < chosen.gain and trending >= {*chosen.channels}:
        return False
    rest = Case(case.arm, case.recording, case.thinned,
                case.broken | trending)
    for name, values in case.outputs.items():  # scaled as those of the case are
        rest.outputs[name] = np.where(rest.sound[name], values, 0.0)
    return choose(rest, hinted) is None


def _lags(case: Case, chosen: Alternative) -> list[tuple[Finding, float]]:
    found = []
    for name in chosen.outputs:
        lag = output_lag(case, name, chosen)
        finding = lag_told(case.recording, name, lag, case.brevity)
        if finding is not None:
            found.append((finding, lag.gain))
    return found
