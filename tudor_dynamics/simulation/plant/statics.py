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

"""Static equilibrium of a mechanism, and whether a step can follow its links."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.stiffness import add_stretch
from tudor_dynamics.typing import FloatArray

Imbalance = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


def find_equilibrium(
    mechanism: Mechanism, z: FloatArray, stiffness: FloatArray, imbalance: Imbalance,
) -> None:
    """
    Bend the links as they rest under weight and forces, joints where they are.

    Newton with the elastic tangent stiffness, which gravity hardly changes.

    z (n,) [rad, m], stiffness (n, n).
    """
    elastic = mechanism.elastic
    if not elastic.any():
        return
    pick = np.ix_(elastic, elastic)
    zero = np.zeros_like(z)
    for _ in range(100):
        tangent = np.tril(stiffness)
        add_stretch(z, mechanism.body_int, mechanism.body_float, 1.0, 0.0, tangent)
        tangent = tangent + np.tril(tangent, -1).T
        missing = imbalance(z, zero, zero)[elastic]
        change = np.linalg.solve(tangent[pick], missing)
        # Shorter first steps where a beam bends far: the normal force overshoots.
        largest = float(np.abs(change).max())
        if not np.isfinite(largest) or np.abs(z[elastic]).max() > 1e3:
            break
        z[elastic] -= change * min(1.0, 0.2 / max(largest, 1e-300))
        if largest < 1e-11:
            return
    msg = (f'{mechanism.name}: no static equilibrium was found, the links are too weak for their '
           'weight; check sections and material, or set simulation.start: undeformed')
    raise SimulationError(msg)


def check_step(
    mechanism: Mechanism, stiffness: FloatArray, mass: FloatArray, dt: float,
) -> None:
    """
    Refuse a step that cannot follow the slowest vibration of the links, joints held.

    stiffness, mass (n, n), dt [s].
    """
    free = np.flatnonzero(mechanism.elastic)
    if free.size == 0:
        return
    pick = np.ix_(free, free)
    flexibility = np.linalg.solve(stiffness[pick], mass[pick])
    slowest = 1.0 / np.sqrt(np.abs(np.linalg.eigvals(flexibility)).max()) / (2.0 * np.pi)
    # Links so stiff that 2 ms do not follow them are meant as rigid: they stay damped.
    if dt * slowest > 1.0 / 8.0 and dt > 2e-3:
        msg = (f'{mechanism.name}: a step of {dt:g} s is too large, the slowest '
               f'vibration of the links has {slowest:.3g} Hz; take at most '
               f'{1.0 / (8.0 * slowest):.2g} s, better {1.0 / (100.0 * slowest):.1g} s')
        raise SimulationError(msg)
