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

"""What a plan promised of the parameters, beside what a fit reached."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import UsageError
from tudor_dynamics.excitation.expected import expected_errors, Noise, played
from tudor_dynamics.excitation.plan_files import PlanFolder
from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

WITHIN = 0.3
"""Relative difference up to which a promise counts as kept."""


@dataclass(frozen=True)
class Promise:
    """One parameter."""

    output: str  # what it predicts
    channels: tuple[str, ...]  # channels that share it
    # The base parameter and its unit.
    name: str
    unit: str
    # Standard error by the planned motion and the stated noise, for as many samples.
    expected: float
    by_noise: float  # the same by the noise that the fit left, in place of the stated one
    reached: float  # standard error of the fit


@dataclass(frozen=True)
class Comparison:
    """A plan and a fit."""

    promises: tuple[Promise, ...]  # all parameters that both know
    runs: float  # length of the training bags over that of the plan, in samples that are used
    stated: bool  # whether anybody stated the noise of the plan

    def ratios(self) -> dict[str, float]:
        """Give medians of what was reached over what was promised, and the part within 30 %."""
        def of(key: str) -> FloatArray:
            return np.array([item.reached / getattr(item, key) for item in self.promises
                             if np.isfinite(item.reached) and np.isfinite(item.expected)])
        both = {'expected': of('expected'), 'by_noise': of('by_noise')}
        return {name: float(value) for key, values in both.items() if len(values)
                for name, value in ((f'median_over_{key}', np.median(values)),
                                    (f'within_30_percent_of_{key}', np.mean(
                                        np.abs(values - 1.0) <= WITHIN)))}

    def content(self) -> dict[str, object]:
        """Give it as plain values for JSON."""
        return {'runs': self.runs, 'noise_stated': self.stated, **self.ratios(),
                'parameters': [asdict(item) for item in self.promises]}


def compare_with_plan(result: FitResult, plan: PlanFolder) -> Comparison:
    """Put a fit beside the plan of its recordings."""
    arm = result.arm
    trajectory = _ordered(plan, arm)
    models = {item.output: item.model for item in result.fitted
              if isinstance(item.model, AnalyticalModel) and item.model.payload_range is None
              and len(plan.noise.size.get(item.output, ())) == len(item.model.channels)}
    if not models:
        raise UsageError('no analytical model for one payload was fitted that a plan could be '
                         'compared with', place=plan.path, remedy='leave out --plan')
    planned = sum(stretch.n_kept for stretch in prepare(
        played(trajectory, arm), result.preprocessing))
    runs = sum(facts.used for facts in result.learned) / planned
    found = {}
    for output, model in models.items():
        found[output] = np.zeros(len(model.channels))
        for group in model.groups_:
            found[output][list(group.base.channels)] = np.sqrt(group.estimate.variances)
    promised, honest = (expected_errors(models, arm, trajectory, result.preprocessing, noise)
                        for noise in (plan.noise, Noise(found, residual=True)))
    reached = [error for model in models.values() for group in model.groups_
               for error in group.estimate.standard_errors.tolist()]
    return Comparison(tuple(
        Promise(one.output, one.channels, one.name, one.unit, one.value / float(np.sqrt(runs)),
                other.value / float(np.sqrt(runs)), error)
        for one, other, error in zip(promised, honest, reached, strict=True)), runs, plan.stated)


def _ordered(plan: PlanFolder, arm: Arm) -> Trajectory:
    names = plan.trajectory.joints
    if sorted(names) != sorted(arm.active_joints):
        msg = f'the plan moves {", ".join(names)}; {arm.name} has {", ".join(arm.active_joints)}'
        raise UsageError(msg, place=plan.path, remedy='give the plan of this arm')
    return plan.trajectory.of(arm.active_joints)
