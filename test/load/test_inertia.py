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

"""Inertial parameters: other frames, and bodies that can exist."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pinocchio as pin
import pytest
from sample_arms import random_inertia

from tudor_dynamics.load.rows import consistent, point_mass, reframed
from tudor_dynamics.models.consistent import parameters_from, pseudo_inertia


@given(st.integers(0, 10_000))
def test_as_pinocchio(seed: int) -> None:
    """Another frame is what Pinocchio makes of the same body; a body that exists is consistent."""
    pin.seed(seed)
    body, place = random_inertia(np.random.default_rng(seed)), pin.SE3.Random()
    parameters = body.toDynamicParameters()
    assert reframed(place) @ parameters == pytest.approx(
        place.actInv(body).toDynamicParameters(), abs=1e-12)
    assert parameters_from(pseudo_inertia(parameters)) == pytest.approx(parameters, abs=1e-12)
    assert np.linalg.eigvalsh(pseudo_inertia(parameters)).min() > -1e-12


def test_point_mass() -> None:
    """One kilogram at a place is Pinocchio's."""
    place = np.array([0.3, -0.2, 0.1])
    expected = pin.Inertia(1.0, place, np.zeros((3, 3))).toDynamicParameters()
    assert point_mass(place) == pytest.approx(expected, abs=1e-15)


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(-2.0, 2.0), min_size=10, max_size=10), st.integers(1, 10))
def test_what_is_found_can_exist(values: list[float], shown: int) -> None:
    """Whatever the estimate, and however little of it is known."""
    information = np.diag([1e4] * shown + [0.0] * (10 - shown))
    found = consistent(np.array(values), information, 0.1)
    assert np.linalg.eigvalsh(pseudo_inertia(found)).min() > -1e-9


def test_a_body_that_exists_stays() -> None:
    """What is known and possible is not moved."""
    true = pin.Inertia(0.4, np.array([0.1, 0.02, -0.03]),
                       np.diag([2e-3, 3e-3, 2.5e-3])).toDynamicParameters()
    found = consistent(true, 1e10 * np.eye(10), 0.1)
    assert found == pytest.approx(true, abs=1e-6)
