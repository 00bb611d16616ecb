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

"""Errors of an analytical model on a part of the data, from what that part came to alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation.products import Products, squared_residuals
from tudor_dynamics.models.estimation.torque_constants import rescaled
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class PartErrors:
    """Errors on a part."""

    # (channels,): squared errors and squared outputs, summed, in the unit of the output squared.
    squares: FloatArray
    power: FloatArray
    n: FloatArray  # number of samples, (channels,)


def part_errors(model: AnalyticalModel, part: list[list[Products]]) -> PartErrors:
    """Judge a model by products."""
    found = np.zeros((3, len(model.channels)))
    for group, products in zip(model.groups_, part, strict=True):
        for i, (channel, own) in enumerate(zip(group.base.channels, products, strict=True)):
            scaled = own
            if group.constants is not None:
                scaled = rescaled(own, model.regressor.scaled[group.base.kept],
                                  group.constants.values[i])
            found[:, channel] = (squared_residuals(scaled, group.estimate.parameters),
                                 scaled.gram[-1, -1], own.n)
    return PartErrors(*found)
