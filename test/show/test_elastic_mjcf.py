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

"""Elastic arms in MuJoCo: the same statics, the same vibrations, the same motion."""

from __future__ import annotations

import math

from elastic_making import blade, blade_arm, GAINS, identified, OFFSETS
import numpy as np
import pytest
from sample_arms import arm_of, gauge
from scipy.linalg import eigh
import tudor_dynamics as td
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.files import load_yaml
from tudor_dynamics.models.bundle import elastic_of
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.show.description import description_of, elastic_drives
from tudor_dynamics.show.mjcf import ElasticFile, not_in_mjcf

mujoco = pytest.importorskip('mujoco')

VALUES = {'bending(j1)': 15.0, 'density(j2)': 0.5, 'lumped(j1,1)': 0.7, 'payload': 0.25,
          'gear(j1)': 190.0, 'play(j1)': 0.0, 'play(j2)': 0.0, 'tight(j1)': 0.3, 'beta': 8e-4}
DRIVE = {'torque': 0.25, 'Ia': 0.1, 'viscous': 0.2, 'coulomb': 0.0, 'offset': 0.0}
EFFORT = {'j1': DRIVE, 'j2': {**DRIVE, 'torque': 0.5}}
POSES = ([0.3, 0.4], [1.2, -0.8], [0.0, 0.0], [2.5, 0.9])


class Rest:
    """An elastic arm in MuJoCo whose drives stand still."""

    def __init__(self, xml, drives):
        self.model = mujoco.MjModel.from_xml_string(xml)
        self.data = mujoco.MjData(self.model)
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        self.drives = [names.index(name) for name in drives]
        self.free = [i for i in range(self.model.nv) if i not in self.drives]
        self.model.dof_frictionloss[:] = 0.0

    def force(self, z, ddz=0.0):
        """Give what the springs lack at a place, and what its acceleration needs."""
        self.data.qpos[self.free] = z
        self.data.qvel[:], self.data.qacc[:] = 0.0, 0.0
        self.data.qacc[self.free] = ddz
        mujoco.mj_inverse(self.model, self.data)
        applied = np.zeros(self.model.nv)
        for body in np.flatnonzero(np.any(self.data.xfrc_applied, axis=1)):
            load = self.data.xfrc_applied[body]
            mujoco.mj_applyFT(self.model, self.data, load[:3, None], load[3:, None],
                              self.data.xipos[body][:, None], int(body), applied)
        return (self.data.qfrc_inverse - applied)[self.free]

    def tangent(self, z):
        """Differentiate `force`."""
        steps = 1e-6 * np.eye(len(z))
        return np.array([(self.force(z + s) - self.force(z - s)) / 2e-6 for s in steps]).T

    def settle(self, q):
        """Find the equilibrium."""
        self.data.qpos[self.drives] = q
        z = np.zeros(len(self.free))
        for _ in range(8):
            z = z - np.linalg.solve(self.tangent(z), self.force(z))
        assert np.abs(self.force(z)).max() < 1e-9
        return z

    def frequencies(self, q):
        """Undamped frequencies about the equilibrium [Hz]."""
        z = self.settle(q)
        mass = np.array([self.force(z, unit) - self.force(z) for unit in np.eye(len(z))])
        return hertz(self.tangent(z), mass)

    def moments(self, q):
        """Give what the sensors of the gauges show at rest [N m]."""
        self.force(self.settle(q))
        mujoco.mj_rnePostConstraint(self.model, self.data)
        mujoco.mj_sensorAcc(self.model, self.data)
        return self.data.sensordata.reshape(-1, 3)[:, 2].copy()


def hertz(stiffness, mass):
    return np.sqrt(eigh(0.5 * (stiffness + stiffness.T), mass, eigvals_only=True)) / (2 * np.pi)


def exported(arm, values=VALUES, effort=EFFORT):
    bundle = identified(arm, values, effort)
    model = elastic_of(bundle, 'strain')
    return bundle, driven_arm(arm, model.values), ElasticFile(
        model, elastic_drives(bundle)).text()


def drawing_in():
    """Describe the blades as they are: bending draws their ends in, as MuJoCo's hinges do."""
    return blade_arm(links=[{'joint': 'j1', 'flexible': blade(lumped=[{'mass': 0.8}],
                                                              stretch=True)},
                            {'joint': 'j2', 'flexible': blade(stretch=True)}])


@pytest.mark.parametrize('q', POSES)
def test_first_vibrations_are_those_of_the_elastic_model(q):
    arm = drawing_in()
    _, driven, xml = exported(arm)
    small = driven.linearised(np.array(q))
    wanted = hertz(small.stiffness, small.mass)[:2]
    assert np.allclose(Rest(xml, arm.active_joints).frequencies(q)[:2], wanted, rtol=0.01)


@pytest.mark.parametrize('q', POSES)
def test_gauges_feel_the_weight_as_in_the_elastic_model(q):
    arm = drawing_in()
    _, driven, xml = exported(arm)
    wanted = driven.follow(np.array([q]), np.zeros(1)).moment[0]
    assert np.allclose(Rest(xml, arm.active_joints).moments(q), wanted, rtol=0.01, atol=0.01)


