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

"""Efforts in another unit than described: by their size, and by the masses of the URDF."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.doctor.case import Case
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.payload.scale import BELIEVED, Described, described_masses

LARGEST = {'A': 150.0, 'N m': 3000.0, 'N': 20000.0}
"""No joint of an arm has more, in any of the units of efforts."""
BEYOND = 10.0
"""As many times the effort limit of the URDF is another unit."""
UNLIMITED = 1e6
FEW_TIMES = 3.3
"""Masses of a URDF are wrong by less."""
THOUSAND = 30.0
"""Factors beyond are those between a unit and its thousandth."""


def sizes(case: Case) -> list[Finding]:
    """Find efforts whose size is that of another unit."""
    effort = case.outputs['effort']
    units = [joint.effort.unit for joint in case.arm.joints]
    largest = np.abs(effort).max(axis=0)
    limits = np.array([float(case.arm.model.effortLimit[case.arm.velocity_index[i]])
                       for i in range(len(units))])
    bounds = np.array([LARGEST[unit] for unit in units])
    for i, unit in enumerate(units):
        if unit != 'A' and 0.0 < limits[i] < UNLIMITED:
            bounds[i] = min(bounds[i], BEYOND * limits[i])
    over = [i for i in range(len(units)) if largest[i] > bounds[i]]
    known = described_masses(case.arm, case.motion, effort)
    if not over:
        return [] if known is None else _by_masses(case, known)
    if known is None or units[over[0]] == 'A':
        # what is a thousandth of the largest is in the same unit as that
        all_of_them = len(over) > len(units) / 2
    else:
        all_of_them = len(known.believed) > 1 and float(np.median(known.believed)) > THOUSAND
    names = case.arm.active_joints
    chosen = tuple(names) if all_of_them else tuple(names[i] for i in over)
    most = max(over, key=lambda i: largest[i] / bounds[i])
    what = (f'effort of {", ".join(chosen)} reaches {largest[most]:.4g} where the description '
            f'says {units[most]}: it looks like m{units[most]}')
    return [_finding(case, chosen, what, 1000.0, 'largest effort', float(largest[most]),
                     float(largest[most]) / 1000.0)]


def _by_masses(case: Case, known: Described) -> list[Finding]:
    joints = case.arm.joints
    described = [i for i in range(len(joints)) if joints[i].effort.unit != 'A'
                 and known.share[i] > BELIEVED]
    if len(described) < 2:
        return []
    ratio = float(np.median(np.abs(known.ratio[described])))
    if 1.0 / FEW_TIMES < ratio < FEW_TIMES:
        return []
    thousand = not 1.0 / THOUSAND < ratio < THOUSAND
    size = 1000.0 if ratio > THOUSAND else 0.001 if thousand else ratio
    unit = joints[described[0]].effort.unit
    other = f'm{unit}' if size == 1000.0 else f'k{unit}' if size == 0.001 else 'currents in A'
    what = (f'all efforts are {ratio:.3g} times what the masses of the URDF need: they look like '
            f'{other}, not {unit}')
    return [_finding(case, case.arm.active_joints, what, size,
                     'measured effort over that of the masses', ratio, ratio / size)]


def _finding(
    case: Case, channels: tuple[str, ...], what: str, size: float, measure: str, now: float,
    otherwise: float,
) -> Finding:
    return Finding('effort_unit', what, 'correct joints[].effort.unit, or scale the efforts in '
                   'the driver', case.recording.path, channels, None, size, '', measure, now,
                   otherwise)
