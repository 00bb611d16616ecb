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

"""The arm on a floor, its damper and the force controller in lock-step, on a simulated clock."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.control.force_control import ForceController, ForceSettings, Phase
from tudor_dynamics.control.motion_controller import MotionController
from tudor_dynamics.mechanics.closed_loop import ArmProcess
from tudor_dynamics.mechanics.hardware import Floor
from tudor_dynamics.online.contact_levers import StaticStrain
from tudor_dynamics.typing import FloatArray

RATE = 500.0
"""Of sensors and commands [Hz]."""
GAP = 0.015
"""Below the tip, where the floor is put [m]."""


class ForceRig:
    """
    Force control of the simulated arm, with the objects that its nodes hold.

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
    process, controller, static : ArmProcess, ForceController, StaticStrain
        The arm, and who gives its reference.
    alter : callable
        Changes readings of the gauges on their way.
    force : list of float
        Force of the floor at each sample so far [N].

    """

    def __init__(
        self, arm: Arm, stiffness: float, seed: int = 0,
        settings: ForceSettings = ForceSettings(),  # noqa: B008 (frozen)
    ) -> None:
        self.process = ArmProcess(arm, rate=RATE, seed=seed)
        self._damper = MotionController(arm)
        self.controller = ForceController(arm, settings)
        self.static = StaticStrain(arm)
        self._stiffness = stiffness
        self.alter: Callable[[FloatArray], FloatArray] = lambda strain: strain
        self.force: list[float] = []

    def run(self, seconds: float) -> FloatArray:
        """
        Let time pass.

        Parameters
        ----------
        seconds : float
            How much [s].

        Returns
        -------
        ndarray of shape (n_samples,)
            Forces of the floor meanwhile [N].

        """
        dt, begun = 1.0 / RATE, len(self.force)
        controller = self.controller
        for _ in range(round(seconds * RATE)):
            sample, now = self.process.step(), len(self.force) * dt
            step = dt if self.force else 0.0
            pose = sample.q if controller.pose is None else controller.pose
            readings = self.static.at(pose, controller.force)
            q, dq = controller.step(
                step, sample.q, self.alter(sample.strain) - readings.weight, readings.share)
            self._damper.reference.add(now, q, dq)
            command = self._damper.step(now, step, sample.q, sample.strain,
                                        np.ones(len(sample.strain), dtype=bool))
            if command is not None:
                self.process.command(command)
            self.force.append(float(sample.force[2]))
        return np.array(self.force[begun:])

    @property
    def held(self) -> bool:
        """Say whether the force is held: there is contact, and no approach or retreat."""
        return self.controller.phase is Phase.HOLD

    def press(self, wanted: float) -> None:
        """
        Give the controller another force.

        Parameters
        ----------
        wanted : float
            Force to press with [N].

        """
        self.controller.press(wanted)

    def approach(self, wanted: float) -> None:
        """
        Come to rest, put the floor below the tip, and press on it until it is held.

        Parameters
        ----------
        wanted : float
            Force to press with [N].

        """
        self.run(1.0)
        self.process.floor = Floor(float(self.process.tip()[2]) - GAP, self._stiffness)
        self.controller.press(wanted)
        self.run(3.0)
