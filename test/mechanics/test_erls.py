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

"""The simulator against the paper's own equations."""

from __future__ import annotations

from pathlib import Path

from mechanics.erls import RigidLinkSystem
import numpy as np
from papers.lshape import l_shape
import pytest
from sample_arms import put_into_state

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import modes


@pytest.fixture(scope='module')
def plant():
    """L-shaped mechanism with gravity, elbow mass and damping."""
    return Plant(build_mechanism(l_shape(2, paper=True)), 1e-3)


@pytest.mark.parametrize('corner', [False, True])
def test_accelerations_agree_to_first_order(plant, corner):
    """With the elastic amplitude the difference vanishes quadratically, one or two joints free."""
    mechanism, system = plant.mechanism, RigidLinkSystem(plant.mechanism)
    plant.drive('corner', 'torque' if corner else 'hold')
    generator = np.random.default_rng(1)
    shapes = modes(plant, 6, ('motor', 'corner')).shape
    shapes[:, mechanism.q_index] = 0.0
    place, rate = np.tensordot(generator.normal(size=(2, 6)), shapes, 1)
    q, dq = np.array([0.7, 0.3]), np.array([2.0, -1.5])
    if not corner:
        q[1] = dq[1] = 0.0
    held = np.array([False, not corner])
    torque = np.array([0.5, -0.2])
    errors = []
    for amplitude in (1e-4, 1e-5):
        z, dz = amplitude * place, 30.0 * amplitude * rate
        z[mechanism.q_index], dz[mechanism.q_index] = q, dq
        put_into_state(plant, 0.0, z, dz, torque)
        expected = plant.state.ddq.copy()
        u, h = system.from_links(z, q), 1e-6
        du = (system.from_links(z + h * dz, q + h * dq)
              - system.from_links(z - h * dz, q - h * dq)) / (2 * h)
        _, found = system.accelerations(q, dq, u, du, torque, held)
        errors.append(np.abs(found - expected)[0])
        scale = abs(expected[0])
    assert errors[1] < 1e-4 * scale
    assert errors[1] < 0.03 * errors[0]


def test_pinning_makes_the_mass_matrix_regular(plant):
    """The printed system is singular by the number of joints; pinned at the hub it is not."""
    system = RigidLinkSystem(plant.mechanism)
    terms = system.terms(np.array([0.7, 0.0]), np.zeros(2))
    share = system.share
    mass, jacobian = terms.mass, terms.jacobian[:, :1]
    whole = np.block([[share.T @ mass @ share, share.T @ mass @ jacobian],
                      [jacobian.T @ mass @ share, jacobian.T @ mass @ jacobian]])
    keep = np.concatenate([system.free, [system.size]])
    scale = np.diag(1.0 / np.sqrt(np.diag(whole)))
    values = np.linalg.eigvalsh(scale @ whole @ scale)
    pinned = np.linalg.eigvalsh((scale @ whole @ scale)[np.ix_(keep, keep)])
    assert values[0] < 1e-12
    assert pinned[0] > 1e-5


def test_rigid_motion_stores_no_elastic_energy(plant):
    """J^T K = 0, so the second block row has no stiffness."""
    system = RigidLinkSystem(plant.mechanism)
    terms = system.terms(np.array([0.4, 0.2]), np.zeros(2))
    product = terms.jacobian.T @ terms.stiffness
    assert np.abs(product).max() < 1e-9 * np.abs(terms.stiffness).max()


def test_other_mechanisms_are_refused():
    """The yardstick says what it cannot do."""
    content = {'name': 'a', 'kinematics': {'dh': [[0.5, 0.0, 0.0, 0.0]]},
               'joints': [{'name': 'j'}],
               'links': [{'joint': 'j', 'joint_stiffness': 10.0, 'flexible': {
                   'section': {'shape': 'tube', 'outer': 0.02, 'inner': 0.01},
                   'material': {'E': 7e10, 'nu': 0.3, 'rho': 2700}}}]}
    mechanism = build_mechanism(arm_from_dict(content, base=Path('.'), source='a'))
    with pytest.raises(SimulationError, match='meet at their ends'):
        RigidLinkSystem(mechanism)
