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

"""Identified values in an arm description: there and back, and what has no place."""

from __future__ import annotations

from pathlib import Path

from elastic_making import blade, blade_arm, even, GAINS, identified, OFFSETS
import numpy as np
import pytest
import tudor_dynamics as td
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.errors import ModelError
from tudor_dynamics.files import load_yaml
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.models.elastic.model import driven_arm
from tudor_dynamics.show.description import description_of

VALUES = {'bending(j1)': 15.25, 'bending(j2)': 20.0, 'density(j1)': 0.45, 'lumped(j1,1)': 0.7,
          'gyration(j1,1)': 0.04, 'payload': 0.25, 'gear(j1)': 190.0, 'play(j2)': 0.003,
          'tight(j1)': 0.35, 'loose(j1)': 0.35,
          'alpha': 0.1, 'beta': 8e-4}
CURRENTS = [{'name': name, 'effort': {'unit': 'A'}, 'asymmetric': True} for name in ('j1', 'j2')]
DRIVE = {'torque': 0.2, 'Ia': 0.05, 'viscous+': 0.3, 'viscous-': 0.2, 'coulomb+': 0.1,
         'coulomb-': -0.15}


def again(bundle):
    """Write a description and read it."""
    text, left_out = description_of(bundle)
    return arm_from_dict(load_yaml(text), base=Path('.'), source='again.yaml'), text, left_out


@pytest.mark.parametrize('inertia', [0.0, 1e-3, [0.0] * 6, [1e-3, 5e-4, 1.2e-3, 0.0, 0.0, 0.0]])
def test_the_description_is_that_of_the_identified_arm(inertia):
    arm = blade_arm(links=[
        {'joint': 'j1', 'flexible': blade(lumped=[
            {'mass': 0.0}, {'mass': 0.8, 'inertia': inertia}])},
        {'joint': 'j2', 'flexible': blade(material={'E': 2e11, 'G': 8e10, 'rho': 7800})}])
    bundle = identified(arm, VALUES)
    described, _, left_out = again(bundle)
    assert described.digest == arm.digest, 'the model goes with it'
    wanted = driven_arm(arm, VALUES)
    there = DrivenArm(described)
    assert there.parameters == pytest.approx(wanted.parameters, rel=1e-12)
    for one, other in zip(there.arrays, wanted.arrays, strict=True):
        assert np.allclose(one, other, rtol=1e-9, atol=1e-12)
    assert not left_out
    sensors = {sensor.gauge: (sensor.gain, sensor.offset) for sensor in described.spec.sensors}
    assert sensors == {'g1': (GAINS[0], OFFSETS[0]), 'g2': (GAINS[1], OFFSETS[1])}


def test_drives_get_constants_rotors_and_friction_of_each_direction():
    bundle = identified(blade_arm(joints=CURRENTS), {}, {'j1': DRIVE, 'j2': DRIVE})
    described, _, left_out = again(bundle)
    motor = described.spec.motors[0]
    assert motor.joint_torque_constant == pytest.approx(1.0 / 0.2)
    assert motor.reflected_inertia == pytest.approx(0.05 / 0.2)
    assert motor.viscous == pytest.approx((0.3, 0.2))
    assert motor.coulomb == pytest.approx((0.1, 0.15))
    assert not left_out


def test_a_joint_without_a_motor_gets_what_its_link_can_say():
    arm = blade_arm(motors=[])
    bundle = identified(arm, {'gear(j1)': 190.0, 'play(j1)': 0.004}, {
        name: {'torque': 1.0, 'Ia': 0.05, 'viscous': 0.3, 'coulomb': 0.2, 'offset': 0.0}
        for name in ('j1', 'j2')})
    described, _, left_out = again(bundle)
    link = described.spec.links[0]
    assert (link.joint_stiffness, link.hub_inertia, link.viscous_friction) == (190.0, 0.05, 0.3)
    assert any('backlash of j1' in what for what in left_out)
    assert any('coulomb of j1' in what for what in left_out)


def test_what_has_no_place_is_named_and_nothing_negative_is_written():
    arm = blade_arm(joints=CURRENTS)
    bundle = identified(arm, {'lag': 0.02, 'edge(j1)': 0.3, 'loose(j2)': 3.0}, {
        'j1': {**DRIVE, 'Ia': -0.1}, 'j2': {**DRIVE, 'viscous+': -0.1}})
    described, text, left_out = again(bundle)
    told = '\n'.join(left_out)
    for what in ('lag of the gauges', 'part of the backlash of j1', 'inside the backlash',
                 'Ia of j1, which is below zero', 'viscous of j2, which is below zero'):
        assert what in told
        assert what in text, 'the file says it too'
    assert described.spec.motors[0].rotor_inertia == 0.0
    assert described.spec.motors[1].viscous == pytest.approx((0.0, 0.2))


def test_the_model_predicts_what_the_described_arm_does():
    """Simulate from the description, with more elements than the model has, and predict."""
    arm = blade_arm(backlash=0.0, links=[
        {'joint': 'j1', 'flexible': blade(elements=3, lumped=[{'mass': 0.8}])},
        {'joint': 'j2', 'flexible': blade(elements=3)}])
    values = {**VALUES, 'play(j2)': 0.0}
    bundle = identified(arm, values, {name: {
        'torque': 1.0, 'Ia': 0.4, 'viscous': 1.0, 'coulomb': 0.0, 'offset': 0.0}
        for name in ('j1', 'j2')})
    described, *_ = again(bundle)
    run = td.simulate(described, {'j1': '7 + 4*sin(6*t)', 'j2': '1 + 2*sin(9*t)'}, seconds=3.0,
                      rate=200.0).run
    errors = [np.linalg.norm(driven_arm(arm, found).follow(
        run.q, even(len(run.q), 200.0)).moment - run.gauge_moment)
        / np.linalg.norm(run.gauge_moment) for found in (values, {})]
    assert errors[0] < 0.01
    assert errors[1] > 5.0 * errors[0], 'the arm as it was described is another one'


def test_without_an_elastic_model_there_is_nothing_to_describe():
    bundle = identified(blade_arm(), {})
    bundle.models.clear()
    with pytest.raises(ModelError, match='an elastic model, but this fit has none'):
        description_of(bundle)


def test_efforts_that_fall_with_the_load_are_refused():
    bundle = identified(blade_arm(joints=CURRENTS), {}, {
        'j1': DRIVE, 'j2': {**DRIVE, 'torque': -0.2}})
    with pytest.raises(ModelError, match='j2'):
        description_of(bundle)
