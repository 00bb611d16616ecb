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

"""The doctor looks at one bag: description, samples, stamps, then alternatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.doctor import samples
from tudor_dynamics.doctor.case import Case, relative
from tudor_dynamics.doctor.description import suspects
from tudor_dynamics.doctor.lags import lag_told, output_lag, velocity_lag
from tudor_dynamics.doctor.structure import (
    Alternative, choose, driven_by_friction, unchanged)
from tudor_dynamics.doctor.thinned import thin
from tudor_dynamics.doctor.told import opposite, told
from tudor_dynamics.doctor.trends import trends
from tudor_dynamics.doctor.units import sizes
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.signals.timing import Timing, timing

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
