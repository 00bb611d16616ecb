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

import cmath
import math

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.models.flexible_tool import angular_frequency, FlexibleTool
from tudor_dynamics.online.settings import RING_BANDWIDTH, RING_MEAN
from tudor_dynamics.typing import FloatArray


class RingObserver:
    """
    Follows the acceleration of a tool's mode, which turns and decays, and a mean beside it.

    The residual of efforts is J' p eta'', see ``models.flexible_tool``; projected on J' p it
    corrects the mode, a complex number, as a Luenberger observer does.
    """

    def __init__(self, arm: Arm, tool: FlexibleTool) -> None:
        self.tool, self._arm = tool, arm
        self._data, self._q = arm.model.createData(), np.zeros(arm.model.nq)
        self._last, self._own = arm.model.njoints - 1, np.array(tool.participation)
        self._squares = np.array(tool.squares)
        self._mode, self._mean = 0j, 0.0
        self._rate = 1.0  # at which it decays [1/s]
        self.amplitude = np.zeros(len(arm.active_joints))  # of each effort [N m or N]

    def step(self, dt: float, q: FloatArray, residual: FloatArray) -> FloatArray:
        """Take the residual of efforts (joints,) into account; dt 0 begins. Give amplitudes."""
        model, tool = self._arm.model, self.tool
        self._q[self._arm.velocity_index] = q
        jacobian = pin.computeJointJacobian(model, self._data, self._q, self._last)
        lever = self._own @ jacobian[:, self._arm.velocity_index]
        gravity = self._data.oMi[self._last].rotation.T @ model.gravity.linear
        w = float(angular_frequency(self._squares, gravity))
        self._rate = tool.damping * w
        if dt <= 0.0:
            self._mode, self._mean = 0j, 0.0
        self._mode *= cmath.exp(w * dt * complex(-tool.damping, math.sqrt(1 - tool.damping**2)))
        error = float(lever @ residual) / float(lever @ lever) - self._mode.real - self._mean
        # a real error corrects half of a complex number
        self._mode += 2.0 * (1.0 - math.exp(-RING_BANDWIDTH * w * dt)) * error
        self._mean += (1.0 - math.exp(-RING_MEAN * w * dt)) * error
        self.amplitude = np.abs(lever) * abs(self._mode)
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
