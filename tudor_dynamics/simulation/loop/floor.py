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

"""An elastic floor below the tip, with which the arm is in contact step by step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.point_load import point_motion
from tudor_dynamics.typing import FloatArray

HEIGHT, STIFFNESS, BODY, NODE, POINT = range(5)
FLOOR = 5


@dataclass(frozen=True)
class Floor:
    """An elastic floor below the tip, without friction."""

    height: float  # in the base frame [m]
    stiffness: float  # force per penetration [N/m]


def floor_row(floor: Floor | None, mechanism: Mechanism) -> FloatArray:
    """Lay a floor out for compiled code; floor: none presses nowhere; returns (FLOOR,)."""
    points = mechanism.body_int[:, at.POINT]
    body = int(np.flatnonzero(points <= mechanism.tip)[np.argmax(
        points[points <= mechanism.tip])])
    height, stiffness = (0.0, 0.0) if floor is None else (floor.height, floor.stiffness)
    return np.array([height, stiffness, body, mechanism.tip - points[body], mechanism.tip])


@compiled
def press(floor: NDArray, z: NDArray, dz: NDArray, chain: Chain, dt: float) -> bool:
    """Add the force of the floor to the wrench of the tip: floor (FLOOR,), z, dz (n,), dt [s]."""
    if floor[STIFFNESS] <= 0.0:
        return False
    place, velocity = point_motion(z, dz, chain, int(floor[BODY]), int(floor[NODE]))
    depth = floor[HEIGHT] - place[2] - dt * velocity[2]
    if depth <= 0.0:
        return False
    chain.wrench[int(floor[POINT]), 2] += floor[STIFFNESS] * depth
    return True
