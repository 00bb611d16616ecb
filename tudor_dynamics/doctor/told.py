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

"""Alternatives that explain a recording better become findings."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.doctor.case import Case, relative
from tudor_dynamics.doctor.structure import Alternative
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.payload.scale import described_masses

MEASURE = 'relative residual'
NEARLY = 2.0
"""A scale within this factor of a thousand or a thousandth is taken for it."""


def told(case: Case, chosen: Alternative) -> Finding:
    """Say what an alternative means."""
    what, remedy, size, unit = _words(case, chosen)
    return Finding(chosen.kind, what, remedy, case.recording.path, chosen.channels, None, size,
                   unit, MEASURE, relative(case.now), relative(chosen.shares))


def _words(case: Case, chosen: Alternative) -> tuple[str, str, float | None, str]:
    both = ' and '.join(chosen.channels)
    if chosen.gravity is not None:
        own = np.array(case.arm.spec.gravity)
        g = np.round(chosen.gravity, 2) + 0.0
        angle = float(np.degrees(np.arccos(np.clip(
            g @ own / (np.linalg.norm(g) * np.linalg.norm(own)), -1.0, 1.0))))
        parallel = ('all axes of the description are parallel to gravity, but the outputs follow '
                    'the pose; ' if chosen.kind == 'axes_parallel_to_gravity' else '')
        return (f'{parallel}gravity along {axis_name(g)} explains the outputs, not that of the '
                f'description, {axis_name(own)}',
                f'gravity: {[float(x) for x in g]}, or correct alpha of the first D-H row',
                angle, 'deg')
    if chosen.kind == 'effort_unit':
        assert chosen.size is not None
        size = next((exact for exact in (1e3, 1e-3)
                     if 1.0 / NEARLY < chosen.size / exact < NEARLY), chosen.size)
        unit = {joint.name: joint.effort.unit for joint in case.arm.joints}[both]
        other = {1e3: f'm{unit}', 1e-3: f'k{unit}'}.get(size, 'A' if unit != 'A' else 'N m')
        return (f'effort of {both} is {size:.3g} times what those of the other joints want: '
                f'{other}, not {unit}?', 'correct joints[].effort.unit, or scale the effort in '
                'the driver', float(size), '')
    if chosen.kind in ('effort_sign', 'joint_sign'):
        what = 'effort' if chosen.kind == 'effort_sign' else 'position'
        return (f'{what} of {both} counts in the other direction than the kinematics say',
                f'turn the sign of the {what} in the driver' + (
                    '' if what == 'effort' else ', or the axis of the joint in the kinematics'),
                -1.0, '')
    if chosen.kind == 'coupling_wrong':
        return (f'the outputs show no coupling of {both}', 'leave couplings out of the '
                'description, or correct pairs, positions and efforts there', 0.0, '')
    if chosen.couplings is not None:
        (pair,), at = chosen.couplings.pairs, chosen.couplings.efforts
        return (f'the motor of {pair.motor} turns with {pair.joint} as well, '
                + ('forwards' if pair.ratio > 0.0 else 'backwards') + f'; what is measured is '
                f'that of the {at}',
                f'couplings: {{pairs: [{{motor: {pair.motor}, joint: {pair.joint}, ratio: '
                f'{pair.ratio:g}}}], positions: {at}, efforts: {at}}}', pair.ratio, '')
    what = {'efforts_exchanged': 'efforts', 'gauges_exchanged': 'gauges',
            'joints_exchanged': 'positions' if chosen.positions else 'names'}[chosen.kind]
    return (f'{what} of {both} are exchanged', 'correct the names in the driver or in the '
            'description', None, '')


def axis_name(gravity: np.ndarray) -> str:
    """Name the direction of a gravity, in the base frame."""
    unit = np.asarray(gravity) / np.linalg.norm(gravity)
    i = int(np.argmax(np.abs(unit)))
    if abs(unit[i]) > 0.99:
        return f'{"+-"[int(unit[i] < 0)]}{"xyz"[i]}'
    return '(' + ', '.join(f'{x:.2f}' for x in unit) + ')'


def opposite(case: Case, hinted: list[int]) -> list[Finding]:
    """Report directions that no residual shows: of efforts alone, and of gravity reversed."""
    names = case.arm.active_joints
    findings = []
    for i in hinted:
        power, _ = case.usual['effort'].friction(i, case.outputs['effort'][:, i])
        findings.append(Finding(
            'effort_sign', f'effort and position of {names[i]} count in opposite directions: its '
            'friction would drive it', 'turn the sign of the effort in the driver (or that of '
            'the position)', case.recording.path, (names[i],), None, -1.0, '',
            'correlation of friction and speed', power, -power))
    if findings or 'effort' not in case.outputs:
        return findings
    known = described_masses(case.arm, case.motion, case.outputs['effort'])
    if known is not None and len(known.believed) and np.all(known.believed < 0.0):
        own = np.array(case.arm.spec.gravity)
        ratio = float(np.median(known.believed))
        findings.append(Finding(
            'gravity_axis', f'the efforts are those of gravity along {axis_name(-own)}, not '
            f'{axis_name(own)}', f'gravity: {[float(-x + 0.0) for x in own]}',
            case.recording.path, (), None, 180.0, 'deg',
            'measured effort over that of the masses', ratio, -ratio))
    return findings
