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
What a reading is worth: from the unit of an output to newton metres, and so to kilograms.

Strains of unknown gain and currents of unknown torque constants show a load in their own unit
only. Kilograms need torque constants, the gain of a gauge, or the masses of the description.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.typing import FloatArray

BELIEVED = 0.6
"""Part of an effort that the masses of the description explain before they are believed."""
MEASURED, PUBLISHED, GAUGE = 0.03, 0.10, 0.05
"""Relative standard deviations where nothing else is known: of measured torques, of published
torque constants (with the losses of the gear in them), of the gain of a gauge. Assumed."""
SLOW = 0.03
"""Part of a joint's usual speed over which the sign of its friction is taken to change."""


class Source(Enum):
    """Where kilograms come from."""

    PAYLOADS = 'a model of two known payloads'
    TORQUE = 'efforts that are torques or forces'
    CONSTANTS = 'the torque constants of the description'
    GAIN = 'the gains of the gauges in the description'
    MASSES = 'the masses of the description (an assumption)'
    ELASTIC = 'the elastic model and the masses of the description'
    NOTHING = 'nothing: no torque constants, gains, known payloads or masses'


@dataclass(frozen=True, eq=False)
class Scale:
    """What a row of a load is worth in an output."""

    # (channels,): unit of the channel per unit of `LoadRows.rows`; 0 where it is not known.
    factor: FloatArray
    relative: float  # relative standard deviation that all channels have in common
    source: Source  # where it comes from


@dataclass(frozen=True, eq=False)
class Described:
    """Efforts over those of the masses of the description."""

    # (joints,): unit of the effort per N m or N; 1 for a right description in N m.
    ratio: FloatArray
    share: FloatArray  # part of the effort, friction left out, that they explain, (joints,)
    # (joints,): mean square of the effort of these masses, friction left out, in its unit.
    size: FloatArray

    @property
    def believed(self) -> FloatArray:
        """Ratios of the joints whose efforts the masses explain."""
        return np.asarray(self.ratio[self.share > BELIEVED])


def friction_terms(speed: FloatArray, slow: float) -> FloatArray:
    """
    Give what a joint's friction may change by from one day to another.

    speed (samples,) [rad/s or m/s]; returns (samples, 3).
    """
    sharp = max(slow, SLOW * float(np.sqrt(np.mean(speed ** 2))), 1e-9)
    return np.column_stack([speed, np.tanh(speed / sharp), np.ones(len(speed))])


def described_masses(arm: Arm, motion: FloatArray, effort: FloatArray) -> Described | None:
    """
    Compare efforts with those of the masses of the description.

    effort (samples, joints) [its unit]; motion (samples, 3 joints): ``[q, dq, ddq]`` of the active
    joints [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns None where the description has no
    masses.
    """
    values = np.concatenate([inertia.toDynamicParameters()
                             for inertia in list(arm.model.inertias)[1:]])
    if not values.any():
        return None
    rows = EffortRegressor(arm)
    parameters = np.zeros((len(arm.active_joints), len(rows.columns)))
    parameters[:, :len(values)] = values
    torque = rows.outputs(motion, parameters)
    n = len(arm.joints)
    ratios, shares, sizes = np.zeros(n), np.zeros(n), np.zeros(n)
    for i, joint in enumerate(arm.joints):
        basis = np.linalg.qr(friction_terms(motion[:, n + i], joint.friction_velocity))[0]
        x, y = (column - basis @ (basis.T @ column) for column in (torque[:, i], effort[:, i]))
        both, size, whole = float(x @ y), float(x @ x), float(y @ y)
        sizes[i] = size / len(motion)
        if whole > 0.0 and size > 1e-6 * whole:
            ratios[i], shares[i] = both / size, both ** 2 / (size * whole)
    return Described(ratios, shares, sizes)


def find_scale(
    arm: Arm, output: str, motion: FloatArray, predicted: FloatArray,
) -> Scale:
    """
    Find out what the readings of an output are worth.

    predicted (samples, channels); motion (samples, 3 joints): ``[q, dq, ddq]`` of the active
    joints [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    """
    if output == 'strain':
        gains = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
        factor = np.array([gains.get(name, 0.0) for name in arm.gauge_names])
        return Scale(factor, GAUGE, Source.GAIN if factor.any() else Source.NOTHING)
    known = np.array([joint.effort.unit != 'A' or joint.effort.torque_constant is not None
                      for joint in arm.joints])
    masses = described_masses(arm, motion, predicted)
    if known.any():
        measured = all(joint.effort.unit != 'A' for joint in arm.joints if joint.effort.unit != 'A'
                       or joint.effort.torque_constant is not None)
        relative = MEASURED if measured else PUBLISHED
        if masses is not None:
            # how far the two tell different weights of the arm is how far either may be off
            told = known & (masses.share > BELIEVED)
            if told.any():
                off = np.average((masses.ratio[told] - 1.0) ** 2, weights=masses.size[told])
                relative = max(relative, min(math.sqrt(float(off)), 1.0))
        return Scale(known.astype(float), relative,
                     Source.TORQUE if measured else Source.CONSTANTS)
    if masses is not None and len(masses.believed):
        factor = np.where(masses.share > BELIEVED, masses.ratio, 0.0)
        return Scale(factor, PUBLISHED, Source.MASSES)
    return Scale(np.zeros(len(known)), 0.0, Source.NOTHING)
