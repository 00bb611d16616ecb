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

"""Elastic models sample by sample, with or without an observer that measured strain corrects."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from tudor_dynamics.errors import ModelError, SimulationError
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.models.elastic.outputs import live_output
from tudor_dynamics.typing import FloatArray

OBSERVERS = ('off', 'ringing')
BANDWIDTH = 8.0
"""Rate at which the observer forgets what it does not know the cause of [1/s]."""


class LiveElastic:
    """
    Elastic models of one arm, sample by sample, on one simulated arm.

    What a push leaves behind, an oscillation that no joint's motion explains, stays in the state
    of a model that only follows the joints. The observer takes it over from measured strain: an
    extended Kalman filter, slow enough that a collision shows in the innovation first.

    bandwidth [1/s].
    """

    def __init__(
        self, models: Mapping[str, FittedElastic], observer: str = 'off',
        bandwidth: float = BANDWIDTH,
    ) -> None:
        if observer not in OBSERVERS:
            msg = f'observer {observer!r} is unknown; expected one of {list(OBSERVERS)}'
            raise ModelError(msg)
        if not models:
            msg = 'no elastic model was given'
            raise ModelError(msg)
        self.observer = observer
        self.observing = observer != 'off'
        self._outputs = {output: live_output(model) for output, model in models.items()}
        first = next(iter(models.values()))
        if any(model.values != first.values for model in models.values()):
            msg = 'the elastic models of effort and strain belong to different arms; fit again'
            raise ModelError(msg)
        self._n_joints = first.n_joints
        self._driven: DrivenArm = driven_arm(first.arm, first.values)
        self._gauges: FloatArray | None = None
        if observer != 'off':
            strain = models.get('strain')
            if strain is None or strain.coefficients_ is None or strain.noise_ is None:
                msg = ('the observer needs an elastic model of the strain, and the bundle has '
                       'none; fit it to bags with strain, or switch the observer off')
                raise ModelError(msg)
            self._gauges = np.array(strain.coefficients_)
            if np.any(self._gauges[:, 0] == 0.0):
                msg = 'a gauge of the elastic model has the gain 0; fit again'
                raise ModelError(msg)
            self._driven.start_observer(
                strain.noise_ / np.abs(self._gauges[:, 0]), bandwidth)
        self._moment: FloatArray | None = None
        self._strain: FloatArray | None = None
        self._since = 0.0
        self._lost = False

    def measure(self, strain: FloatArray) -> None:
        """
        Give the strain that was measured at the newest sample; it counts with the next step.

        strain (gauges,) [its unit]: NaN for a gauge that does not count.
        """
        self._strain = strain

    def step(
        self, dt: float, row: FloatArray, wanted: Collection[str] | None = None,
    ) -> dict[str, FloatArray] | None:
        """Go to the next sample and predict; see ``Live``."""
        step = np.array([0.0 if self._lost else dt])
        self._lost = False
        try:
            if self._gauges is not None:
                self._observe(float(step[0]))
            response = self._driven.follow(row[None, :self._n_joints], step)
        except SimulationError:
            self._lost = True
            return None
        self._moment = response.moment[0]
        return {output: outputs(response, row) for output, outputs in self._outputs.items()
                if wanted is None or output in wanted}

    def _observe(self, dt: float) -> None:
        """Correct the state behind the sample before by what was measured there."""
        assert self._gauges is not None
        strain, self._strain = self._strain, None
        if dt <= 0.0:
            self._driven.forget()
            self._since = 0.0
            return
        if strain is not None and self._moment is not None and self._since > 0.0:
            measured = (strain - self._gauges[:, 1]) / self._gauges[:, 0]
            if not self._driven.correct(measured - self._moment, self._since):
                msg = 'the elastic model cannot be linearised'
                raise SimulationError(msg)
            self._since = 0.0
        self._since += dt
