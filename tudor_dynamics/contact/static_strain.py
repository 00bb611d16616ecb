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

"""What gauges read of an arm's own weight at a pose, from its model or from its description."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.models.memoryless import MemorylessModel
from tudor_dynamics.typing import FloatArray


NEAR = 1e-3
"""Change of a joint below which readings of the weight are those of before [rad or m]."""
LEAST = 0.5
"""Change of the force, and least one, for which levers are looked at anew [N]."""


@dataclass(frozen=True, eq=False)
class StaticReadings:
    """What gauges of a resting arm read."""

    weight: FloatArray  # (gauges,): of its own weight, but for constants, in units of the gauges
    # (gauges,): of a unit force at the tip of the bent arm [1/N]; None where only levers tell.
    share: FloatArray | None


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
        self._gain = self._driven = None
        self._zero = np.zeros(len(arm.gauges))
        self.source = 'none'
        if self._model is not None:
            self.source = 'model'
            return
        values: dict[str, float] = {}
        if isinstance(model, FittedElastic) and model.coefficients_ is not None:
            self._gain = np.array([values[0] for values in model.coefficients_])
            values = dict(model.values)
        else:
            sensors = {sensor.gauge: sensor.gain for sensor in arm.spec.sensors}
            self._gain = np.array([sensors.get(name, 0.0) for name in arm.gauge_names])
        try:
            self._driven = DrivenArm(arm)
            self._driven.set_parameters(values)
        except SimulationError:
            self._driven = None
            return
        self.source = 'elastic model' if values else 'description'

    def at(self, q: FloatArray, force: float = 0.0) -> StaticReadings:
        """
        Give the readings at a pose; a force that bends the arm changes its levers.

        q (joints,) [rad or m], force [N].
        """
        force = max(force, LEAST)
        if (self._last is None or float(np.abs(q - self._at).max()) > NEAR
                or abs(force - self._force) > LEAST):
            self._last, self._at, self._force = self._solve(q, force), q.copy(), force
        return self._last

    def _solve(self, q: FloatArray, force: float) -> StaticReadings:
        if self._model is not None:
            row = np.concatenate([q, np.zeros(2 * len(q))])[None]
            return StaticReadings(np.asarray(self._model.predict(row)[0]), None)
        if self._driven is None or self._gain is None:
            return StaticReadings(self._zero, None)
        driven = self._driven
        try:
            free = driven.follow(q[None], np.zeros(1)).moment[0]
            driven.tables.chain.wrench[driven.mechanism.tip, :3] = force * self._normal
            driven.loaded = True
            pressed = driven.follow(q[None], np.zeros(1)).moment[0]
        except SimulationError:
            return StaticReadings(self._zero, None)
        finally:
            driven.tables.chain.wrench[:] = 0.0
            driven.loaded = False
        return StaticReadings(free * self._gain, (pressed - free) * self._gain / force)
