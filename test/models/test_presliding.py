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

"""Friction that gives way: hysteresis, the same sample by sample, and through a fit."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from sample_arms import arm_of, multisine, recording_of, SIX_ROWS

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagChoice, BagData, cut, training_blocks
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.friction import (
    friction_columns, friction_names, FrictionStates, LiveFriction)
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.online.monitor import MomentumObserver
from tudor_dynamics.signals.preprocessing import prepare, Stretch
from tudor_dynamics.typing import FloatArray

PULLEYS = {'pairs': [{'motor': 'c', 'joint': 'b', 'ratio': -1.0}]}
CAUSAL = PreprocessingSpec(filter='causal', rate=None, settle=0.1)


def _arm(**more: Any) -> Arm:
    return arm_of(SIX_ROWS[:3], [
        {'name': 'a', 'friction': ['viscous', 'coulomb', 'presliding'],
         'presliding_distances': [0.05, 0.4]},
        {'name': 'b'},
        {'name': 'c', 'friction': ['coulomb', 'load', 'presliding']}], **more)


def _stretch(arm: Arm, seed: int = 0, seconds: float = 4.0, rate: float = 200.0) -> Stretch:
    motion = multisine(np.arange(round(rate * seconds)) / rate, len(arm.joints), seed)
    return prepare(recording_of(motion[:, :len(arm.joints)], rate), CAUSAL)[0]


def _single(places: list[float], distance: float) -> FloatArray:
    arm = arm_of(SIX_ROWS[:1], [{'name': 'a', 'friction': ['presliding'],
                                 'presliding_distances': [distance]}])
    trail = LiveFriction(FrictionStates(arm))
    return np.array([trail.step(float(k > 0), np.array([place, 0.0, 0.0]))[3]
                     for k, place in enumerate(places)])


def test_hysteresis() -> None:
    """From rest it slides after its displacement, turned round after twice that, at any speed."""
    found = _single([0.0, 0.1, 0.2, 0.5, 0.4, 0.3, 0.1, 0.1], 0.2)
    assert np.allclose(found, [0.0, 0.5, 1.0, 1.0, 0.5, 0.0, -1.0, -1.0])


@given(places=st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=30),
       distance=st.floats(1e-4, 1.0))
@settings(max_examples=60, deadline=None)
def test_takes_energy(places: list[float], distance: float) -> None:
    """It stays within its limits, and around any closed path takes work rather than gives it."""
    closed = [*places, places[0]]
    z = _single(closed, distance)
    assert np.all(np.abs(z) <= 1.0)
    # along a straight piece the bristle goes straight to its limit and stays there
    work = 0.0
    for k in range(1, len(closed)):
        way = closed[k] - closed[k - 1]
        bent = z[k] - z[k - 1]
        sliding = way - bent * distance
        work += 0.5 * (z[k] + z[k - 1]) * bent * distance + z[k] * sliding
    assert work - 0.5 * distance * z[-1] ** 2 > -1e-9 * (1.0 + abs(work))


@pytest.mark.parametrize('couplings', [None, {**PULLEYS, 'positions': 'motors'}])
def test_sample_by_sample(couplings: dict[str, Any] | None) -> None:
    """A stretch at once, a part that knows what was before, and a robot live: to 1e-9."""
    arm = _arm(**({} if couplings is None else {'couplings': couplings}))
    model = AnalyticalModel(EffortRegressor(arm), 3)
    motion = multisine(np.arange(800) / 200.0, 3, 1)
    effort = np.random.default_rng(0).normal(size=(800, 3))
    whole = recording_of(motion[:, :3], 200.0, effort=effort)
    stretch, = prepare(whole, CAUSAL)
    inputs = model.inputs(stretch)
    assert inputs.shape == (800, 15) and np.ptp(inputs[:, 9:], axis=0).min() == 0.0
    model.fit(inputs[100:], effort[100:])
    offline = model.follow(stretch)
    assert np.max(np.abs(model.predict(stretch.motion) - offline)) > 1e-3  # as if it slid
    live = AnalyticalModel.live({'effort': model})
    for _ in range(2):  # the second time after a gap
        rows = []
        for k, (dt, row) in enumerate(zip(stretch.dt, stretch.motion, strict=True)):
            wanted = () if k % 7 == 3 else None  # nobody asks, and it follows all the same
            got = live.step(float(dt), row, wanted)
            assert got is not None
            rows.append(got.get('effort', offline[k]))
        assert np.max(np.abs(np.array(rows) - offline)) < 1e-9
    part = prepare(cut(whole, BagChoice('bag', 0.5, 1.0)), CAUSAL)[0]
    assert np.max(np.abs(model.inputs(part)[:, 9:] - inputs[-len(part.t):, 9:])) < 1e-9


def test_rows_and_outputs() -> None:
    """Rows hold each bristle as a column of its own, and agree with the outputs; in blocks too."""
    arm = _arm()
    regressor, stretch = EffortRegressor(arm), _stretch(arm)
    assert 'presliding@0.05(a)' in regressor.columns and regressor.columns[-1] == (
        'presliding@0.003(c)')
    model = AnalyticalModel(regressor, 3)
    inputs = model.inputs(stretch)
    rows = regressor.rows(inputs)
    for name, joint, column in (('presliding@0.05(a)', 0, 9), ('presliding@0.4(a)', 0, 12),
                                ('presliding@0.003(c)', 2, 11)):
        assert np.array_equal(rows[:, joint, regressor.columns.index(name)], inputs[:, column])
    parameters = np.tile(np.random.default_rng(0).normal(size=len(regressor.columns)), (3, 1))
    regressor.assume(parameters)
    for motion in (inputs, stretch.motion):
        expected = np.einsum('kcp,cp->kc', regressor.rows(motion), parameters)
        assert np.allclose(regressor.outputs(motion, parameters), expected, rtol=1e-10)
    effort = np.random.default_rng(1).normal(size=(800, 3))
    motion = multisine(np.arange(800) / 200.0, 3)
    bag = recording_of(motion[:, :3], 200.0, effort=effort)
    stretches = tuple(prepare(bag, PreprocessingSpec(filter='zero_phase', rate=20.0)))
    blocks = list(training_blocks([BagData(BagChoice('bag'), bag, stretches)], 'effort',
                                  model)())
    assert all(block.motion.shape[1] == model.n_inputs for block in blocks)


def test_fitted_and_observed() -> None:
    """
    Friction that gives way is identified, and the momentum observer knows of it.

    Without noise the parameters are exact; the observer sees nothing where nothing touches.
    """
    arm = arm_of(SIX_ROWS[:2], [{'name': name, 'friction': [
        'viscous', 'coulomb', 'presliding'], 'presliding_distances': [0.1]} for name in 'ab'])
    stretch = _stretch(arm, 3, 10.0, 500.0)
    model = AnalyticalModel(EffortRegressor(arm), 2)
    inputs = model.inputs(stretch)
    truth = np.random.default_rng(2).uniform(0.5, 1.0, len(model.regressor.columns))
    effort = model.regressor.rows(inputs) @ truth
    model.fit(inputs, effort)
    found = model.coefficients()
    for i, name in enumerate('ab'):
        place = model.regressor.columns.index(f'presliding@0.1({name})')
        assert found[i, place] == pytest.approx(truth[place], rel=1e-6)
    sliding = model.stiction(stretch.states.q[::50])
    assert np.all(sliding > 1.0)  # Coulomb friction and bristle together
    seen = MomentumObserver(model).process(stretch.stamp, inputs, effort)[1000:]
    blind = MomentumObserver(model).process(stretch.stamp, stretch.motion, effort)[1000:]
    assert np.std(seen[:, 1]) < 0.3 * np.std(blind[:, 1])


def test_names_columns_and_payload() -> None:
    """Columns are in the order of the names; with a payload the bristles come before it."""
    arm = _arm()
    joint = arm.joints[0]
    names = friction_names(joint)
    assert names == ('viscous(a)', 'coulomb(a)', 'presliding@0.05(a)', 'presliding@0.4(a)')
    columns = friction_columns(joint, np.array([0.5]), states=np.array([[0.1, -0.2, 9.0]]))
    assert np.allclose(columns, [[0.5, 1.0, 0.1, -0.2]])
    assert np.allclose(friction_columns(joint, np.array([0.5])), [[0.5, 1.0, 1.0, 1.0]])
    single = arm_of(SIX_ROWS[:1], [{'name': 'a', 'friction': ['presliding']}])
    plain = EffortRegressor(single)
    both = PayloadRegressor(plain, single, (0.0, 0.4))
    inputs = np.array([[0.3, 0.1, 0.2, 0.7, 0.4]])
    assert np.allclose(both.rows(inputs)[:, :, :len(plain.columns)], plain.rows(inputs[:, :-1]))


def test_digest() -> None:
    """What is said of displacements counts for an arm that has such friction, and no other."""
    joint = {'name': 'a', 'friction': ['coulomb']}
    digests = {arm_of(SIX_ROWS[:1], [{**joint, **more}]).digest for more in (
        {}, {'presliding_distances': [0.1]}, {'friction': ['presliding']},
        {'friction': ['presliding'], 'presliding_distances': [0.1]})}
    assert len(digests) == 3
