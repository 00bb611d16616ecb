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

"""What is left open is chosen by left-out parts, on arms whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sample_arms import arm_of, multisine, recording_of

from tudor_dynamics import library
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.choice import (
    Choices, choose, friction_words, LeftOut, paid)
from tudor_dynamics.identification.dataset import BagChoice, BagData, filtered, training_blocks
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.library import fit_bags, HeldBags
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.friction import FrictionStates
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.signals.preprocessing import prepare
from tudor_dynamics.typing import FloatArray

ROWS = [[0.4, np.pi / 2, 0.1, 0.0], [0.35, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0]]
SPEC = PreprocessingSpec(filter='zero_phase', cutoff=20.0)
PLAIN = FitSettings(kinds=('analytical',))


def _arm(unit: dict[str, Any] | None = None, **joint: Any) -> Arm:
    effort = {} if unit is None else {'effort': unit}
    return arm_of(ROWS, [{'name': name, **effort, **joint} for name in 'abc'])


def _motion(seed: int, seconds: float) -> FloatArray:
    motion = multisine(np.arange(round(100 * seconds)) / 100.0, 3, seed)
    motion[:, :3] += np.random.default_rng(seed).normal(0.0, 1e-5, motion[:, :3].shape)
    return motion


def _recording(
    arm: Arm, seed: int, *, noise: float = 0.3, scale: FloatArray | float = 1.0,
    seconds: float = 25.0, more: Any = None,
) -> Recording:
    """Record an arm whose parameters are drawn; ``more`` adds friction to its efforts."""
    motion = _motion(seed, seconds)
    regressor = EffortRegressor(arm)
    truth = np.random.default_rng(3).uniform(0.3, 1.0, len(regressor.columns))
    effort = regressor.rows(motion) @ truth
    if more is not None:
        effort = effort + more(motion, effort)
    effort = effort / scale + np.random.default_rng(seed + 50).normal(0.0, noise, effort.shape)
    return recording_of(motion[:, :3], 100.0, effort=effort, path=f'run{seed}')


def _bag(recording: Recording, spec: PreprocessingSpec = SPEC) -> BagData:
    return filtered(BagData(BagChoice(recording.path), recording, ()), spec)


def _choose(
    arm: Arm, *recordings: Recording, spec: PreprocessingSpec = SPEC,
    settings: FitSettings = PLAIN,
) -> Choices:
    return choose(arm, [_bag(item, spec) for item in recordings], spec, settings)


def _words(chosen: Choices) -> dict[str, str]:
    return {choice.what: choice.chosen for choice in chosen.made}


def test_nothing_is_added_that_does_not_pay() -> None:
    """An arm with viscous and Coulomb friction keeps these, and weighted least squares."""
    arm = _arm()
    chosen = _choose(arm, _recording(arm, 1), _recording(arm, 2))
    assert [joint.friction for joint in chosen.arm.joints] == [('viscous', 'coulomb')] * 3
    assert chosen.settings.estimator == 'wls' and chosen.settings.shared is False
    assert chosen.preprocessing == SPEC
    assert 'nothing else is better' in str(chosen.made[0])


def test_an_elastic_model_has_the_friction_of_the_others() -> None:
    """Alone it takes the terms that it takes beside an analytical model."""
    def friction(motion: FloatArray, _: FloatArray) -> FloatArray:
        return 5.0 * motion[:, 3:6] * np.abs(motion[:, 3:6])

    arm = _arm()
    bags = [_recording(arm, seed, more=friction) for seed in (1, 2)]
    alone, beside = (_choose(arm, *bags, settings=FitSettings(kinds=kinds)) for kinds in (
        ('elastic',), ('analytical', 'elastic')))
    assert alone.arm.joints == beside.arm.joints != arm.joints
    assert set(_words(alone)) == {'friction'}


def test_an_elastic_model_changes_no_choice_of_the_others() -> None:
    """Friction by the load and filters are those without it; it leaves out what it cannot have."""
    arm = _arm()
    bags = [_recording(arm, seed, more=lambda motion, effort: 0.3 * np.abs(effort) * np.tanh(
        motion[:, 3:6] / 0.02)) for seed in (1, 2)]
    for item in bags:
        item.q[:] += np.random.default_rng(4).normal(0.0, 2e-4, item.q.shape)
    alone, both = (_choose(arm, *bags, spec=PreprocessingSpec(), settings=FitSettings(kinds=kinds))
                   for kinds in (('analytical',), ('analytical', 'elastic')))
    assert any('load' in joint.friction for joint in alone.arm.joints)
    assert alone.preprocessing.filter == 'zero_phase'
    assert both.arm.joints == alone.arm.joints and both.made == alone.made
    assert both.preprocessing == alone.preprocessing
    named = {column for columns in ElasticModel(both.arm, 'effort').columns for column in columns}
    assert 'viscous(a)' in named and not any('load' in column for column in named)


@pytest.mark.parametrize(('term', 'friction'), [
    ('load', lambda motion, effort: 0.3 * np.abs(effort) * np.tanh(motion[:, 3:6] / 0.02)),
    ('offset', lambda motion, effort: np.full((len(motion), 3), 3.0)),
    ('square', lambda motion, effort: 5.0 * motion[:, 3:6] * np.abs(motion[:, 3:6]))])
def test_friction_that_is_there_is_found(term: str, friction: Any) -> None:
    """A term of which the efforts are full is added to every joint, and what it brought said."""
    arm = _arm()
    chosen = _choose(arm, _recording(arm, 1, more=friction), _recording(arm, 2, more=friction))
    assert sum(term in joint.friction for joint in chosen.arm.joints) >= 2
    choice, = (item for item in chosen.made if item.what == 'friction')
    assert choice.error < 0.8 * choice.error_instead and term in choice.chosen


def test_presliding_is_found() -> None:
    """Springs that give way are found with their displacement, also in a part of a bag."""
    truth = _arm(friction=['viscous', 'coulomb', 'presliding'], presliding_distances=[0.03])
    recordings = []
    for seed in (1, 2):
        recording = _recording(_arm(), seed)
        bent = FrictionStates(truth).follow(prepare(recording, SPEC)[0])[:, 9:]
        recordings.append(replace(recording, effort=recording.effort + 4.0 * bent))
    chosen = _choose(_arm(), *recordings)
    assert all(0.03 in joint.state_values('presliding') for joint in chosen.arm.joints)
    choice, = (item for item in chosen.made if item.what == 'friction')
    assert choice.error < 0.8 * choice.error_instead and 'gives way over 0.03' in choice.chosen


def test_what_is_described_stays() -> None:
    """Friction that the description names is fixed, whatever the efforts hold; so is a filter."""
    arm = _arm(friction=['viscous', 'coulomb'], friction_velocity=0.02)
    offset = _recording(arm, 1, more=lambda motion, effort: np.full((len(motion), 3), 5.0))
    chosen = _choose(arm, offset, settings=FitSettings(kinds=('analytical',), estimator='huber'))
    assert chosen.arm.joints == arm.joints and chosen.made == ()
    assert chosen.settings.estimator == 'huber'
    opened = arm.with_open_friction()
    assert any('offset' in joint.friction or joint.asymmetric
               for joint in _choose(opened, offset).arm.joints)
    assert _arm(friction='auto').joints == _arm().joints


@pytest.mark.parametrize('changed', [False, True])
def test_an_only_bag_is_chosen_by_as_a_whole(
    changed: bool, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The model has what all of the bag shows; its figure is of choices blind to the end."""
    def friction(motion: FloatArray, _: FloatArray) -> FloatArray:
        late = np.arange(len(motion))[:, None] >= 0.6 * len(motion) + 100
        return 20.0 * late * motion[:, 3:6] * np.abs(motion[:, 3:6])

    arm = _arm()
    whole = _recording(arm, 1, more=friction if changed else None)
    monkeypatch.setattr(library, 'load', lambda *_, **__: _bag(whole))
    result = fit_bags(HeldBags(arm, [BagChoice(whole.path)], [], SPEC, {}, lambda _: None),
                      PLAIN, examine=False)
    assert result.arm.joints == _choose(arm, whole).arm.joints
    assert changed == any('square' in joint.friction for joint in result.arm.joints)
    assert result.blind is not None and result.blind.joints == arm.joints
    item, = result.fitted
    (blind, last), = item.validation.cases
    assert isinstance(blind, AnalyticalModel) and isinstance(item.model, AnalyticalModel)
    assert (blind.regressor.columns == item.model.regressor.columns) != changed
    assert str(last.choice) == 'run1@60-100%'
    assert (item.validation.score.relative_error > 0.1) == changed


