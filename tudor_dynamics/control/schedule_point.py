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

"""What a schedule says at one payload and pose, and how that stands in a row of numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Mode:
    """A mode of the links, joints held."""

    frequency: float  # frequency of the undamped mode [Hz]
    damping: float  # damping ratio of the links alone
    # (joints,): what an acceleration of each joint drives it with; see `signals.shaped_profile`.
    drive: FloatArray
    # Its strain at the gauge of each damped joint, (damped,) [units of the gauges].
    strain: FloatArray


@dataclass(frozen=True, eq=False)
class Point:
    """A schedule at one payload and pose."""

    gain: FloatArray  # yielding speed per mean-free strain, (damped,) [rad/s per m/m]
    position_gain: float  # speed per position error [1/s]
    full_delay: float  # delay of the loop up to which these gains hold [s]
    reached: float  # damping ratio that they give; that asked for, or what the loop allows
    load: FloatArray  # strain of the arm at rest, (damped,) [units of the gauges]
    # Strain by the acceleration of each joint, links following, (damped, joints)
    # [unit per rad/s^2].
    inertia: FloatArray
    modes: tuple[Mode, ...]  # the first modes, ascending

    def row(self) -> FloatArray:
        """Give its values in the order of ``columns_of``."""
        return np.concatenate([
            self.gain, [self.position_gain, self.full_delay, self.reached], self.load,
            self.inertia.ravel(),
            *(np.concatenate([[m.frequency, m.damping], m.drive, m.strain]) for m in self.modes)])


def columns_of(joints: tuple[str, ...], damped: tuple[str, ...], modes: int) -> tuple[str, ...]:
    """Name the columns of a node."""
    return (*(f'gain({d})' for d in damped), 'position_gain', 'full_delay', 'reached',
            *(f'load({d})' for d in damped),
            *(f'inertia({d},{j})' for d in damped for j in joints),
            *(name for m in range(1, modes + 1) for name in (
                f'frequency({m})', f'damping({m})', *(f'drive({m},{j})' for j in joints),
                *(f'strain({m},{d})' for d in damped))))
