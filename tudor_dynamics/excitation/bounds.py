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

"""
What a motion has to keep to, as penalties with slopes, and how far it goes beyond.

Positions, speeds, accelerations and efforts are ratios to their limits; distances between links
fall short of a clearance. A penalty grows with the square of what is beyond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import effort_limits
from tudor_dynamics.arm.self_collision import SelfCollision
from tudor_dynamics.excitation.information import STEP
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.signals.excitation import JointRange
from tudor_dynamics.signals.motion_profile import MotionLimits
from tudor_dynamics.typing import FloatArray

CLEARANCE = 0.02
"""Distance that links are to keep from each other [m]."""
TOUCH = 0.005
"""Distance that is taken for a collision: motion is looked at sample by sample [m]."""
EFFORT = 0.8
"""Part of the largest effort that is planned: friction and tracking need the rest."""


@dataclass(frozen=True, eq=False)
class Efforts:
    """Efforts that a motion asks for, by what is known of the arm, and their limits."""

    regressor: EffortRegressor  # rows of the efforts
    parameters: FloatArray  # parameters of each channel, (joints, columns)
    # (joints,): largest planned effort [A, N m or N]; infinite where none is known.
    largest: FloatArray

    def ratio(self, motion: FloatArray) -> FloatArray:
        """
        Give efforts over their limits, shape (n_samples, n_joints).

        motion (samples, 3 joints): ``[q, dq, ddq]`` of the active joints.
        """
        return self.regressor.outputs(motion, self.parameters) / self.largest


def known_efforts(arm: Arm, parameters: FloatArray | None = None) -> Efforts | None:
    """
    Collect what is known of the efforts of an arm and of their limits.

    parameters (joints, columns); returns None where no limit, or nothing of the bodies, is known.
    """
    largest = EFFORT * effort_limits(arm)
    if parameters is None:
        if any(joint.effort.unit == 'A' and joint.effort.torque_constant is None
               for joint in arm.joints):
            return None
        inertias = list(arm.model.inertias)[1:]
        if not sum(float(inertia.mass) for inertia in inertias) > 0.0:
            return None
        regressor = EffortRegressor(arm)
        bodies = np.concatenate([inertia.toDynamicParameters() for inertia in inertias])
        parameters = np.zeros((len(arm.joints), len(regressor.columns)))
        parameters[:, :len(bodies)] = bodies
    if not np.isfinite(largest).any():
        return None
    return Efforts(EffortRegressor(arm), parameters, largest)


@dataclass(frozen=True, eq=False)
class Beyond:
    """How far a motion goes to its limits and beyond."""

    # (joints,): largest part of each limit; of the effort 0 where it is not known.
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    clearance: float  # least distance between links, where it is less than `CLEARANCE` [m]
    nearest: tuple[str, ...]  # links that come as near as that

    @property
    def excess(self) -> float:
        """Give what no joint can mend alone: efforts beyond their limits, links that touch."""
        return float(max(self.effort.max(initial=0.0) - 1.0, 0.0)
                     + max(TOUCH - self.clearance, 0.0) / CLEARANCE)


class Bounds:
    """All that a motion keeps to."""

    def __init__(
        self, bounds: JointRange, limits: MotionLimits, efforts: Efforts | None = None,
        links: SelfCollision | None = None,
    ) -> None:
        self.range, self.limits = bounds, limits
        self.efforts = efforts
        self.links = links if links is not None and links.pairs else None
        n = len(bounds.lower)
        self._centre = np.concatenate([0.5 * (bounds.lower + bounds.upper), np.zeros(2 * n)])
        self._size = np.concatenate([0.5 * (bounds.upper - bounds.lower), limits.velocity,
                                     limits.acceleration])

    def penalty(self, motion: FloatArray) -> tuple[float, FloatArray]:
        """
        Punish positions, speeds and accelerations beyond their limits.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        returns (samples, 3 joints).
        """
        ratio = (motion - self._centre) / self._size
        beyond = np.maximum(np.abs(ratio) - 1.0, 0.0)
        count = beyond.shape[0] * len(self.range.lower)
        cost = float(np.sum(beyond**2)) / count
        return cost, 2.0 / count * beyond * np.sign(ratio) / self._size

    def coupled_penalty(self, motion: FloatArray) -> tuple[float, FloatArray]:
        """
        Punish efforts beyond their limits, and links that come too near; as `penalty` does.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        returns (samples, 3 joints).
        """
        cost, slope = 0.0, np.zeros_like(motion)
        count = len(motion) * len(self.range.lower)
        if self.efforts is not None:
            here = self.efforts.ratio(motion)
            beyond = np.maximum(np.abs(here) - 1.0, 0.0)
            if beyond.any():
                cost += float(np.sum(beyond**2)) / count
                pull = 2.0 / count * beyond * np.sign(here)
                for k in range(motion.shape[1]):
                    moved = motion.copy()
                    moved[:, k] += STEP
                    slope[:, k] += np.sum(
                        pull * (self.efforts.ratio(moved) - here), axis=1) / STEP
        if self.links is not None:
            n = len(self.range.lower)
            for row, q in zip(slope, motion[:, :n], strict=True):
                near = self.links.near(q, 2.0 * CLEARANCE)
                missing = 2.0 - near.distance / CLEARANCE
                cost += float(np.sum(missing**2)) / count
                row[:n] -= 2.0 / (count * CLEARANCE) * missing @ near.slope
        return cost, slope

    def beyond(self, motion: FloatArray) -> Beyond:
        """
        Say how far a motion goes.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        parts = np.split(np.abs((motion - self._centre) / self._size).max(axis=0), 3)
        n = len(self.range.lower)
        effort = np.zeros(n) if self.efforts is None else np.abs(
            self.efforts.ratio(motion)).max(axis=0)
        clearance, nearest = CLEARANCE, tuple[str, ...]()
        if self.links is not None:
            for q in motion[:, :n]:
                near = self.links.near(q, clearance)
                if len(near.distance):
                    k = int(np.argmin(near.distance))
                    clearance, nearest = float(near.distance[k]), near.names[k]
        return Beyond(parts[0], parts[1], parts[2], effort, clearance, nearest)
