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

"""The limits of an arm held against what was seen of it: positions, commands and their steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import drive_stop, DriveStop, hard_limits, Limits
from tudor_dynamics.typing import FloatArray

SLACK = 0.01
"""What a command may be late on its way [s]; its step may be larger by so much acceleration."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """What an arm is held against."""

    limits: Limits  # what nothing exceeds
    stop: DriveStop  # how a drive brakes that hears no commands

    @classmethod
    def of(cls, arm: Arm) -> Envelope:
        """Take it from a description."""
        return cls(hard_limits(arm), drive_stop(arm))

    def excursion(self, q: FloatArray) -> float:
        """Give how far positions of shape (n, n_joints) leave their limits, at most [rad]."""
        beyond = np.maximum(q - self.limits.upper, self.limits.lower - q)
        return float(np.max(beyond, initial=0.0))

    def speed(self, command: FloatArray) -> float:
        """Give the largest command of shape (n, n_joints) as a share of its limit."""
        return float(np.max(np.abs(command) / self.limits.velocity, initial=0.0))

    def steps(
        self, command: FloatArray, arrival: FloatArray, period: float,
        driven: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """
        Give the steps from command to command, and the steps that the acceleration allows.

        command, driven (n, joints) [rad/s], arrival (n,) [s], period [s]; returns (n - 1, joints)
        [rad/s].
        """
        between = np.diff(arrival)[:, np.newaxis]
        silent = between > self.stop.timeout
        lost = self.stop.acceleration * np.maximum(between - self.stop.timeout, 0.0)
        before = np.sign(command[:-1]) * np.maximum(np.abs(command[:-1]) - lost, 0.0)
        size = np.abs(command[1:] - before)
        if driven is not None:
            size = np.where(silent, np.minimum(size, np.abs(command[1:] - driven[1:])), size)
        time = np.where(silent, period, np.maximum(between, period)) + SLACK
        return size, self.limits.acceleration * time

    def step(self, command: FloatArray, arrival: FloatArray, period: float) -> float:
        """Give the largest step as a share of what the acceleration allows."""
        size, allowed = self.steps(command, arrival, period)
        return float(np.max(size / allowed, initial=0.0))
