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

"""Do positions and velocities make sense: units, signs, and whether anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.sources import Sources
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray

DEGREES = 180 / math.pi
WINDOW = 0.1
"""Over which displacement and integrated velocity are compared: longer than the lag of a velocity
filter in a driver, shorter than a movement [s]."""
MIN_DISPLACEMENT = 2e-3
"""Less than this within a window is no movement to compare by [rad or m]."""
MIN_WINDOWS = 5
UNIT_TOLERANCE = 0.2
MAX_SPREAD = 0.3
FAST = 10.0
"""Joints of arms seldom turn faster, but ten degrees a second are common [rad/s]."""
FASTEST = 60.0
"""No joint of an arm turns this fast, ten turns a second [rad/s]."""
STILL = {False: 1e-3, True: 1e-4}
"""A joint that moves less stands still, by prismatic or not [rad, m]; encoder noise is less."""


@dataclass(frozen=True)
class VelocityRatio:
    """Displacement over integrated velocity of a joint."""

    ratio: float  # median over windows with movement; 1 where position and velocity agree
    spread: float  # median relative deviation from it


def velocity_ratio(recording: Recording, joint: int) -> VelocityRatio | None:
    """
    Compare the position of a joint with its velocity.

    Returns None where the joint moves too little to tell.
    """
    assert recording.dq is not None
    width = max(1, round(WINDOW / recording.dt))
    moved, integrated = [], []
    for segment in recording.segments:
        q, dq, t = recording.q[segment, joint], recording.dq[segment, joint], recording.t[segment]
        if len(q) <= width:
            continue
        area = np.concatenate([[0.0], np.cumsum(np.diff(t) * (dq[1:] + dq[:-1]) / 2)])
        moved.append(q[width:] - q[:-width])
        integrated.append(area[width:] - area[:-width])
    if not moved:
        return None
    x, y = np.concatenate(moved), np.concatenate(integrated)
    significant = np.abs(y) > max(MIN_DISPLACEMENT, 0.2 * float(np.abs(y).max()))
    if significant.sum() < MIN_WINDOWS or np.abs(x).max() < MIN_DISPLACEMENT / DEGREES:
        return None
    ratios = x[significant] / y[significant]
    ratio = float(np.median(ratios))
    deviation = float(np.median(np.abs(ratios - ratio)))
    return VelocityRatio(ratio, deviation / abs(ratio) if ratio else math.inf)


def _is_about(value: float, expected: float) -> bool:
    return abs(value / expected - 1) < UNIT_TOLERANCE


@np.errstate(over='ignore', invalid='ignore')  # a damaged value may be as large as any double
def check_units(recording: Recording, plan: Sources, notes: Notes) -> None:
    """
    Refuse degrees, warn of velocities that do not go with the positions.

    Degrees beside rad/s show in the ratio of displacement and velocity. Degrees in both only show
    in their size: positions far outside the limits or beyond two turns, speeds that no arm has.
    """
    suspects = []
    for column, (name, slides, reach) in enumerate(
            zip(plan.joints, plan.prismatic, plan.reach, strict=True)):
        size = float(np.percentile(np.abs(recording.q[:, column]), 95))
        if not slides and reach is not None and size > reach:
            suspects.append(f'{name} goes to {size:.4g}, beyond {reach:.4g} rad')
        elif slides and reach is not None and size > reach:
            notes.add(f'{name} goes to {size:.4g} m, twice its limits or more; check the units')
        speed = _speed(recording, column)
        if not slides and speed > FASTEST:
            suspects.append(f'{name} turns at {speed:.4g} rad/s')
        elif not slides and speed > FAST:
            notes.add(f'{name} turns at {speed:.4g} rad/s, which is fast for an arm; make sure '
                      'that positions are in rad, not in degrees')
        if recording.dq is not None:
            suspects += _check_velocity(recording, column, name, slides, notes)
    if suspects:
        msg = (f'looks like degrees ({"; ".join(suspects[:4])}); JointState is '
               'in rad and rad/s: multiply by pi/180 and record again, or correct type and '
               'limits in the arm description if the joint really moves so')
        raise BagError(msg, place=recording.path)


def without_zero_velocities(recording: Recording, plan: Sources, notes: Notes) -> Recording:
    """Leave velocities out that are all zero for a joint that moves: nobody measures them."""
    if recording.dq is None:
        return recording
    zero = tuple(name for name, moves, column in zip(
        plan.joints, moving_joints(recording, plan.prismatic), recording.dq.T, strict=True)
        if moves and not column.any())
    if not zero:
        return recording
    notes.add(f'velocity of {", ".join(zero)} is zero throughout, though the joints move; '
              'velocities are not used')
    return replace(recording, dq=None,
                   oddities=replace(recording.oddities, zero_velocities=zero))


def _speed(recording: Recording, column: int) -> float:
    """Give the speed that is exceeded in a tenth of the moving time [rad/s or m/s]."""
    # Over windows, not samples: the steps of a coarse encoder at 1 kHz are no speed. A tenth, not
    # the maximum: angles that wrap at pi jump now and then.
    width = max(1, round(WINDOW / recording.dt))
    speeds = [np.abs(recording.q[part][width:, column] - recording.q[part][:-width, column])
              / (recording.t[part][width:] - recording.t[part][:-width])
              for part in recording.segments if part.stop - part.start > width]
    return float(np.percentile(np.concatenate(speeds), 90)) if speeds else 0.0


def _check_velocity(
    recording: Recording, column: int, name: str, slides: bool, notes: Notes,
) -> list[str]:
    found = velocity_ratio(recording, column)
    if found is None:
        return []
    ratio, unit = found.ratio, 'm' if slides else 'rad'
    if found.spread > MAX_SPREAD:
        notes.add(f'velocity of {name} does not follow its position; it is used as it is: check '
                  'the driver')
    elif not slides and _is_about(abs(ratio), DEGREES):
        return [f'position of {name} changes {ratio:.3g} times as fast as its velocity says']
    elif not slides and _is_about(abs(ratio), 1 / DEGREES):
        return [f'velocity of {name} is {1 / ratio:.3g} times the derivative of its position']
    elif _is_about(ratio, -1.0):
        notes.add(f'velocity of {name} has the opposite sign of the derivative of its position')
    elif not _is_about(ratio, 1.0):
        notes.add(f'velocity of {name} is {1 / ratio:.3g} times the derivative of its position; '
                  f'expected {unit}/s')
    return []


def moving_joints(recording: Recording, prismatic: Sequence[bool]) -> list[bool]:
    """Say which joints move."""
    low, high = np.percentile(recording.q, [1, 99], axis=0)
    spans: FloatArray = high - low
    return [bool(span > STILL[slides]) for span, slides in zip(spans, prismatic, strict=True)]
