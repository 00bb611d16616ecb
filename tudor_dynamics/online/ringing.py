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

"""How a flexible tool rings beside the running robot, by what efforts show of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.models.flexible_tool import FlexibleTool, ToolModes
from tudor_dynamics.online.settings import RING_BANDWIDTH, RING_MEAN, RING_RENEWED, RING_RIDGE
from tudor_dynamics.typing import FloatArray


class RingObserver:
    """
    Follows the acceleration of a tool's modes, which turn and decay, and a mean beside each.

    The residual of efforts is the sum of their pulls, see ``models.flexible_tool``; projected on
    these it corrects the modes, complex numbers, as a Luenberger observer does.
    """

    def __init__(self, arm: Arm, tool: FlexibleTool) -> None:
        self.tool, self._arm = tool, arm
        self._data, self._q = arm.model.createData(), np.zeros(arm.model.nq)
        self._last = arm.model.njoints - 1
        self._small: ToolModes | None = None  # vibrations of a pose lately
        self._age = 0.0  # of these [s]
        self._modes: Any = np.zeros(len(tool.frequencies), complex)
        self._mean = np.zeros(len(tool.frequencies))
        self._rate = 1.0  # at which they decay [1/s]
        self.amplitude = np.zeros(len(arm.active_joints))  # of each effort [N m or N]

    def step(self, dt: float, q: FloatArray, residual: FloatArray) -> FloatArray:
        """Take the residual of efforts (joints,) into account; dt 0 begins. Give amplitudes."""
        model = self._arm.model
        self._q[self._arm.velocity_index] = q
        jacobian = pin.computeJointJacobian(model, self._data, self._q, self._last)
        self._age += dt
        if self._small is None or dt <= 0.0 or self._age > RING_RENEWED:
            self._small, self._age = self.tool.modes(
                self._data.oMi[self._last].rotation.T @ model.gravity.linear), 0.0
        modes = self._small
        levers = modes.pulls @ jacobian[:, self._arm.velocity_index]
        if dt <= 0.0:
            self._modes, self._mean = 0.0 * self._modes, 0.0 * self._mean
        self._modes = self._modes * np.exp(modes.poles * dt)
        self._rate = float(-modes.poles.real.max())
        # where efforts hardly tell the modes apart, neither has all of them
        square = levers @ levers.T
        square += RING_RIDGE * np.trace(square) * np.eye(len(square))
        error = np.linalg.solve(square, levers @ residual) - self._modes.real - self._mean
        # a real error corrects half of a complex number
        w = modes.poles.imag * dt
        self._modes += 2.0 * (1.0 - np.exp(-RING_BANDWIDTH * w)) * error
        self._mean += (1.0 - np.exp(-RING_MEAN * w)) * error
        self.amplitude = np.abs(self._modes) @ np.abs(levers)
        return self.amplitude

    def __str__(self) -> str:
        """Say what rings most, and how long until nobody hears it."""
        loudest = int(np.argmax(self.amplitude))
        size, name = float(self.amplitude[loudest]), self._arm.active_joints[loudest]
        if size <= self.tool.quiet:
            return 'quiet'
        left = math.log(size / self.tool.quiet) / max(self._rate, 1e-9)
        return (f'{size:.2g} {"N" if self._arm.is_prismatic(name) else "N m"} at {name}, quiet in '
                f'{left:.1f} s')