def test_filter() -> None:
    """Noisy positions want filters without a lag; an elastic arm alone, and who says so, not."""
    arm, open_spec = _arm(), PreprocessingSpec()
    noisy = _recording(arm, 1)
    noisy.q[:] += np.random.default_rng(4).normal(0.0, 2e-4, noisy.q.shape)
    chosen = _choose(arm, noisy, spec=open_spec)
    assert chosen.preprocessing.filter == 'zero_phase'
    choice = chosen.made[0]
    assert choice.what == 'filters' and choice.error < choice.error_instead
    for spec, kinds in ((PreprocessingSpec(filter='causal'), ('analytical',)),
                        (open_spec, ('elastic',))):
        found = _choose(arm, noisy, spec=spec, settings=FitSettings(kinds=kinds))
        assert found.preprocessing == spec and 'filters' not in _words(found)


def test_shared_parameters() -> None:
    """Few seconds of noisy currents want one set of parameters, wrong kinematics their own."""
    arm = _arm({'unit': 'A'})
    scale = np.array([9.0, 11.0, 8.0])
    short = [_recording(arm, seed, noise=0.5, scale=scale, seconds=9.0) for seed in (1, 2)]
    assert _choose(arm, *short).settings.shared is True
    other = arm_of([[0.1, 0.0, 0.1, 0.0], *ROWS[1:]], [
        {'name': name, 'effort': {'unit': 'A'}} for name in 'abc'])
    chosen = _choose(other, *(_recording(arm, seed, noise=0.01, scale=scale) for seed in (1, 2)))
    assert chosen.settings.shared is False
    assert _choose(arm, *short, settings=FitSettings(
        kinds=('analytical',), shared=False)).settings.shared is False


