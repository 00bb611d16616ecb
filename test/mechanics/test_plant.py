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

"""Stepping a plant: conservation, drives, reactions, agreement of integrators, failures."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest
from sample_arms import put_into_state
from scipy.integrate import solve_ivp
from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.integrator import DDZ
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant
from tudor_dynamics.mechanics.run import Probe, run_plant
import yaml


@pytest.fixture(scope='module')
def contents(root):
    """Read the example descriptions."""
    return {name: yaml.safe_load((root / 'config' / f'{name}.yaml').read_text())
            for name in ('l_shape', 'anthropomorphic', 'elastic_arm', 'single_flexible_link')}


def plant_of(content, dt=1e-3, **more):
    """Build a plant of a description."""
    arm = arm_from_dict(content, base=Path('.'), source='test')
    return Plant(build_mechanism(arm), dt, **more)


def undamped(content):
    """Take all damping away and turn gravity on."""
    content = copy.deepcopy(content)
    content['simulation']['rayleigh'] = {'alpha': 0.0, 'beta': 0.0}
    content['gravity'] = [0.0, -9.81, 0.0] if content['name'] == 'l_shape' else [0.0, 0.0, -9.81]
    for link in content['links']:
        link.pop('joint_damping', None)
    return content


@pytest.mark.parametrize('name', ['l_shape', 'anthropomorphic', 'elastic_arm'])
def test_energy_is_conserved(contents, name):
    """Swinging freely for 5 s, the energy drifts by less than 1e-3 of what is exchanged."""
    plant = plant_of(undamped(contents[name]))
    start, kinetic, drift = plant.energy().total, 0.0, 0.0
    for k in range(5000):
        plant.step()
        if k % 5 == 0:
            now = plant.energy()
            kinetic = max(kinetic, now.kinetic)
            drift = max(drift, abs(now.total - start))
    assert kinetic > 0.5
    assert drift < 1e-4 * kinetic  # 1e-3 is asked for; 2e-6 to 1e-5 were measured


def by_radau(plant, torque, every):
    """Solve the same equations by SciPy: positions and accelerations of the tip."""
    dt, steps, n = plant.dt, len(torque) - 1, plant.mechanism.size

    def right_side(t, y):
        k = min(int(t / dt), steps - 1)
        share = t / dt - k
        put_into_state(plant, t, y[:n], y[n:],
                       (1.0 - share) * torque[k] + share * torque[k + 1])
        return np.concatenate([y[n:], plant.tables.vectors[DDZ]])

    wanted = np.arange(0, steps + 1, every)
    begin = np.concatenate([plant.coordinates, plant.rates])
    solved = solve_ivp(right_side, (0.0, steps * dt), begin, method='Radau', t_eval=wanted * dt,
                       rtol=1e-6, atol=1e-8, max_step=5e-3)
    assert solved.success, solved.message
    probe, seen = Probe(plant), []
    for k, y in zip(wanted, solved.y.T, strict=True):
        put_into_state(plant, k * dt, y[:n], y[n:], torque[k])
        seen.append((plant.state.q.copy(), probe.observe().acceleration.copy()))
    return tuple(np.array(column) for column in zip(*seen, strict=True))


def test_radau_and_generalised_alpha_agree(contents):
    """Two integrators, one motion: torque on a damped spatial arm."""
    t = np.arange(801) * 2.5e-4
    torque = np.zeros((t.size, 2))
    torque[:, 1] = 1.2 + 0.6 * np.sin(20.0 * t)
    plants = [plant_of(contents['single_flexible_link'], 2.5e-4) for _ in range(2)]
    for plant in plants:
        plant.start_torque(torque[0])
    run = run_plant(plants[0], Probe(plants[0]), torque, every=8)
    q, acceleration = by_radau(plants[1], torque, 8)
    assert run.q.shape == q.shape == (101, 2) and np.abs(run.q - q).max() < 1e-4
    scale = np.abs(acceleration).max()
    assert np.sqrt(np.mean((run.acceleration - acceleration) ** 2)) < 0.02 * scale


def test_prescribed_motion_needs_the_effort_that_makes_it(contents):
    """Driving a joint by the reaction of a prescribed motion gives that motion again."""
    content, dt = contents['single_flexible_link'], 1e-3
    first, second = plant_of(content, dt), plant_of(content, dt)
    first.drive('motor', 'motion')
    t, zero = np.arange(401) * dt, np.zeros(2)
    q = 0.4 * (1.0 - np.cos(6.0 * t))
    dq, ddq = 2.4 * np.sin(6.0 * t), 14.4 * np.cos(6.0 * t)
    first.reset(zero, [0.0, dq[0]])
    second.reset(zero, [0.0, dq[0]])
    first.step(motion=([0.0, q[1]], [0.0, dq[1]], [0.0, ddq[1]]))
    efforts, path = [], []
    first.reset(zero, [0.0, dq[0]])
    for k in range(1, 401):
        state = first.step(motion=([0.0, q[k]], [0.0, dq[k]], [0.0, ddq[k]]))
        assert state.q[1] == q[k]
        efforts.append(state.effort.copy())
    second.start_torque(efforts[0])
    for effort in efforts:
        path.append(second.step(effort).q[1])
    assert np.abs(np.array(path) - q[1:]).max() < 5e-3


def test_held_joint_carries_the_weight(contents):
    """The reaction of a held joint at rest is the static torque of all it carries."""
    plant = plant_of(contents['single_flexible_link'])
    plant.drive('motor', 'hold')
    state = plant.step()
    beam = 7850 * 0.004 * 0.015 * 0.5
    expected = 9.81 * (beam * 0.25 + 0.1 * 0.5)
    assert state.q[1] == 0.0
    assert state.effort[1] == pytest.approx(expected, rel=2e-3)  # less what bending shortens


def test_reactions_of_all_joints(contents):
    """At rest each joint transmits the weight and the static moment of all it carries."""
    plant = plant_of(contents['anthropomorphic'])
    for joint in plant.mechanism.joints:
        plant.drive(joint, 'hold')
    seen, effort = Probe(plant).observe(), plant.step().effort
    forearm = 2700 * np.pi / 4 * (0.020**2 - 0.017**2) * 0.46
    upper = 2700 * np.pi / 4 * (0.025**2 - 0.022**2) * 0.55
    carried = np.cumsum([0.3 + forearm, 0.4 + 0.9 + upper, 4.0])[::-1]
    assert seen.reaction[:, 2] == pytest.approx(9.81 * carried, rel=1e-6)
    assert np.abs(seen.reaction[:, :2]).max() < 1e-6
    # Shoulder and elbow turn about -y of the base where the column stands at 0.
    assert seen.reaction[1:, 4] == pytest.approx(-effort[1:], rel=1e-5)


def test_same_inputs_same_bits(contents):
    """A run repeated after a reset is identical."""
    plant = plant_of(contents['l_shape'])
    ends = []
    for _ in range(2):
        plant.reset()
        for k in range(100):
            plant.step([0.5 if k < 50 else -0.5, 0.0])
        ends.append(plant.coordinates.copy())
    assert np.array_equal(ends[0], ends[1])


def test_parameters_can_be_changed_between_steps(contents):
    """A payload that grows lowers the tip after it was declared."""
    plant = plant_of(contents['single_flexible_link'])
    plant.drive('motor', 'hold')
    probe = Probe(plant)
    tip = plant.mechanism.tip
    before = probe.observe().position[tip, 2]
    plant.mechanism.body_float[-1, 27] = 0.3
    plant.parameters_changed()
    plant.reset()
    assert probe.observe().position[tip, 2] < before - 1e-3


@pytest.mark.parametrize(('torque', 'force'), [
    ([np.nan, 0.0], None), ([0.0, np.inf], None), (None, [np.nan, 0.0, 0.0])])
def test_inputs_that_are_not_finite_are_refused(contents, torque, force):
    """The state stays what it was."""
    plant = plant_of(contents['l_shape'])
    before = plant.coordinates.copy()
    with pytest.raises(SimulationError, match='not finite'):
        plant.step(torque, force)
    assert np.array_equal(plant.coordinates, before)


def test_a_run_that_breaks_down_says_when_and_with_what_energy(contents):
    """A torque beyond all measure ends the run with time and energy, and no NaN."""
    plant = plant_of(contents['l_shape'])
    with pytest.raises(SimulationError, match='diverged at .* s; .* or take time steps below'):
        for _ in range(2000):
            plant.step([3e4, 0.0])
    assert np.isfinite(plant.coordinates).all()
    assert np.isfinite(plant.rates).all()


@pytest.mark.parametrize('stretch', [False, True])
def test_a_bent_link_let_go_without_a_hub(contents, stretch):
    """A loaded arm whose massless hub is released snaps at 1e5 rad/s^2, and the step converges."""
    content = copy.deepcopy(contents['elastic_arm'])
    content['simulation']['initial'] = {'joint2': 0.8}
    for link in content['links'][1:]:
        link['hub_inertia'] = 0.0
        del link['joint_stiffness'], link['joint_damping']
        link['flexible']['stretch'] = stretch
    plant = plant_of(content, 5e-4)
    assert np.abs(plant.state.ddq).max() > 1e4
    start = plant.energy().total
    for _ in range(200):
        plant.step()
    assert plant.energy().total <= start + 1e-3


def test_impossible_settings_are_refused(contents):
    """Steps, rho, names and shapes that cannot be meant get one line."""
    with pytest.raises(SimulationError, match='too large'):
        plant_of(contents['l_shape'], 0.05)
    with pytest.raises(SimulationError, match='more than 0 s'):
        plant_of(contents['l_shape'], -1e-3)
    with pytest.raises(SimulationError, match='rho'):
        plant_of(contents['l_shape'], 1e-3, rho=1.5)
    names = [joint['name'] for joint in contents['l_shape']['joints']]
    with pytest.raises(SimulationError, match='does not model couplings; remove them'):
        plant_of(contents['l_shape'] | {'couplings': {'pairs': [
            {'motor': names[-1], 'joint': names[-2], 'ratio': 1.0}]}}, 1e-3)
    plant = plant_of(contents['l_shape'])
    with pytest.raises(SimulationError, match='motor'):
        plant.drive('moter', 'hold')
    with pytest.raises(SimulationError, match='shape'):
        plant.step(None, np.zeros(4))


def test_every_example_arm_stands(root):
    """The descriptions in config that have links can be simulated."""
    found = 0
    for path in sorted((root / 'config').glob('*.yaml')):
        if path.name == 'nodes.yaml':
            continue  # parameters of nodes, no arm
        arm = load_arm(path)
        if arm.spec.links:
            plant = Plant(build_mechanism(arm), 5e-4)
            for _ in range(5):
                plant.step()
            probe = Probe(plant, arm=arm)
            assert np.isfinite(probe.observe().strain).all()
            found += 1
    assert found >= 4
