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

"""Bodies that can exist."""

from __future__ import annotations

from hypothesis import given, strategies as st
import numpy as np
import pytest
from robot_making import described_arm
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.models.consistent import (
    log_cholesky, parameters_from, parameters_of, prior_of, pseudo_inertia, slopes_of)

LOGS = st.lists(st.floats(-2.0, 2.0), min_size=10, max_size=10).map(np.array)


@given(LOGS)
def test_any_ten_numbers_are_a_body(log):
    parameters = parameters_of(log)
    pseudo = pseudo_inertia(parameters)
    assert np.linalg.eigvalsh(pseudo).min() > 0.0
    assert np.allclose(parameters_from(pseudo), parameters, rtol=1e-9, atol=1e-12)
    assert np.allclose(log_cholesky(parameters), log, atol=1e-6)


def test_slopes_are_those_of_differences():
    log, step = np.linspace(-0.5, 0.7, 10), 1e-6
    found = [(parameters_of(log + step * way) - parameters_of(log - step * way)) / (2.0 * step)
             for way in np.eye(10)]
    assert np.allclose(slopes_of(log), np.transpose(found), rtol=1e-6, atol=1e-7)


def test_a_body_that_cannot_exist_has_no_logarithms():
    with pytest.raises(np.linalg.LinAlgError):
        log_cholesky(np.array([1.0, 0.5, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1]))  # centre too far out


def test_the_prior_is_what_is_described(tmp_path):
    arm = described_arm(tmp_path)
    prior = prior_of(arm)
    assert prior.described
    for log, inertia in zip(prior.center, list(arm.model.inertias)[1:], strict=True):
        found, given = parameters_of(log), np.asarray(inertia.toDynamicParameters())
        assert np.allclose(found[:4], given[:4], rtol=1e-9)


def test_without_masses_bodies_are_rods(root):
    prior = prior_of(load_arm(root / 'config' / 'ur10.yaml'))
    assert not prior.described
    masses = [parameters_of(log)[0] for log in prior.center]
    assert masses[1] == max(masses), 'the upper arm is the longest body'
