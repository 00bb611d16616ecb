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

"""Base parameters: their number, independence of the random states, names."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import pytest
from sample_arms import arm_of, gauge, planar_arm, random_states

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import (
    base_sets, EffortRegressor, independent_columns, random_motion, StrainRegressor)

# Each axis is turned against the next one, as in common seven-joint arms.
SEVEN_ROWS = [[0.0, -pi / 2, 0.31, 0.0], [0.0, pi / 2, 0.0, 0.0], [0.08, pi / 2, 0.29, 0.0],
              [-0.08, -pi / 2, 0.0, 0.0], [0.0, pi / 2, 0.36, 0.0], [0.09, pi / 2, 0.0, 0.0],
              [0.0, 0.0, 0.1, 0.0]]
BARE: dict[str, Any] = {'friction': [], 'rotor_inertia': False}
FULL: dict[str, Any] = {'friction': ['viscous', 'coulomb', 'offset']}


def _seven(terms: dict[str, Any]) -> Arm:
    return arm_of(SEVEN_ROWS, [{'name': f'j{i}', **terms} for i in range(7)])


@pytest.mark.parametrize(('arm', 'columns', 'expected'), [
    (planar_arm([{'name': 'j1', **BARE}, {'name': 'j2', **BARE}]), 20, 6),
    (_seven(BARE), 70, 43),
    (_seven(FULL), 98, 69),
])
def test_numbers(arm: Arm, columns: int, expected: int) -> None:
    """
    The sets are as large as known.

    Reference: a planar two-link arm under gravity has ZZ1, ZZ2, MX1, MY1, MX2, MY2 (Khalil and
    Dombre, 2002, chapter 9); a seven-joint arm with a first axis along gravity has 43 inertial
    base parameters, as published for the Franka Panda (Gaz et al., RA-L 4(4), 2019).
    """
    regressor = EffortRegressor(arm)
    assert len(regressor.columns) == columns
    found, = base_sets(regressor, len(arm.active_joints))
    assert len(found.kept) == len(found.names) == expected


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_other_states_give_the_same_set(seed: int) -> None:
    """The choice depends on the arm alone: other random states give it again, names included."""
    arm = planar_arm(gauges=[gauge('g1', 'j1', 0.1), gauge('g2', 'j2', 0.1)])
    for regressor in (EffortRegressor(arm), StrainRegressor(arm), EffortRegressor(_seven(FULL))):
        joints = 7 if len(regressor.columns) == 98 else 2
        for one, other in zip(base_sets(regressor, joints),
                              base_sets(regressor, joints, seed=seed)):
            assert np.array_equal(one.kept, other.kept)
            assert one.names == other.names


def test_reduction_loses_nothing() -> None:
    """All columns are combinations of those kept, at states that the search has not seen too."""
    regressor = EffortRegressor(_seven(FULL))
    matrix = regressor.rows(random_motion(7, 40, 0)).reshape(-1, 98)
    kept, mixture = independent_columns(matrix)
    assert np.allclose(matrix, matrix[:, kept] @ mixture, atol=1e-8 * np.max(np.abs(matrix)))
    truth = np.random.default_rng(0).uniform(-1, 1, 98)
    other = regressor.rows(random_states(30, 7, seed=9)).reshape(-1, 98)
    full = other @ truth
    reduced = other[:, kept] @ (mixture @ truth)
    assert np.max(np.abs(full - reduced)) < 1e-8 * np.max(np.abs(full))


def test_model_reaches_any_parameters() -> None:
    """A fit of the reduced set reproduces outputs of an arbitrary full set on other motion."""
    arm = _seven(FULL)
    regressor = EffortRegressor(arm)
    truth = np.random.default_rng(0).uniform(-1, 1, 98)
    motion, other = random_states(300, 7, seed=1), random_states(50, 7, seed=2)
    model = AnalyticalModel(regressor, 7).fit(motion, regressor.rows(motion) @ truth)
    expected = regressor.rows(other) @ truth
    assert np.max(np.abs(model.predict(other) - expected)) < 1e-6 * np.max(np.abs(expected))


def test_names_tell_what_is_grouped() -> None:
    """The name of a base parameter lists what it stands for, as textbooks write it."""
    arm = planar_arm([{'name': 'j1', **BARE}, {'name': 'j2', **BARE, 'rotor_inertia': True}])
    found, = base_sets(EffortRegressor(arm), 2)
    columns = EffortRegressor(arm).columns
    names = {columns[k]: name for k, name in zip(found.kept, found.names)}
    assert set(names) == {'Izz(j1)', 'Izz(j2)', 'mx(j1)', 'mx(j2)', 'my(j1)', 'my(j2)', 'Ia(j2)'}
    assert names['Izz(j1)'] == 'Izz(j1) + 0.1764 m(j2)'  # L1^2 = 0.42^2
    assert names['mx(j1)'] == 'mx(j1) + 0.42 m(j2)'
    assert names['mx(j2)'] == 'mx(j2)'


@pytest.mark.parametrize('speed', [0.5, 0.02, 0.002])
def test_friction_at_crawling_speed_is_kept(speed: float) -> None:
    """A Stribeck term that shows at crawling speed alone is no lost column, and can be fitted."""
    arm = arm_of([[0.3, 0.0, 0.0, 0.0]], [{
        'name': 'a', 'friction': ['viscous', 'coulomb', 'stribeck'], 'stribeck_velocity': speed,
        'friction_velocity': speed / 20}])
    regressor = EffortRegressor(arm)
    motion = random_states(500, 1)
    motion[:, 1] = np.linspace(-3 * speed, 3 * speed, 500)
    truth = np.random.default_rng(0).uniform(1, 2, len(regressor.columns))
    model = AnalyticalModel(regressor, 1).fit(motion, regressor.rows(motion) @ truth)
    group, = model.groups_
    kept = [regressor.columns[k] for k in group.base.kept]
    assert group.estimate.unexcited == ()
    at = kept.index('stribeck(a)')
    assert group.estimate.parameters[at] == pytest.approx(
        truth[regressor.columns.index('stribeck(a)')], rel=1e-6)


def test_nothing_depends() -> None:
    """Columns that are all zero keep nothing."""
    kept, mixture = independent_columns(np.zeros((5, 3)))
    assert kept.shape == (0,) and mixture.shape == (0, 3)
