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
Standard errors that a motion will bring, by the filters and the estimator of a fit.

The planned motion goes through what a recording goes through: filters, decimation, regressor,
products. Only the outputs are missing, and the inverse of the information does not depend on them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation.estimators import expected
from tudor_dynamics.models.estimation.torque_constants import rescaled
from tudor_dynamics.models.training import Blocks, TrainingBlock
from tudor_dynamics.models.units import column_unit
from tudor_dynamics.signals.preprocessing import noise_gain, prepare, Stretch
from tudor_dynamics.signals.splines import states
from tudor_dynamics.typing import FloatArray

OUTPUTS = ('effort', 'strain')


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the outputs."""

    size: dict[str, FloatArray]  # for each output, standard deviation of each channel, in its unit
    # Whether that is what a fit leaves, behind its filters; otherwise that of single samples,
    # white.
    residual: bool = False


@dataclass(frozen=True)
class ExpectedError:
    """Standard error of one parameter."""

    output: str  # what the parameter predicts
    channels: tuple[str, ...]  # channels that share it
    column: str  # column of the regressor
    name: str  # what the base parameter stands for
    unit: str  # unit of the parameter, and so of its standard error
    value: float  # standard error; infinite where the motion does not show it


def played(trajectory: Trajectory, arm: Arm) -> Recording:
    """Give the recording of an arm that followed a trajectory exactly."""
    n, joints = trajectory.q.shape
    return Recording(
        'the planned motion', np.round(trajectory.t * 1e9).astype(np.int64), trajectory.q,
        states(trajectory)[:, joints:2 * joints], np.zeros((n, joints)),
        np.zeros((n, len(arm.gauges))) if arm.gauges else None, (slice(0, n),),
        float(np.median(np.diff(trajectory.t))))


def expected_errors(
    models: Mapping[str, AnalyticalModel], arm: Arm, trajectory: Trajectory,
    preprocessing: PreprocessingSpec, noise: Noise,
) -> list[ExpectedError]:
    """Say how well a motion will show the parameters of models."""
    stretches = prepare(played(trajectory, arm), preprocessing)
    gain = 1.0 if noise.residual else noise_gain(stretches[0], preprocessing)
    found = []
    for output, model in models.items():
        data = model.products(_blocks(stretches, output))
        for place, (base, products) in enumerate(zip(model.base_, data, strict=True)):
            names = tuple(model.channels[i] for i in base.channels)
            constants = model.groups_[place].constants if model.groups_ else None
            if constants is not None:
                scaled = model.regressor.scaled[base.kept]
                products = [rescaled(product, scaled, value) for product, value in zip(
                    products, constants.values, strict=True)]
            estimate = expected(products, (gain * noise.size[output][list(base.channels)]) ** 2)
            found += [ExpectedError(
                output, names, column := model.regressor.columns[kept], name,
                column_unit(arm, output, names, column), float(error))
                for kept, name, error in zip(
                    base.kept, base.names, estimate.standard_errors, strict=True)]
    return found


def _blocks(stretches: list[Stretch], output: str) -> Blocks:
    return lambda: [TrainingBlock(block.motion, getattr(block, output), block.decimation)
                    for stretch in stretches for block in stretch.blocks()]
