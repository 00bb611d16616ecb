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

"""Arrays of a new plant."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant import integrator as gen
from tudor_dynamics.simulation.plant.integrator import PlantTables


def new_tables(mechanism: Mechanism) -> PlantTables:
    """Make the tables of a plant that has no state yet."""
    n = mechanism.size
    return PlantTables(
        vectors=np.zeros((gen.VECTORS, n)), matrices=np.zeros((gen.MATRICES, n, n)),
        settings=np.zeros(gen.SETTINGS), prescribed=np.zeros(n, dtype=bool),
        torque=np.zeros(n), motion=np.zeros((3, n)), chain=mechanism.chain(),
        composite=mechanism.composite())
