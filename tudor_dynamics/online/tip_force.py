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

"""What gauges of a resting arm read of a force at the tip."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.base import MemorylessModel, Model
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.contact_fronts import gauge_gain
from tudor_dynamics.online.settings import FORCE_CHANGE, POSE_CHANGE
from tudor_dynamics.typing import FloatArray

StaticReadings = tuple[FloatArray, FloatArray | None]
"""Readings (gauges,) of the weight of the arm, but for constants, in units of the gauges; those of
a unit force [1/N], None where only levers are known."""


class StaticStrain:
    """Readings of gauges of a resting arm."""

    def __init__(
        self, arm: Arm, model: Model | None = None,
        normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> None:
        self._normal = np.array(normal) / np.linalg.norm(normal)
        self._force = 0.0
        self._last: StaticReadings | None = None
        self._at = np.zeros(len(arm.active_joints))
        self._model = model if isinstance(model, MemorylessModel) else None
        self._driven: DrivenArm | None = None
        self._zero = np.zeros(len(arm.gauges))
        self.source = 'none'
        if self._model is not None:
            self.source = 'model'
            return
        self._gain = np.nan_to_num(gauge_gain(arm, model))
        values: dict[str, float] = (
            dict(model.values) if isinstance(model, ElasticModel)
            and model.coefficients_ is not None else {})
        try:
            self._driven = DrivenArm(arm)
            self._driven.set_parameters(values)
        except SimulationError:
            self._driven = None
            return
        self.source = 'elastic model' if values else 'description'

    def at(self, q: FloatArray, force: float = 0.0) -> StaticReadings:
        """Give the readings at a pose under a force [N], whose levers change as the arm bends."""
        force = max(force, FORCE_CHANGE)
        if (self._last is None or float(np.abs(q - self._at).max()) > POSE_CHANGE
                or abs(force - self._force) > FORCE_CHANGE):
            self._last, self._at, self._force = self._solve(q, force), q.copy(), force
        return self._last

    def _solve(self, q: FloatArray, force: float) -> StaticReadings:
        if self._model is not None:
            row = np.concatenate([q, np.zeros(2 * len(q))])[None]
            return np.asarray(self._model.predict(row)[0]), None
        if self._driven is None:
            return self._zero, None
        driven = self._driven
        try:
            free = driven.follow(q[None], np.zeros(1)).moment[0]
            driven.tables.chain.wrench[driven.mechanism.tip, :3] = force * self._normal
            driven.loaded = True
            pressed = driven.follow(q[None], np.zeros(1)).moment[0]
        except SimulationError:
            return self._zero, None
        finally:
            driven.tables.chain.wrench[:] = 0.0
            driven.loaded = False
        return free * self._gain, (pressed - free) * self._gain / force
