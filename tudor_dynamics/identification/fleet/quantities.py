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
What arms are compared by: friction, gravity, ring-downs; numbers with honest standard errors.

Single base parameters trade off against each other (Coulomb against viscous friction, a mass
against another one), differently in every motion. So arms are compared by what parameters come to
together: the friction at a usual speed, what weight makes of an output over usual poses. Both are
linear in the parameters. Residuals are coloured, and the standard errors of least squares too
small; those here are of the jackknife over parts of the recordings (Kuensch, 1989).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import all_stretches, BagData
from tudor_dynamics.identification.elastic.ringdowns import clear_ring, standstills
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.elastic.fitted import PhysicalParameter
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.models.units import output_units
from tudor_dynamics.typing import FloatArray

POSES = 500
"""Poses at which weight is looked at."""
SLOW = 0.1
"""Of its largest speed, below which a joint counts as at rest."""
FEWEST_PARTS = 4
"""Parts of the data for a standard error."""
FEWEST_RINGS = 3
"""Ring-downs for one."""
WEIGHTLESS = 0.02
"""Of what an output measures, below which weight is nothing to compare by."""


@dataclass(frozen=True, eq=False)
class Measure:
    """Something that is linear in the parameters of a model."""

    # What it is, of which joint or gauge.
    name: str
    channel: str
    unit: str  # unit of its values
    weights: FloatArray  # of each coefficient, (channels, columns)

    def of(self, model: AnalyticalModel) -> float:
        """Give its value for a model."""
        return float(np.sum(self.weights * model.coefficients()))


@dataclass(frozen=True)
class Quantity:
    """A number of one arm at one date."""

    # What it is, of which joint or gauge.
    name: str
    channel: str
    unit: str  # unit of its value
    # Value and its standard error.
    value: float
    error: float


def measures(
    arm: Arm, output: str, model: AnalyticalModel, bags: Sequence[BagData],
) -> list[Measure]:
    """Say what is compared of an output."""
    units = output_units(arm, output)
    q, dq = (np.vstack([getattr(s.states, name)[s.decimation.keep] for s in all_stretches(bags)])
             for name in ('q', 'dq'))
    poses = q[::max(1, len(q) // POSES)]
    still = np.zeros_like(poses)
    rest = model.regressor.rows(np.hstack([poses, still, still]))
    rest = rest - rest.mean(axis=0)  # zeros of gauges and drives are no weight
    weight = np.einsum('kcp,cp->kc', rest, model.coefficients())
    size = np.sqrt(np.mean(weight**2, axis=0))
    measured = np.vstack([s.decimation(getattr(s, output)) for s in all_stretches(bags)])
    found = []
    if output == 'effort':
        found = [_friction(arm, model, j, q.mean(axis=0), dq[:, j], units) for j in range(
            len(arm.joints)) if np.any(dq[:, j])]
    for i, channel in enumerate(model.channels):
        if size[i] > WEIGHTLESS * measured[:, i].std():
            weights = np.zeros(rest.shape[1:])
            weights[i] = weight[:, i] @ rest[:, i] / (size[i] * len(poses))
            found.append(Measure('weight', channel, units[channel], weights))
    return found


def _friction(
    arm: Arm, model: AnalyticalModel, joint: int, q: FloatArray, speed: FloatArray,
    units: Mapping[str, str],
) -> Measure:
    """Take half of the difference between both ways: nothing but friction is odd in the speed."""
    usual = float(np.median(np.abs(speed)[np.abs(speed) > SLOW * np.abs(speed).max()]))
    motion = np.zeros((2, 3 * len(arm.joints)))
    motion[:, :len(q)] = q
    motion[:, len(q) + joint] = usual, -usual
    rows = model.regressor.rows(motion)
    weights = np.zeros(rows.shape[1:])
    weights[joint] = 0.5 * (rows[0, joint] - rows[1, joint])
    name = model.channels[joint]
    unit = 'm/s' if arm.is_prismatic(name) else 'rad/s'
    return Measure(f'friction at {usual:.2g} {unit}', name, units[name], weights)


def quantities(
    some: Sequence[Measure], model: AnalyticalModel, others: Sequence[AnalyticalModel],
) -> list[Quantity]:
    """
    Give the numbers of an arm at a date.

    Returns None without enough parts for standard errors.
    """
    n = len(others)
    if n < FEWEST_PARTS:
        return []
    found = []
    for item in some:
        values = np.array([item.of(other) for other in others])
        error = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
        found.append(Quantity(item.name, item.channel, item.unit, item.of(model), error))
    return found


def rings(arm: Arm, bag: BagData) -> list[tuple[str, float, float]]:
    """
    Find oscillations that die out while the joints stand still.

    Returns gauge, frequency [Hz].
    """
    found = []
    for stretch in bag.stretches:
        for part in standstills(stretch) if stretch.strain is not None else ():
            assert stretch.strain is not None
            for name, column in zip(arm.gauge_names, stretch.strain[part].T, strict=True):
                mode = clear_ring(column, bag.recording.dt)[1]
                if mode is not None:
                    found.append((name, mode.frequency, mode.damping))
    return found


def ring_quantities(found: Sequence[tuple[str, float, float]]) -> list[Quantity]:
    """Sum up the ring-downs of an arm at a date."""
    told = []
    for gauge in dict.fromkeys(name for name, _, _ in found):
        values = np.array([item[1:] for item in found if item[0] == gauge])
        if len(values) < FEWEST_RINGS:
            continue
        middle = np.median(values, axis=0)
        spread = 1.4826 * np.median(np.abs(values - middle), axis=0)
        errors = 1.2533 * np.maximum(spread, 1e-6 * middle) / np.sqrt(len(values))
        told += [Quantity(name, gauge, unit, float(value), float(error)) for name, unit, value,
                 error in zip(('ring-down frequency', 'ring-down damping'), ('Hz', ''), middle,
                              errors, strict=True)]
    return told


def stiffness_quantities(found: Sequence[PhysicalParameter]) -> list[Quantity]:
    """Take the stiffnesses of gears and links that the recordings have told."""
    told = []
    for item in found:
        if item.shown and kind_of(item.name).adds < 0:
            part, _, joint = item.name.rstrip(')').partition('(')
            told.append(Quantity(f'stiffness: {part}', joint, item.unit, item.value,
                                 item.standard_error))
    return told
