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

from __future__ import annotations

from pathlib import Path

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import random_states

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import FitError, ModelError, NotFittedError, TudorWarning
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor, StrainRegressor

ARM = two_gauge_arm()
RANGE = (0.0, 0.4)


def regressor(output: str):
    """Rows of an output; the strain's as they were made."""
    return EffortRegressor(ARM) if output == 'effort' else StrainRegressor(ARM, 'paper')


def training(output: str) -> tuple[np.ndarray, np.ndarray]:
    """Motion with payload, and the outputs, for two payloads."""
    inputs, values = [], []
    for seed, payload in enumerate(RANGE):
        motion = random_states(300, 2, seed)
        inputs.append(np.column_stack([motion, np.full(300, payload)]))
        values.append(true_outputs(ARM, motion, payload)[output])
    return np.vstack(inputs), np.vstack(values)


def fitted(output: str) -> AnalyticalModel:
    """Fit to two payloads."""
    return AnalyticalModel(PayloadRegressor(regressor(output), ARM, RANGE), 2).fit(
        *training(output))


@pytest.mark.parametrize('output', ['effort', 'strain'])
def test_two_payloads_determine_all_others(output: str) -> None:
    """A model of 0 and 400 g predicts 150 g to rounding, and 600 g, of which it warns."""
    model, motion = fitted(output), random_states(100, 2, 7)
    for payload in (0.15, 0.6):
        expected = true_outputs(ARM, motion, payload)[output]
        both = np.column_stack([motion, np.full(100, payload)])
        assert np.abs(model.predict(both) - expected).max() < 1e-6 * np.abs(expected).max()
        if payload > RANGE[1]:
            with pytest.warns(TudorWarning, match='extrapolates'):
                plain = model.at(payload)
        else:
            plain = model.at(payload)
        assert np.abs(plain.predict(motion) - model.predict(both)).max() < 1e-9


def test_no_parameter_too_many() -> None:
    """A payload adds four parameters to the five of a planar arm's motion, and no friction."""
    base = fitted('effort').base_[0]
    columns = [PayloadRegressor(EffortRegressor(ARM), ARM, RANGE).columns[i] for i in base.kept]
    carried = [name for name in columns if name.startswith('payload*')]
    assert {name.removeprefix('payload*') for name in carried} == {
        'Izz(j2)', 'mx(j2)', 'my(j2)', 'm(j2)'}
    assert not any('viscous' in name for name in carried)


def test_elm_with_a_payload_put_in() -> None:
    """The payload as a constant in the biases gives what it gives as an input, clipped too."""
    model = ExtremeLearningMachine(ARM.active_joints, payload_range=RANGE, hidden=30)
    model.fit(*training('effort'))
    motion = random_states(50, 2, 9)
    for payload in (0.0, 0.3):
        both = np.column_stack([motion, np.full(50, payload)])
        assert np.abs(model.at(payload).predict(motion) - model.predict(both)).max() < 1e-9
    with pytest.warns(TudorWarning, match='extrapolates'):
        beyond = model.at(0.9).predict(motion)
    assert np.allclose(beyond, model.at(0.4).predict(motion))


def test_a_bundle_keeps_the_payload(tmp_path: Path) -> None:
    """Saved, read and put in, a model says the same; the range is known."""
    elm = ExtremeLearningMachine(ARM.gauge_names, payload_range=RANGE, hidden=20)
    elm.fit(*training('strain'))
    bundle = ModelBundle(ARM, PreprocessingSpec(), {
        'effort': {'analytical': fitted('effort')},
        'strain': {'analytical': fitted('strain'), 'elm': elm}})
    save_bundle(bundle, tmp_path / 'model')
    found = load_bundle(tmp_path / 'model')
    assert found.payload_range == RANGE and found.mass_at(0.3) == 0.3
    text = (tmp_path / 'model' / 'model.yaml').read_text()
    assert 'kg m / kg' in text and 'payload_range: [0.0, 0.4]' in text
    motion, plain = random_states(20, 2, 3), found.at(0.25)
    assert plain.payload_range is None
    for output, kinds in bundle.models.items():
        for kind, model in kinds.items():
            assert np.allclose(plain.models[output][kind].predict(motion),
                               model.at(0.25).predict(motion), rtol=0, atol=1e-9)


def of_one(*stated: object) -> ModelBundle:
    """Give a bundle of a plain model, with what each training bag says of its payload."""
    bags = [{'bag': f'run{k}'} | ({} if mass is None else {'payload': mass})
            for k, mass in enumerate(stated)]
    motion = random_states(300, 2, 0)
    model = AnalyticalModel(EffortRegressor(ARM), 2).fit(
        motion, true_outputs(ARM, motion, 0.2)['effort'])
    return ModelBundle(ARM, PreprocessingSpec(), {'effort': {'analytical': model}},
                       {'training': bags})


@pytest.mark.parametrize(('stated', 'known'), [
    ((0.2, 0.2), 0.2), ((0,), 0.0), ((0.2, None), None), ((0.0, 0.4), None),
    (('0.2',), None), ((float('nan'),), None), ((), None)])
def test_payload_of_a_model_of_one(stated: tuple, known: float | None, tmp_path: Path) -> None:
    """It is what all its bags say, also when read back; nothing is guessed."""
    save_bundle(of_one(*stated), tmp_path / 'model')
    assert load_bundle(tmp_path / 'model').payload == known
    assert of_one(*stated).payload == known


def test_a_model_of_one_payload_takes_that() -> None:
    """Its own payload and none are taken as they are; another is refused, with what to do."""
    bundle = of_one(0.2, 0.2)
    assert bundle.at(0.2) is bundle and bundle.at(0.0) is bundle
    assert bundle.mass_at(0.0) == 0.2 and of_one(None).mass_at(0.0) == 0.0
    with pytest.raises(ModelError, match=r'of 0\.3 kg, .*of 0\.2 kg; give that.*--payload-of'):
        bundle.at(0.3)
    with pytest.raises(ModelError, match=r'unknown mass; give none.*--payload-of'):
        of_one(None).at(0.2)
    for facts in ({}, {'training': 'bags'}, {'training': [3]}):
        assert ModelBundle(ARM, PreprocessingSpec(), bundle.models, facts).payload is None
    assert ModelBundle(ARM, PreprocessingSpec(), {'effort': {'analytical': fitted('effort')}},
                       bundle.facts).payload is None


def test_what_cannot_be() -> None:
    """A payload for a model that knows of none, a negative one, and a model without fit."""
    plain = ModelBundle(ARM, PreprocessingSpec(), {'effort': {'analytical': fitted('effort').at(
        0.0)}})
    assert plain.at(0.0) is plain
    with pytest.raises(ModelError, match='one load'):
        plain.at(0.2)
    with pytest.raises(FitError, match='kg: give 0 or more'):
        fitted('effort').at(-0.1)
    with pytest.raises(NotFittedError):
        ExtremeLearningMachine(ARM.active_joints, payload_range=RANGE).at(0.1)
    with pytest.raises(NotFittedError):
        AnalyticalModel(PayloadRegressor(EffortRegressor(ARM), ARM, RANGE), 2).at(0.1)
