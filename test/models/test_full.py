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

"""Full parameters that give base parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robot_making import (
    CONSTANTS, COULOMB, described_arm, efforts_of, fitted, JOINTS, motion_of, ROTOR, true_model,
    VISCOUS)
import tudor_dynamics as td
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.comparison import full_parameters, full_parameters_of
from tudor_dynamics.models.consistent import parameters_of, pseudo_inertia


@pytest.fixture(scope='module')
def torque_arm(tmp_path_factory):
    return described_arm(tmp_path_factory.mktemp('torque'))


@pytest.fixture(scope='module')
def torque_model(torque_arm):
    return fitted(torque_arm)


@pytest.fixture(scope='module')
def found(torque_arm, torque_model):
    return full_parameters_of(torque_arm, torque_model)


def relative(model, arm, seed=7):
    motion = motion_of(60.0, seed)
    true = efforts_of(arm, motion)
    return np.linalg.norm(model.predict(motion) - true) / np.linalg.norm(true)


def test_bodies_can_exist_and_drives_take_energy(found):
    for parameters in found.bodies.values():
        assert np.linalg.eigvalsh(pseudo_inertia(parameters)).min() > 0.0
    for terms in found.drives.values():
        assert all(value >= 0.0 for value in terms.values())


def test_unseen_motion_is_predicted_as_well(torque_arm, torque_model, found):
    free, full = relative(torque_model, torque_arm), relative(found.model, torque_arm)
    assert full < free + 0.001
    assert np.allclose(found.solution.relative_errors, found.solution.free_errors, rtol=0.02)


def test_what_the_data_show_is_the_truth(torque_arm, found):
    """Joints that gravity and others load show first moments; bars are three standard errors."""
    truth = [np.asarray(inertia.toDynamicParameters())
             for inertia in list(true_model(torque_arm).inertias)[1:]]
    for body, true, error in zip(found.bodies.values(), truth, found.solution.body_errors,
                                 strict=True):
        assert np.all(np.abs(body - true) < 3.0 * error)
    for name, viscous, coulomb, rotor in zip(JOINTS, VISCOUS, COULOMB, ROTOR, strict=True):
        assert found.drives[name]['viscous'] == pytest.approx(viscous, abs=0.15)
        assert found.drives[name]['coulomb'] == pytest.approx(coulomb, abs=0.15)
        assert found.drives[name]['Ia'] <= 3.0 * rotor + 0.5


def test_what_the_data_do_not_show_is_said_to_be_described(torque_arm, found):
    sources = dict(zip(found.columns, found.sources(), strict=True))
    # nothing turns about horizontal axes of the column, and nothing lifts it
    assert sources['m(turn)'] == sources['Ixx(turn)'] == 'description'
    assert sources['my(roll)'] == sources['mz(roll)'] == 'data'
    mass = found.bodies['turn'][0]
    assert mass == pytest.approx(torque_arm.model.inertias[1].mass, rel=1e-2)


def test_unknown_torque_constants_are_found_up_to_a_factor(tmp_path):
    arm = described_arm(tmp_path, currents=True)
    found = full_parameters_of(arm, fitted(arm, noise=0.1))
    constants = np.array([found.torque_constants[name] for name in JOINTS])
    ratio = constants / CONSTANTS
    assert found.assumed
    assert np.all(np.abs(ratio / ratio.mean() - 1.0) < 0.25)
    assert 0.6 < ratio.mean() < 1.6  # masses as described are off by up to 40 %
    assert relative(found.model, arm) < 0.01


def test_a_bundle_keeps_what_is_needed(torque_arm, torque_model, found, tmp_path):
    bundle = ModelBundle(torque_arm, PreprocessingSpec(), {'effort': {'analytical': torque_model}})
    save_bundle(bundle, tmp_path / 'model')
    again = full_parameters(load_bundle(tmp_path / 'model', with_data=True))
    assert np.array_equal(again.solution.bodies, found.solution.bodies)
    with pytest.raises(ModelError, match='lacks the file data.npz'):
        full_parameters(load_bundle(tmp_path / 'model'))
    with pytest.raises(ModelError, match='analytical model of efforts for one load'):
        full_parameters(replace(bundle, models={}))


def test_a_better_description_does_not_move_what_the_data_fix(torque_arm, torque_model, found):
    from tudor_dynamics.models.consistent import prior_of
    prior = prior_of(torque_arm)
    center = prior.center.copy()
    center[:, 0] += 0.2  # all masses half as large again
    other = full_parameters_of(torque_arm, torque_model, replace(prior, center=center))
    assert parameters_of(center[0])[0] > 1.4 * parameters_of(prior.center[0])[0]
    for i, source in enumerate(found.sources()[:40]):
        if source == 'data':
            assert other.solution.bodies.flat[i] == pytest.approx(
                found.solution.bodies.flat[i], abs=found.solution.body_errors.flat[i])


@pytest.mark.shared
@pytest.mark.parametrize(('config', 'training', 'test'), [
    ('ur10.yaml', 'ur10_exciting@0-60%', 'ur10_exciting@60-100%'),
    ('emps.yaml', 'emps_estimation', 'emps_validation')])
def test_real_arms_lose_at_most_a_tenth_of_a_point(root, shared_data, config, training, test):
    """Unseen motion by base parameters, and by bodies that can exist with drives that take."""
    bags = shared_data / 'bags'
    bundle = td.fit([f'{bags}/{training}'], td.load_arm(root / 'config' / config),
                    test=[f'{bags}/{test}'])
    full = full_parameters(bundle)
    data = load(parse_choice(f'{bags}/{test}'), bundle.arm, bundle.preprocessing, learn=True)
    y = np.vstack([stretch.decimation(stretch.effort) for stretch in data.stretches])
    errors = [np.linalg.norm(y - np.vstack([model.follow_kept(stretch)
                                            for stretch in data.stretches])) / np.linalg.norm(y)
              for model in (full.model, bundle.models['effort']['analytical'])]
    assert errors[0] < errors[1] + 0.001
    for body in full.bodies.values():
        assert np.linalg.eigvalsh(pseudo_inertia(body)).min() > 0.0
    for terms in full.drives.values():
        assert terms.get('Ia', 0.0) >= 0.0
