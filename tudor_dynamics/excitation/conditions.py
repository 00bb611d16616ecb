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

"""How well a motion excites the parameters of an arm: condition numbers before it is run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SignalError
from tudor_dynamics.models.base_parameters import base_sets
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.signals.motion_profile import Reference
from tudor_dynamics.typing import FloatArray

REPORT_RATE = 20.0
"""Rate at which the motion is looked at [Hz]."""


@dataclass(frozen=True)
class GroupCondition:
    """Conditioning of one group of outputs with common parameters."""

    channels: tuple[str, ...]  # joints or gauges
    condition: float  # condition number of the regressor with columns of unit length
    weakest: str  # parameter that the motion excites least in relation to the others
    parameters: int  # number of base parameters


@dataclass(frozen=True)
class ExcitationReport:
    """Conditioning of all outputs."""

    # Groups of joints; groups of gauges, empty where the arm has none.
    effort: tuple[GroupCondition, ...]
    strain: tuple[GroupCondition, ...]

    @property
    def worst(self) -> float:
        """Largest condition number of all."""
        return max(item.condition for item in (*self.effort, *self.strain))


def excitation_report(arm: Arm, reference: Reference, *, form: str = 'exact') -> ExcitationReport:
    """Judge a motion by the regressors of an arm."""
    every = max(int(round(1.0 / (REPORT_RATE * reference.dt))), 1)
    motion = reference.motion[::every]
    return ExcitationReport(
        _conditions(EffortRegressor(arm), motion, len(arm.active_joints)),
        _conditions(StrainRegressor(arm, form), motion, len(arm.active_joints))
        if arm.gauges else ())


def _conditions(
    regressor: EffortRegressor | StrainRegressor, motion: FloatArray, joints: int,
) -> tuple[GroupCondition, ...]:
    rows = regressor.rows(motion)
    result = []
    for group, base in zip(regressor.groups, base_sets(regressor, joints), strict=True):
        columns = rows[:, group, :].reshape(-1, rows.shape[2])[:, base.kept]
        length = np.linalg.norm(columns, axis=0)
        names = base.names
        if (length <= 0.0).any():
            weakest, condition = int(np.argmin(length)), np.inf
        else:
            _, values, vectors = np.linalg.svd(columns / length, full_matrices=False)
            condition = float(values[0] / values[-1]) if values[-1] > 0.0 else np.inf
            weakest = int(np.argmax(np.abs(vectors[-1])))
        channels = tuple(regressor.channels[i] for i in group)
        result.append(GroupCondition(channels, float(condition), names[weakest], len(names)))
    return tuple(result)


@dataclass(frozen=True)
class ChosenSeed:
    """A seed, the report of its motion, and the worst condition number of each seed tried."""

    seed: int  # seed with the best motion
    report: ExcitationReport  # condition numbers of its motion
    tried: dict[int, float]  # worst condition number of each seed tried


def best_seed(
    arm: Arm, make: Callable[[int], Reference], seeds: Sequence[int],
) -> ChosenSeed:
    """Choose the seed whose motion has the least worst condition number."""
    if not seeds:
        msg = 'no seed to try; give at least one'
        raise SignalError(msg)
    reports = {seed: excitation_report(arm, make(seed)) for seed in seeds}
    tried = {seed: report.worst for seed, report in reports.items()}
    best = min(seeds, key=lambda seed: tried[seed])
    return ChosenSeed(best, reports[best], tried)
