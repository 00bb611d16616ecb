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

"""Torque constants that are found with one set of inertial parameters, on arms that are known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sample_arms import arm_of, planar_arm, random_states, SIX_ROWS

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.regressor import column_unit, EffortRegressor, PayloadRegressor
from tudor_dynamics.typing import FloatArray

CONSTANTS = np.array([9.0, 11.0, 8.0, 6.0])
ROWS = [[0.0, np.pi / 2, 0.1, 0.0], *SIX_ROWS[1:4]]


def _arm(units: list[dict[str, Any]]) -> Arm:
    return arm_of(ROWS, [{'name': name, 'effort': unit, 'friction_velocity': 0.2}
                         for name, unit in zip('abcd', units, strict=True)])


UNKNOWN = _arm([{'unit': 'A'}] * 4)


def _currents(motion: FloatArray, noise: float, constants: FloatArray = CONSTANTS) -> FloatArray:
    regressor = EffortRegressor(_arm([{'unit': 'N m'}] * 4))
    truth = np.random.default_rng(5).uniform(0.5, 1.5, len(regressor.columns))
    clean = regressor.rows(motion) @ truth / constants
    return np.asarray(clean + np.random.default_rng(6).normal(0.0, noise, clean.shape))


def _model(arm: Arm, *, shared: bool = True) -> AnalyticalModel:
    return AnalyticalModel(EffortRegressor(arm, shared=shared), 4)


def test_constants_are_found() -> None:
    """Their ratios come out within their errors, and the currents are predicted."""
    motion = random_states(600, 4, seed=1)
    model = _model(UNKNOWN).fit(motion, _currents(motion, 0.02))
    group, = model.groups_
    found = group.constants
    assert found is not None
    ratios = found.values / found.values[0] * CONSTANTS[0]
    assert np.allclose(ratios, CONSTANTS, rtol=0.02)
    assert np.min(found.relative_errors) == 0.0 and np.max(found.values[
        found.relative_errors == 0.0]) == 1.0
    assert np.all(found.relative_errors < 0.05)
    other = random_states(200, 4, seed=2)
    error = model.predict(other) - _currents(other, 0.0)
    assert np.sqrt(np.mean(error ** 2)) < 0.01


def test_few_samples_want_fewer_parameters() -> None:
    """On unseen motion one set of parameters is better than a set of its own for every joint."""
    motion, other = random_states(200, 4, seed=3), random_states(400, 4, seed=4)
    current, truth = _currents(motion, 3.0), _currents(other, 0.0)
    errors = [float(np.linalg.norm(_model(UNKNOWN, shared=shared).fit(motion, current).predict(
        other) - truth)) for shared in (False, True)]
    assert errors[1] < 0.9 * errors[0]


def test_a_known_unit_is_the_measure() -> None:
    """Beside torques, a constant comes out in N m/A, and inertias in kg m^2."""
    arm = _arm([{'unit': 'A'}, {'unit': 'N m'}, {'unit': 'A', 'torque_constant': 8.0},
                {'unit': 'A'}])
    motion = random_states(600, 4, seed=1)
    mixed = _currents(motion, 0.0, np.array([9.0, 1.0, 8.0, 6.0]))
    group, = _model(arm).fit(motion, mixed).groups_
    assert group.constants is not None
    assert group.constants.values == pytest.approx([9.0, 1.0, 1.0, 6.0], rel=2e-3)
    assert np.all(group.constants.relative_errors[[1, 2]] == 0.0)
    names = tuple('abcd')
    assert column_unit(arm, 'effort', names, 'Izz(d)') == 'kg m^2'
    assert column_unit(arm, 'effort', names, 'coulomb(d)') == 'A'
    assert column_unit(UNKNOWN, 'effort', names, 'Izz(d)') == 'kg m^2 (A)/(N m)'


def test_a_loose_joint_keeps_to_the_others() -> None:
    """A joint whose bodies hardly show stays near the others, with an error that says so."""
    motion = random_states(300, 4, seed=1)
    currents = _currents(motion, 0.02)
    currents[:, 3] += np.random.default_rng(8).normal(0.0, 100.0 * currents[:, 3].std(), 300)
    group, = _model(UNKNOWN).fit(motion, currents).groups_
    assert group.constants is not None
    assert 0.2 < group.constants.values[3] / group.constants.values[1] < 2.0
    assert group.constants.relative_errors[3] > 0.3 > group.constants.relative_errors[1]


def test_bundle_and_payload(tmp_path: Path) -> None:
    """A bundle gives the same predictions; a model of all payloads knows the constants too."""
    motion = random_states(400, 4, seed=1)
    model = _model(UNKNOWN).fit(motion, _currents(motion, 0.02))
    save_bundle(ModelBundle(UNKNOWN, PreprocessingSpec(), {'effort': {'analytical': model}}),
                tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model').models['effort']['analytical']
    assert np.allclose(loaded.predict(motion), model.predict(motion), atol=1e-12)

    carried = np.column_stack([motion, np.random.default_rng(9).choice([0.0, 0.4], 400)])
    plain = EffortRegressor(UNKNOWN, shared=True)
    truth = np.random.default_rng(5).uniform(0.5, 1.5, len(plain.columns) + 10)
    rows = PayloadRegressor(plain, UNKNOWN, (0.0, 0.4)).rows(carried)
    clean = (rows[:, :, plain.scaled.nonzero()[0]] @ truth[plain.scaled.nonzero()[0]]
             + rows[:, :, -10:] @ truth[-10:]) / CONSTANTS
    several = AnalyticalModel(PayloadRegressor(plain, UNKNOWN, (0.0, 0.4)), 4).fit(carried, clean)
    for payload in (0.0, 0.4):
        own = carried[:, -1] == payload
        assert np.allclose(several.at(payload).predict(motion[own]), clean[own],
                           atol=2e-3 * np.abs(clean).max())


@pytest.mark.parametrize('change', [
    {'value': 0.0}, {'value': -1.0}, {'value': float('nan')}, {'channel': 'z'},
    {'relative_error': -0.1}])
def test_impossible_constants_are_refused(change: dict[str, Any]) -> None:
    """A bundle may come from anywhere."""
    motion = random_states(400, 4, seed=1)
    content = _model(UNKNOWN).fit(motion, _currents(motion, 0.02)).to_dict(UNKNOWN, 'effort')
    content['groups'][0]['torque_constants'][1].update(change)
    with pytest.raises(ModelError, match='torque_constants'):
        AnalyticalModel.from_dict(content, UNKNOWN, 'effort')


def test_nothing_to_share() -> None:
    """Without unknown constants, or with a single joint, there is nothing to be found."""
    assert EffortRegressor(planar_arm(), shared=True).unknown == ()
    single = arm_of(ROWS[:1], [{'name': 'a', 'effort': {'unit': 'A'}}])
    assert EffortRegressor(single, shared=True).unknown == ()
