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

"""Identified values in the user's URDF, and nothing else touched."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from robot_making import described_arm, fitted, JOINTS, motion_of, URDF
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.comparison import full_parameters_of
from tudor_dynamics.models.consistent import pseudo_inertia
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.show.description import link_inertias, urdf_of

N = len(JOINTS)


@pytest.fixture(scope='module')
def full(tmp_path_factory):
    arm = described_arm(tmp_path_factory.mktemp('arm'))
    return full_parameters_of(arm, fitted(arm))


def bodies_alone(full, motion):
    """Give what the bundle's own model says of bodies, in N m: without drives."""
    parameters = full.model.coefficients().copy()
    parameters[:, full.solution.bodies.size:] = 0.0
    return full.model.regressor.outputs(motion, parameters)


def rnea(model, motion):
    data, n = model.createData(), model.nv
    return np.array([pin.rnea(model, data, row[:n], row[n:2 * n], row[2 * n:])
                     for row in motion])


def test_inverse_dynamics_of_the_file_are_those_of_the_model(full):
    motion = motion_of(5.0, 3)
    found = rnea(pin.buildModelFromXML(urdf_of(full)), motion)
    assert np.allclose(found, bodies_alone(full, motion), rtol=0.0, atol=1e-9)


def test_nothing_else_is_touched(full):
    plain = re.compile(r'\s*<inertial>.*?</inertial>|\s*<dynamics [^>]*/>', re.DOTALL)
    before, after = plain.sub('', URDF), plain.sub('', urdf_of(full))
    assert before.replace('<link name="hand"/>', '<link name="hand"></link>') in (
        after, after.replace('<link name="hand"/>', '<link name="hand"></link>'))
    assert '<!-- heavy -->' in after
    assert 'mass value="5"' in urdf_of(full), 'the base does not move: its mass stays'


def test_friction_stands_in_the_joints(full):
    root = ElementTree.fromstring(urdf_of(full))
    for joint in root.iter('joint'):
        found = joint.findall('dynamics')
        if joint.get('type') == 'fixed':
            assert not found
            continue
        (dynamics,) = found
        terms = full.drives[joint.get('name')]
        assert float(dynamics.get('damping')) == pytest.approx(terms['viscous'], rel=1e-12)
        assert float(dynamics.get('friction')) == pytest.approx(terms['coulomb'], rel=1e-12)


def test_links_of_a_body_share_it_and_can_exist(full):
    found = link_inertias(full.arm, full.bodies)
    assert {*found} == {'column', 'upper', 'lower', 'hand', 'tool'}
    for name in ('column', 'upper', 'lower', 'tool'):
        pseudo = pseudo_inertia(np.asarray(found[name].toDynamicParameters()))
        assert np.linalg.eigvalsh(pseudo).min() > 0.0
    assert found['tool'].mass == pytest.approx(full.bodies['roll'][0], rel=1e-6)
    assert found['hand'].mass == pytest.approx(0.0, abs=1e-9), 'it had none, it gets none'


def test_an_arm_of_rows_gets_a_urdf(root):
    arm = load_arm(root / 'config' / 'ur10.yaml')
    n = len(arm.active_joints)
    random = np.random.default_rng(0)
    motion = random.uniform(-1.0, 1.0, (600, 3 * n))
    model = AnalyticalModel(EffortRegressor(arm), n)
    model.fit(motion, random.standard_normal((600, n)) + 20.0 * np.cos(motion[:, :n]))
    full = full_parameters_of(arm, model)
    read = pin.buildModelFromXML(urdf_of(full))
    assert list(read.names)[1:] == list(arm.active_joints)
    assert np.allclose(rnea(read, motion[:20]), bodies_alone(full, motion[:20]), atol=1e-9)


def test_rows_with_held_joints_get_one_in_which_these_are_rigid(root):
    arm = load_arm(root / 'config' / 'two_blade_arm.yaml').with_joints({'joint1': {'hold': 0.4}})
    motion = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 6))
    model = AnalyticalModel(EffortRegressor(arm), 2)
    model.fit(motion, np.random.default_rng(1).standard_normal((200, 2)))
    full = full_parameters_of(arm, model)
    text = urdf_of(full)
    assert 'joint1 is held at 0.4' in text
    read = pin.buildModelFromXML(text)
    assert list(read.names)[1:] == ['joint2', 'joint3']
    read.gravity.linear = np.array(arm.spec.gravity)
    constants = np.array([full.torque_constants[name] for name in arm.active_joints])
    assert np.allclose(rnea(read, motion[:20]), constants * bodies_alone(full, motion[:20]),
                       atol=1e-9)
