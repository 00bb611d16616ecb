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

"""Bodies before and after a fit, on an arm that is not as it is described."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robot_making import described_arm, efforts_of, JOINTS, motion_of, true_model
from sample_arms import recording_of
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagChoice, BagData
from tudor_dynamics.identification.fit import fit_models, FitSettings
from tudor_dynamics.show.page import before_after, render
from tudor_dynamics.signals.preprocessing import prepare

N = len(JOINTS)


def bag(arm, seed, seconds=20.0, rate=100.0):
    motion = motion_of(seconds, seed, rate)
    recording = recording_of(motion[:, :N], rate, dq=motion[:, N:2 * N],
                             effort=efforts_of(arm, motion, 0.3, seed), path=f'run{seed}')
    return BagData(BagChoice(f'run{seed}'), recording,
                   tuple(prepare(recording, PreprocessingSpec(filter='zero_phase'))))


@pytest.fixture(scope='module')
def result(tmp_path_factory):
    arm = described_arm(tmp_path_factory.mktemp('arm'))
    bags = [bag(arm, seed) for seed in (1, 2)]
    return fit_models(arm, bags, [], None, PreprocessingSpec(filter='zero_phase'), FitSettings())


def test_identified_bodies_explain_unseen_motion_as_described_ones_do_not(result):
    found = before_after(result)
    errors = dict(found['joints'])
    assert list(errors) == list(JOINTS)
    described, identified, _ = errors[JOINTS[1]]
    assert described > 2.0 * identified, 'the upper arm is lighter than described'
    for described, identified, free in errors.values():
        assert identified < free + 0.2
        assert identified <= described
    assert not found['assumed']


def test_bodies_stand_beside_the_described_ones(result):
    found = before_after(result)
    masses = [inertia.mass for inertia in list(result.arm.model.inertias)[1:]]
    truth = [inertia.mass for inertia in list(true_model(result.arm).inertias)[1:]]
    bodies = found['bodies']
    assert [body.mass[0] for body, _, _ in bodies] == pytest.approx(masses)
    for (body, mass_error, shown), true in zip(bodies, truth, strict=True):
        assert abs(body.mass[1] - true) < 3.0 * mass_error
        assert 0 <= shown <= 10


def test_the_page_shows_it(result):
    page = render(result)
    assert 'id="before"' in page
    assert 'href="#before"' in page
    assert 'Mass before' in page


def test_without_masses_there_is_no_before(result, root):
    rows = load_arm(root / 'config' / 'ur10.yaml')
    assert before_after(replace(result, arm=rows)) is None
    assert before_after(replace(result, fitted=())) is None
    (fitted,) = result.fitted
    unseen = replace(fitted, validation=replace(fitted.validation, cases=()))
    assert before_after(replace(result, fitted=(unseen,))) is None, 'nothing is left out'