def test_an_end_load_bends_a_link_as_it_bends_the_beam():
    """Force and moment at the end of a cantilever: F L^3 / 3 EI + M L^2 / 2 EI."""
    arm = arm_of([[0.42, 0.0, 0.0, 0.0]], [{'name': 'j1'}], gravity=[0.0, 0.0, 0.0],
                 gauges=[gauge('g1', 'j1', 0.05)], payload={'mass': 1e-3},
                 links=[{'joint': 'j1', 'flexible': blade()}])
    bundle = identified(arm, {'gear(j1)': 1e9})
    model = elastic_of(bundle, 'strain')
    rest = Rest(ElasticFile(model, {}).text(), ['j1'])
    force, moment, length = 0.01, 0.02, 0.42
    link = rest.model.body('payload').id
    rest.data.xfrc_applied[link] = [0.0, force, 0.0, 0.0, 0.0, moment]
    z = rest.settle([0.0])
    rest.force(z)
    bending = driven_arm(arm, model.values).mechanism.beams['j1'].EIz
    assert rest.data.xpos[link][1] == pytest.approx(
        force * length**3 / (3 * bending) + moment * length**2 / (2 * bending), rel=1e-4)
    turned = rest.data.xmat[link].reshape(3, 3)
    assert math.atan2(turned[1, 0], turned[0, 0]) == pytest.approx(
        force * length**2 / (2 * bending) + moment * length / bending, rel=1e-4)


def test_free_motion_is_that_of_the_simulator():
    """One second under torques that carry the arm and shake it: drives and strain."""
    arm = drawing_in()
    bundle, _, xml = exported(arm)
    described = arm_from_dict(load_yaml(description_of(bundle)[0]), base=arm.source,
                              source='again.yaml')
    torques = {'j1': lambda t: 6.5 + 4.0 * math.sin(9.0 * t),
               'j2': lambda t: 1.0 + 2.0 * math.sin(14.0 * t)}
    run = td.simulate(described, torques, seconds=1.0, rate=100.0).run
    model = mujoco.MjModel.from_xml_string(xml)
    rest, data = Rest(xml, arm.active_joints), mujoco.MjData(model)
    data.qpos[rest.free] = rest.settle([0.0, 0.0])
    found, felt = [], []
    for t in run.t:
        while data.time < t - 1e-9:
            data.ctrl[:] = [torques[name](data.time) for name in arm.active_joints]
            mujoco.mj_step(model, data)
        found.append(data.qpos[rest.drives].copy())
        felt.append(data.sensordata.reshape(-1, 3)[:, 2].copy())
    moved = np.ptp(run.q, axis=0)
    assert np.all(moved > 0.1)
    assert np.all(np.abs(np.array(found) - run.q).max(axis=0) < 0.03 * moved)
    error = np.std(np.array(felt)[1:] - run.gauge_moment[1:], axis=0)
    assert np.all(error < 0.1 * np.std(run.gauge_moment, axis=0))


def test_drives_carry_rotors_and_friction_and_gears_their_springs():
    arm = blade_arm()
    _, _, xml = exported(arm)
    model = mujoco.MjModel.from_xml_string(xml)
    drive, gear = model.joint('j2'), model.joint('j2_gear')
    assert model.dof_armature[drive.dofadr[0]] == pytest.approx(0.2)  # 0.1 A by 0.5 A/(N m)
    assert model.dof_damping[drive.dofadr[0]] == pytest.approx(0.4)
    assert gear.stiffness[0] == pytest.approx(160.0)
    assert [model.actuator(i).name for i in range(model.nu)] == ['j1', 'j2']
    assert model.body('payload').mass[0] == pytest.approx(0.25)
    assert np.array_equal(model.numeric('g2').data, [GAINS[1], OFFSETS[1]])


def test_what_springs_cannot_do_is_named():
    arm = blade_arm()
    bundle = identified(arm, {**VALUES, 'play(j2)': 0.004, 'lag': 0.01}, {
        **EFFORT, 'j1': {**DRIVE, 'coulomb': -0.1}})
    model = elastic_of(bundle, 'strain')
    told = ' '.join(not_in_mjcf(model, elastic_drives(bundle)))
    for what in ('backlash of the gear of j2', 'lag of the gauges', 'friction of j1'):
        assert what in told
    assert 'gear of j1' not in told


def test_a_drive_without_a_known_rotor_gets_a_small_one():
    arm = blade_arm()
    bundle, driven, xml = exported(arm, effort=None)
    model = mujoco.MjModel.from_xml_string(xml)
    armature = model.dof_armature[model.joint('j1').dofadr[0]]
    assert 0.0 < armature < 0.02 * driven.linearised(np.zeros(2)).mass[0, 0]
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert all(warning.number == 0 for warning in data.warning)
    assert 'rotor of j1' in ' '.join(not_in_mjcf(elastic_of(bundle, 'strain'), {}))


def test_held_joints_stand_where_they_are_held():
    arm = blade_arm(joints=[{'name': 'j1'}, {'name': 'j2', 'hold': 0.5}], active_joints=['j1'],
                    gauges=[gauge('g1', 'j1', 0.05)])
    xml = ElasticFile(elastic_of(identified(arm, {}), 'strain'), {}).text()
    rest = Rest(xml, ['j1'])
    assert not any('j2' in rest.model.joint(i).name and 'bend' not in rest.model.joint(i).name
                   for i in range(rest.model.njnt))
    rest.data.qpos[:] = 0.0
    mujoco.mj_forward(rest.model, rest.data)
    assert np.allclose(rest.data.site('tip').xpos, [
        0.42 + 0.35 * math.cos(0.5), 0.35 * math.sin(0.5), 0.0], atol=1e-9)
