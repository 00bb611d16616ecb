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

"""What a kilogram at the tip adds to an output, sample by sample."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.base_parameters import random_inputs
from tudor_dynamics.models.payload import PayloadModel
from tudor_dynamics.payload.rows import LoadRows
from tudor_dynamics.payload.scale import find_scale, Source
from tudor_dynamics.typing import FloatArray

SAMPLES = 200
"""Random motion by which masses of the description are compared with torques."""


class LoadWorth:
    """Outputs per kilogram: reference [kg], typical (channels,)."""

    def __init__(self, arm: Arm, output: str, model: AnalyticalModel) -> None:
        self._factor: FloatArray | None = None
        if isinstance(model, PayloadModel):
            low, high = model.payload_range
            self.source, self.reference = Source.PAYLOADS, high - low
            full = model.coefficients()
            both: Any = model.regressor  # a PayloadRegressor: rows, and those for a kilogram
            self._regressor = both.plain
            count = len(both.plain.columns)
            self._parameters = np.zeros((len(full), count))
            self._parameters[:, both.carried] = full[:, count:]
            motion = random_inputs(both.plain, len(arm.joints), SAMPLES, 1)
            self.typical = both.plain.outputs(motion, self._parameters).std(axis=0)
            return
        rows = LoadRows(arm, output)
        motion = random_inputs(model.regressor, len(arm.joints), SAMPLES, 1)
        predicted = model.predict(motion)
        scale = find_scale(arm, output, motion, predicted)
        self.source = scale.source
        self._regressor, self._parameters = rows.regressor, rows.point_parameters
        self._factor = scale.factor
        self.typical = (rows.point(motion) * np.abs(scale.factor)).std(axis=0)
        most = int(np.argmax(self.typical))
        self.reference = float(predicted.std(axis=0)[most] /
                               max(float(self.typical[most]), 1e-300))

    def at(self, row: FloatArray) -> FloatArray:
        """
        Evaluate one sample.

        row (3 joints,): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns
        (channels,).
        """
        return self.along(row[None, :])[0]

    def along(self, motion: FloatArray) -> FloatArray:
        """
        Evaluate samples.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        returns (samples, channels).
        """
        found = self._regressor.outputs(motion, self._parameters)
        return found if self._factor is None else found * self._factor


def load_worth(arm: Arm, models: Mapping[str, Mapping[str, Model]]) -> dict[str, LoadWorth]:
    """Find the outputs of a bundle that tell kilograms."""
    found = {}
    for output, kinds in models.items():
        model = kinds.get('analytical')
        if isinstance(model, AnalyticalModel):
            worth = LoadWorth(arm, output, model)
            if worth.source is not Source.NOTHING:
                found[output] = worth
    return found
