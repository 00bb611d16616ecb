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

"""What a description says of itself: lengths, angles and gauges that no arm has."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm, arm_from_dict
from tudor_dynamics.arm.kinematics import unit_vector
from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.errors import ArmError
from tudor_dynamics.identification.finding import Finding

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
