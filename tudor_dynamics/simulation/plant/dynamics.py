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

"""A mechanism's tables, and its equations of motion at a state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.simulation.mechanics.energy import energy, refresh
from tudor_dynamics.simulation.mechanics.equations import inverse_dynamics
from tudor_dynamics.simulation.mechanics.mass import mass_matrix
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.stiffness import stiffness_matrix
from tudor_dynamics.simulation.plant import integrator as gen
from tudor_dynamics.simulation.plant.state import Energy
from tudor_dynamics.simulation.plant.tables import new_tables
from tudor_dynamics.typing import FloatArray


class Dynamics:
    """
    State of a mechanism with its energy, its matrices and what a motion needs.

    Parameters
    ----------
    mechanism : Mechanism
        Tables, see ``build_mechanism``.

    Attributes
    ----------
    tables : PlantTables
        Arrays of the plant, for compiled functions that advance or look at it.
    loaded : bool
        Whether forces act from outside.

    """

    def __init__(self, mechanism: Mechanism) -> None:
        self.mechanism = mechanism
        self.tables = new_tables(mechanism)
        self.loaded = False

    def parameters_changed(self) -> None:
        """Take over changed tables of the mechanism: stiffness, damping, masses."""
        mechanism = self.mechanism
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         self.tables.matrices[gen.STIFFNESS], self.tables.matrices[gen.DAMPING])
        self.tables.chain.base[:] = -mechanism.gravity
        self.tables.settings[gen.FACTORED] = 0.0

    @property
    def coordinates(self) -> FloatArray:
        """All coordinates, joints and nodes; a view [rad, m]."""
        return self.tables.vectors[gen.Z]

    @property
    def rates(self) -> FloatArray:
        """Rates of all coordinates; a view."""
        return self.tables.vectors[gen.DZ]

    @property
    def stiffness(self) -> FloatArray:
        """Elastic stiffness matrix of the straight links; a view."""
        return self.tables.matrices[gen.STIFFNESS]

    @property
    def prescribed(self) -> NDArray[np.bool_]:
        """Which coordinates follow a given motion; a view."""
        return self.tables.prescribed

    def energy(self) -> Energy:
        """Give the energy of the present state [J]."""
        tables = self.tables
        z, dz = tables.vectors[gen.Z], tables.vectors[gen.DZ]
        refresh(z, dz, tables.vectors[gen.DDZ], tables.chain)
        return Energy(*energy(z, dz, self.mechanism.gravity, tables.chain))

    def mass_matrix(self) -> FloatArray:
        """Give the mass matrix over all coordinates at the present state."""
        z, chain = self.tables.vectors[gen.Z], self.tables.chain
        result = np.empty((z.size, z.size))
        refresh(z, z * 0.0, z * 0.0, chain)
        mass_matrix(z, chain, self.tables.composite, result)
        return result

    def imbalance(
        self, z: FloatArray, dz: FloatArray, ddz: FloatArray, *, elastic: bool = True,
    ) -> FloatArray:
        """
        Give the generalised force that a motion needs.

        Parameters
        ----------
        z, dz, ddz : ndarray of shape (n,)
            Coordinates and rates.
        elastic : bool
            Whether the stiffness counts.

        Returns
        -------
        ndarray of shape (n,)
            Joint efforts, and what is missing at elastic coordinates.

        """
        result = np.empty(self.mechanism.size)
        inverse_dynamics(z, dz, ddz, self.tables.chain, self.loaded, float(elastic), result)
        return result
