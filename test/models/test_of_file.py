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

"""Errors of exported files, as another program reads them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from robot_making import described_arm, efforts_of, JOINTS, motion_of
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.comparison import (
    file_effects, file_errors, file_parameters, full_parameters)
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.show.description import urdf_of
from tudor_dynamics.show.mjcf import mjcf_of

N = len(JOINTS)
FALLING, UPWARDS = np.array([4.0, 3.0, 2.0, 1.0]), np.array([2.0, -1.5, 1.0, 0.3])
FILES = {'urdf': (urdf_of, pin.buildModelFromUrdf), 'mjcf': (mjcf_of, pin.buildModelFromMJCF)}


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Fit an arm whose friction falls with the speed, and differs by direction."""
    arm = described_arm(tmp_path_factory.mktemp('arm')).with_joints({name: {
        'friction': ('viscous', 'coulomb', 'stribeck'), 'asymmetric': True,
        'stribeck_velocity': 0.5} for name in JOINTS})
    motion = motion_of(40.0, 1)
    dq = motion[:, N:2 * N]
    efforts = efforts_of(arm, motion, noise=0.1) + UPWARDS + FALLING * np.tanh(
        dq / 0.02) * np.exp(-(dq / 0.5) ** 2)
    model = AnalyticalModel(EffortRegressor(arm), N)
    model.fit(motion, efforts)
    bundle = ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': model}})
    return bundle, motion, efforts


def errors_of(file, read, motion, efforts):
    """Let Pinocchio predict the efforts by all that a file has."""
    read = read(str(file))
    data = read.createData()
    dq = motion[:, N:2 * N]
    found = np.array([pin.rnea(read, data, row[:N], row[N:2 * N], row[2 * N:]) for row in motion])
    found += read.damping * dq + read.friction * np.tanh(dq / 0.02)
    return np.linalg.norm(found - efforts, axis=0) / np.linalg.norm(efforts, axis=0)


@pytest.mark.parametrize('target', FILES)
def test_the_error_is_that_of_the_file(made, target, tmp_path):
    bundle, motion, efforts = made
    write, read = FILES[target]
    full, file = file_parameters(bundle, rotors=target == 'mjcf'), tmp_path / 'file'
    file.write_text(write(full))
    found = file_errors(bundle, full, file)
    assert np.allclose(found, errors_of(file, read, motion, efforts), rtol=1e-6)
    file.write_text(write(full_parameters(bundle)))
    assert np.linalg.norm(found) < 0.99 * np.linalg.norm(
        errors_of(file, read, motion, efforts)), 'drives nearest to friction that it cannot have'


@pytest.mark.parametrize('target', FILES)
def test_what_each_effect_would_win_is_known(made, target, tmp_path):
    bundle, _, _ = made
    rotors, file = target == 'mjcf', tmp_path / 'file'
    full = file_parameters(bundle, rotors=rotors)
    file.write_text(FILES[target][0](full))
    found = {what: one.solution.relative_errors
             for what, one in file_effects(bundle, full, rotors=rotors).items()}
    assert ('rotor inertias' in found) is (target == 'urdf')
    alone = found.pop('')
    assert np.allclose(alone, file_errors(bundle, full, file), rtol=0.05)
    for what in ('stribeck', 'offset'):  # the arm has both
        assert np.linalg.norm(found[what]) < 0.99 * np.linalg.norm(alone), what
    assert all(np.all(errors < 1.001 * alone) for errors in found.values())
