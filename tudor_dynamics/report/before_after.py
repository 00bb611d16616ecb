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

"""What a description says of the bodies, beside what was identified, and what that is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.identification.fit import FitResult
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.consistent.comparing import (
    body_row, BodyRow, described_bodies, relative_errors)
from tudor_dynamics.models.consistent.full import (
    described_parameters_of, full_parameters_of, FullParameters)
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class JointErrors:
    """What bodies are worth for a joint, on motion that nothing was fitted to."""

    joint: str  # name of the joint
    # Relative error of its effort by bodies as described with the drives that suit them best, by
    # identified ones that can exist, and by base parameters [%].
    described: float
    identified: float
    free: float


@dataclass(frozen=True)
class IdentifiedBody:
    """A body before and after."""

    row: BodyRow  # as described, and as identified
    mass_error: float  # standard error of the identified mass [kg]
    shown: int  # of its ten parameters, those that the recordings fix


@dataclass(frozen=True)
class BeforeAfter:
    """A description and a fit side by side."""

    bodies: tuple[IdentifiedBody, ...]  # one for each joint
    joints: tuple[JointErrors, ...]
    assumed: bool  # whether torque is known up to a factor only, so that masses are not absolute


def before_after(result: FitResult) -> BeforeAfter | None:
    """Compare an arm as described with an arm as identified."""
    arm = result.arm
    fitted = next((item for item in result.fitted
                   if (item.output, item.kind) == ('effort', 'analytical')), None)
    before = described_bodies(arm)
    if fitted is None or not any(body[0] > 0.0 for body in before.values()):
        return None
    models = [fitted.model, *(model for model, _ in fitted.validation.cases)]
    if len(models) < 2 or not all(isinstance(model, AnalyticalModel) and model.data_
                                  and model.payload_range is None for model in models):
        return None
    errors = np.zeros((3, len(arm.active_joints)))
    for model, data in fitted.validation.cases:
        assert isinstance(model, AnalyticalModel)
        for kind, judged in enumerate((described_parameters_of(arm, model).model,
                                       full_parameters_of(arm, model).model, model)):
            errors[kind] += _squares(relative_errors(judged, data.stretches), len(models) - 1)
    assert isinstance(fitted.model, AnalyticalModel)
    full = full_parameters_of(arm, fitted.model)
    return BeforeAfter(
        tuple(_body(full, joint, before[joint], place)
              for place, joint in enumerate(full.bodies)),
        tuple(JointErrors(joint, *(100.0 * np.sqrt(errors[:, place])).tolist())
              for place, joint in enumerate(arm.active_joints)), full.assumed)


def _squares(errors: FloatArray, bags: int) -> FloatArray:
    """Give the part of a bag in the mean square; a joint that shows nothing in it has none."""
    return np.asarray(np.nan_to_num(errors) ** 2 / bags)


def _body(full: FullParameters, joint: str, before: FloatArray, place: int) -> IdentifiedBody:
    sources = full.sources()[10 * place:10 * (place + 1)]
    return IdentifiedBody(
        body_row(joint, (full.arm, full.arm), (before, full.bodies[joint])),
        float(full.solution.body_errors[place, 0]), sources.count('data'))
