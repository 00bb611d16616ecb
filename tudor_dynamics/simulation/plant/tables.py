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

"""Arrays of a plant, as compiled functions take them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant import integrator as gen


class PlantTables(NamedTuple):
    """
    State, matrices and working space of a plant, and the tables of its mechanism.

    The arrays are those that ``integrator.step`` takes; they are changed in place and are never
    others for the life of a plant.
    """

    vectors: NDArray
    matrices: NDArray
    settings: NDArray
    prescribed: NDArray
    torque: NDArray
    motion: NDArray
    base: NDArray
    wrench: NDArray
    columns: NDArray
    owner: NDArray
    inertias: NDArray
    moving: NDArray
    reaction: NDArray
    body_int: NDArray
    body_float: NDArray
    coordinate: NDArray


def new_tables(mechanism: Mechanism) -> PlantTables:
    """
    Make the tables of a plant that has no state yet.

    Parameters
    ----------
    mechanism : Mechanism
        Mechanism of the plant, whose tables are shared.

    """
    n, bodies = mechanism.size, len(mechanism.body_int)
    return PlantTables(
        vectors=np.zeros((gen.VECTORS, n)), matrices=np.zeros((gen.MATRICES, n, n)),
        settings=np.zeros(gen.SETTINGS), prescribed=np.zeros(n, dtype=bool),
        torque=np.zeros(n), motion=np.zeros((3, n)), base=-mechanism.gravity,
        wrench=np.zeros((mechanism.points, 6)), columns=np.zeros((n, 6)),
        owner=np.zeros(n, dtype=np.int64), inertias=np.zeros((bodies + 1, 10)),
        moving=np.zeros((bodies, at.MOVING)), reaction=np.zeros((bodies, 6)),
        body_int=mechanism.body_int, body_float=mechanism.body_float,
        coordinate=mechanism.coordinate)
