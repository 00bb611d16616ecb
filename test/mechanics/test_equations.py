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

"""Equations of motion against Lagrange's equations, by differences of the energies."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant

ARMS = ('l_shape', 'elastic_arm', 'anthropomorphic')


@pytest.fixture(scope='module', params=ARMS)
def plant(request, root):
    """Undamped plant of one of the example arms, bent and moving."""
    mechanism = build_mechanism(load_arm(root / 'config' / f'{request.param}.yaml'))
    beams = mechanism.body_int[:, at.FLEXIBLE] == 1
    mechanism.body_float[np.ix_(beams, [at.ALPHA, at.BETA])] = 0.0
    mechanism.coordinate[:, at.DAMPING] = 0.0
    mechanism.gravity[:] = 1.0, -2.0, -9.0
    return Plant(mechanism, 1e-4)


@pytest.fixture(scope='module')
def motion(plant):
    """Coordinates and rates far from rest, with large joint angles."""
    generator = np.random.default_rng(4)
    n = plant.mechanism.size
    z = 0.01 * generator.normal(size=n)
    z[plant.mechanism.q_index] = generator.normal(size=plant.mechanism.q_index.size)
    return z, generator.normal(size=n), generator.normal(size=n)


def energies(plant, z, dz):
    """Kinetic and potential energy at a state."""
    plant.coordinates[:], plant.rates[:] = z, dz
    found = plant.energy()
    return found.kinetic, found.elastic + found.gravity


def test_forces_are_those_of_lagrange(plant, motion):
    """The force of a motion is d/dt dT/d(dz) - dT/dz + dV/dz."""
    z, dz, ddz = motion
    force = plant.imbalance(z, dz, ddz)
    h = 1e-6

    def momentum(place, rate):
        plant.coordinates[:] = place
        return plant.mass_matrix() @ rate

    expected = (momentum(z + h * dz, dz + h * ddz) - momentum(z - h * dz, dz - h * ddz)) / (2 * h)
    for i in range(z.size):
        change = np.zeros_like(z)
        change[i] = h
        (t1, v1), (t0, v0) = energies(plant, z + change, dz), energies(plant, z - change, dz)
        expected[i] += (v1 - v0 - t1 + t0) / (2 * h)
    assert np.abs(force - expected).max() < 1e-9 * np.abs(force).max()


def test_mass_matrix_is_that_of_the_equations(plant, motion):
    """Composite bodies give the same matrix as unit accelerations, and the kinetic energy."""
    z, dz, _ = motion
    zero = np.zeros_like(z)
    weight = plant.imbalance(z, zero, zero, elastic=False)
    columns = [plant.imbalance(z, zero, row, elastic=False) - weight for row in np.eye(z.size)]
    plant.coordinates[:] = z
    matrix = plant.mass_matrix()
    assert np.abs(matrix - np.array(columns).T).max() < 1e-12 * np.abs(matrix).max()
    assert 0.5 * dz @ matrix @ dz == pytest.approx(energies(plant, z, dz)[0], rel=1e-12)


def test_stiffness_is_the_derivative_of_the_forces(plant, motion):
    """The matrix of the integrator is the tangent of the elastic forces."""
    z, _, _ = motion
    zero = np.zeros_like(z)
    plant.coordinates[:] = z
    tangent = plant.bent_stiffness()
    h = 1e-7
    found = np.array([
        plant.imbalance(z + h * row, zero, zero) - plant.imbalance(z - h * row, zero, zero)
        - plant.imbalance(z + h * row, zero, zero, elastic=False)
        + plant.imbalance(z - h * row, zero, zero, elastic=False)
        for row in np.eye(z.size)]).T / (2 * h)
    assert np.abs(found - tangent).max() < 1e-6 * np.abs(tangent).max()
