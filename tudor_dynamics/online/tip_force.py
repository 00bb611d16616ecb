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

"""Force at the tip: what gauges of a resting arm read of it, and its control in closed loop."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.control.motion_controller import MotionController
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.closed_loop import Sample
from tudor_dynamics.mechanics.hardware import Floor
from tudor_dynamics.mechanics.rig import Loop
from tudor_dynamics.models.base import MemorylessModel, Model
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.online.contact_fronts import gauge_gain
from tudor_dynamics.online.settings import FORCE_CHANGE, POSE_CHANGE
from tudor_dynamics.typing import FloatArray

RATE = 500.0  # of sensors and commands [Hz]
GAP = 0.015  # below the tip, where the floor is put [m]


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


class ForceRig(Loop):
    """
    The arm on a floor, its damper and the force controller in lock-step, on a simulated clock.

    They are the objects that the nodes hold.

    Parameters
    ----------
    arm : Arm
        Description with everything.
    stiffness : float
        Of the floor [N/m].
    seed : int
        Of the noise.
    settings : ForceSettings, optional
        Gains and bounds.

    Attributes
    ----------
    controller, static : ForceController, StaticStrain
        What gives the reference of the arm.

    """

    def __init__(
        self, arm: Arm, stiffness: float, seed: int = 0,
        settings: ForceSettings = ForceSettings(),  # noqa: B008 (frozen)
    ) -> None:
        super().__init__(arm, self._follow, rate=RATE, seed=seed)
        self._damper = MotionController(arm)
        self.controller = ForceController(arm, settings)
        self.static = StaticStrain(arm)
        self._stiffness = stiffness

    @property
    def force(self) -> FloatArray:
        """Force of the floor at each sample so far [N]."""
        return self.trace.array('force')[:, 2]

    def _follow(self, sample: Sample) -> FloatArray | None:
        step = 1.0 / RATE if sample.t > 0.0 else 0.0
        pose = sample.q if self.controller.pose is None else self.controller.pose
        weight, share = self.static.at(pose, self.controller.force)
        q, dq = self.controller.step(step, sample.q, sample.strain - weight, share)
        self._damper.reference.add(sample.t, q, dq)
        return self._damper.step(sample.t, step, sample.q, sample.strain,
                                 np.ones(len(sample.strain), dtype=bool))

    @property
    def held(self) -> bool:
        """Say whether the force is held: there is contact, and no approach or retreat."""
        return self.controller.phase is Phase.HOLD

    def press(self, wanted: float) -> None:
        """Give the controller another force to press with [N]."""
        self.controller.press(wanted)

    def approach(self, wanted: float) -> None:
        """Come to rest, put the floor below the tip, and press with a force [N] until held."""
        self.run(1.0)
        self.process.floor = Floor(float(self.process.tip()[2]) - GAP, self._stiffness)
        self.controller.press(wanted)
        self.run(3.0)
