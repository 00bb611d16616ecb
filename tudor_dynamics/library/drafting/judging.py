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

"""
What units and places the numbers of a bag have, judged by the gravity of the arm.

A URDF says what the joints of the arm carry. Where the efforts follow that moment one to one they
are torques; where they do so at a tenth they are currents. What carries nothing says nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.open_values import OPEN
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.library.drafting.samples import SLOW, spread
from tudor_dynamics.typing import FloatArray

FOLLOWS = 0.5
"""Share of what friction leaves of an effort that gravity explains, to be evidence of its unit."""
TORQUES = (0.5, 2.0)
"""Effort over gravity moment where efforts are torques: masses of a URDF are often rough."""
CURRENTS = 0.005
"""Below `TORQUES` and above this, efforts are currents of drives with a gear [A/(N m)]."""
LARGEST_CURRENT = 100.0
"""Efforts beyond this are no currents of an arm [A]."""
PLAUSIBLE = (0.02, 1.5)
"""Largest effort over the limit of the URDF, where efforts are what the limit means."""
MICROSTRAIN, STRAIN = 5.0, 0.01
"""Ranges of readings above the first are um/m, below the second m/m; between, units of bridges."""
OUTERMOST = 1.5
"""A gauge sits behind the outermost joint whose moment leaves at most so many times the least."""
UNTOLD = 0.3
"""Variance of a reading that no gravity moment explains: then none of them tells its place."""


@dataclass(frozen=True)
class Judgement:
    """A value, and why."""

    value: str  # `?` where it could not be told
    reason: str  # evidence with its number


def effort_over_gravity(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int],
) -> dict[int, float]:
    """
    Give the slope of effort over gravity moment, of the joints that carry something.

    Friction (sign and size of the speed), an offset and the moment of inertia are taken out of
    both; a slope counts where gravity explains at least the share `FOLLOWS` of what is left.

    model: joints that are not recorded stand at zero.
    """
    data, nothing = model.createData(), np.zeros(model.nv)
    gravity, inertial, speed, measured = [], [], [], []
    for recording in recordings:
        assert recording.effort is not None
        some = spread(recording, model.nq, index)
        for q, dq, ddq in zip(some.q, some.dq, some.ddq, strict=True):
            still = np.array(pin.rnea(model, data, q, nothing, nothing))
            gravity.append(still[list(index)])
            inertial.append((pin.rnea(model, data, q, dq, ddq) - still)[list(index)])
        speed.append(some.dq[:, list(index)])
        measured.append(recording.effort[some.rows])
    moments, rest = np.array(gravity), np.array(inertial)
    dq, effort = np.vstack(speed), np.vstack(measured)
    largest = moments.std(axis=0).max(initial=0.0)
    found = {}
    for joint in range(len(index)):
        if not len(moments) or moments[:, joint].std() < max(0.02 * largest, 1e-6):
            continue
        others = np.column_stack([np.ones(len(dq)), np.tanh(dq[:, joint] / SLOW), dq[:, joint],
                                  rest[:, joint]])
        both = np.column_stack([moments[:, joint], effort[:, joint]])
        own, other = (both - others @ np.linalg.lstsq(others, both, rcond=None)[0]).T
        if (own @ other)**2 > FOLLOWS * (own @ own) * (other @ other) > 0.0:
            found[joint] = float((own @ other) / (own @ own))
    return found


def effort_unit(
    slopes: Mapping[int, float], peaks: Sequence[float], limits: Sequence[float], name: str,
    torque: str,
) -> Judgement:
    """Judge the unit of efforts; limits [N m or N]: 0 or infinite where it says nothing."""
    if slopes:
        slope = float(np.median([abs(value) for value in slopes.values()]))
        text = f'{slope:.3g} times the gravity moments of the URDF'
        if TORQUES[0] <= slope <= TORQUES[1] and 'current' not in name.lower():
            return Judgement(torque, text)
        if CURRENTS <= slope <= TORQUES[1]:
            return Judgement('A', f'{text}: currents')
        what = (f'{torque} in thousandths' if 500.0 <= slope <= 2000.0
                else f'neither A nor {torque}')
        return Judgement(OPEN, f'{text}: {what}? publish A or {torque}')
    if 'current' in name.lower():
        return Judgement('A', f'by the name {name}')
    if max(peaks, default=0.0) > LARGEST_CURRENT:
        return Judgement(torque, f'up to {max(peaks):.4g}, more than drives take in ampere')
    told = [peak / limit for peak, limit in zip(peaks, limits, strict=True)
            if 0.0 < limit < 1e6 and peak > 0.0]
    if told and PLAUSIBLE[0] <= min(told) and max(told) <= PLAUSIBLE[1]:
        return Judgement(torque, f'{min(told):.2g} to {max(told):.2g} of the limits of the URDF')
    if told:
        return Judgement(OPEN, f'between {min(told):.2g} and {max(told):.2g} of the limits of the '
                               f'URDF: A, or {torque}?')
    return Judgement(OPEN, f'A, or {torque}? No masses or limits of a URDF to judge by')


def strain_unit(low: float, high: float) -> Judgement:
    """Judge the unit of a gauge's readings by their size."""
    span = high - low
    if span > MICROSTRAIN:
        return Judgement('um/m', f'readings span {span:.3g}')
    if 0.0 < span < STRAIN:
        return Judgement('m/m', f'readings span {span:.3g}')
    return Judgement(OPEN, f'readings span {span:.3g}: mV/V, V, N m, um/m or m/m?')


def joint_before(
    model: pin.Model, recordings: Sequence[Recording], index: Sequence[int], gauge: int,
    names: Sequence[str], moving: Collection[str],
) -> Judgement:
    """
    Judge behind which joint a gauge sits: that whose moment its reading follows.

    The moment at a joint is linear in masses, centres and inertias behind it, whatever these are.
    Those of the joints before it can follow the same reading with what they have more; so the
    outermost joint counts that leaves hardly more than the best. A joint behind that one which
    never moved would carry the same, so that the two cannot be told apart.
    """
    data = model.createData()
    rows: list[FloatArray] = []
    readings: list[FloatArray] = []
    for recording in recordings:
        assert recording.strain is not None
        some = spread(recording, model.nq, index)
        rows += [pin.computeJointTorqueRegressor(model, data, q, dq, ddq)[list(index)]
                 for q, dq, ddq in zip(some.q, some.dq, some.ddq, strict=True)]
        readings.append(recording.strain[some.rows, gauge])
    columns, y = np.array(rows), np.concatenate(readings)
    y = y - y.mean()
    left = {}
    for joint in range(len(index)):
        if names[joint] not in moving:
            continue
        x = columns[:, joint]
        x = x - x.mean(axis=0)
        if np.abs(x).max() > 1e-9:
            error = y - x @ np.linalg.lstsq(x, y, rcond=1e-9)[0]
            left[joint] = float((error @ error) / (y @ y)) if y @ y > 0.0 else 1.0
    if not left or min(left.values()) > UNTOLD:
        return Judgement(OPEN, 'its reading follows the moment of no joint')
    chosen = max(joint for joint, share in left.items()
                 if share <= OUTERMOST * min(left.values()) + 0.01)
    text = (f'its reading follows the moment of {names[chosen]} '
            f'({100 * (1 - left[chosen]):.0f} % of its variance)')
    if names[chosen + 1:] and names[chosen + 1] not in moving:
        return Judgement(OPEN, f'{text}; or sits behind {names[chosen + 1]}, which never moved?')
    return Judgement(names[chosen], text)
