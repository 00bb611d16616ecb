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

"""Elastic gears with play, its edges rounded so that the torque is smooth, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

STIFF = 0  # of the gear [N m/rad]
PLAY = 1  # half of the backlash [rad]
ROUND = 2  # over which the edge of the play is rounded [rad]
TIGHT = 3  # damping where the teeth touch [N m s/rad]
LOOSE = 4  # damping inside the play [N m s/rad]
SPRING_FLOATS = 5


class Gears(NamedTuple):
    """Gears of the driven joints."""

    springs: NDArray  # stiffness, play and damping of each, (springs, SPRING_FLOATS)
    place: NDArray  # coordinate of each, (springs,)
    # Position and speed of the drives, (springs,).
    aim: NDArray
    aim_rate: NDArray


@compiled
def gear(row: NDArray, twist: float, rate: float) -> tuple[float, float, float]:
    """Give torque, stiffness and damping of a gear with play at a twist [N m, per rad(/s)]."""
    below, above = twist - row[PLAY], twist + row[PLAY]
    low = math.sqrt(below * below + row[ROUND] * row[ROUND])
    high = math.sqrt(above * above + row[ROUND] * row[ROUND])
    share = 1.0 + 0.5 * (below / low - above / high)
    damping = row[LOOSE] + (row[TIGHT] - row[LOOSE]) * share
    torque = row[STIFF] * (twist + 0.5 * (low - high)) + damping * rate
    return torque, row[STIFF] * share, damping