def test_left_out_errors_are_those_of_a_model() -> None:
    """Products less a part, solved, give what a model does that is fitted to the other bags."""
    arm = _arm(friction=['viscous', 'coulomb', 'offset'])
    bags = [_bag(_recording(arm, seed, seconds=10.0)) for seed in range(6)]
    found = LeftOut(arm, 'effort', arm.joints, bags, 'exact').errors(arm.joints)
    assert found.shape == (6, 3)
    model = AnalyticalModel(EffortRegressor(arm), 3)
    model.fit_blocks(training_blocks(bags[1:], 'effort', model))
    stretch, = bags[0].stretches
    error = stretch.decimation(stretch.effort) - model.follow_kept(stretch)
    assert np.allclose(found[0], np.sum(error ** 2, axis=0), rtol=1e-3)


def test_paid() -> None:
    """A gain has to be large enough, and larger than its scatter between the parts."""
    before = np.array([1.0, 1.1, 0.9, 1.0])
    assert paid(before, 0.9 * before)
    assert not paid(before, 0.995 * before)
    assert not paid(before, before * [0.1, 1.2, 1.3, 1.2])
    assert not paid(before, before * np.inf) and not paid(0.0 * before, before)
    assert not paid(before[:1], 0.5 * before[:1])


def test_friction_in_words() -> None:
    """Joints alike stand together."""
    arm = arm_of(ROWS, [{'name': 'a'}, {'name': 'b', 'asymmetric': True}, {'name': 'c'}])
    assert friction_words(arm.joints) == (
        'a, c: viscous + coulomb; b: viscous + coulomb, each way')
