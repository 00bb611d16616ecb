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

"""Scikit-learn's habits, the same for every model: fit, predict, refit, refusals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sample_arms import gauge, planar_arm, random_states

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, NotFittedError, TudorError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.signals.preprocessing import Decimation, TrainingBlock
from tudor_dynamics.typing import FloatArray

ARM = planar_arm(gauges=[gauge('g1', 'j1', 0.1), gauge('g2', 'j2', 0.1)])

MAKERS: dict[str, tuple[str, Callable[[], Any]]] = {
    'effort': ('analytical', lambda: AnalyticalModel(EffortRegressor(ARM), 2)),
    'strain': ('analytical', lambda: AnalyticalModel(StrainRegressor(ARM), 2)),
    'paper': ('analytical', lambda: AnalyticalModel(StrainRegressor(ARM, 'paper'), 2)),
    'huber': ('analytical', lambda: AnalyticalModel(EffortRegressor(ARM), 2, estimator='huber')),
    'elm': ('elm', lambda: ExtremeLearningMachine(('j1', 'j2'), hidden=20)),
}


@pytest.fixture(params=list(MAKERS))
def make(request: pytest.FixtureRequest) -> Callable[[], Any]:
    """Give a maker of fresh models of one kind."""
    return MAKERS[request.param][1]


def _data(seed: int, n: int = 400) -> tuple[FloatArray, FloatArray]:
    motion = random_states(n, 2, seed)
    regressor = EffortRegressor(ARM)
    truth = np.random.default_rng(5).uniform(0.5, 1, len(regressor.columns))
    noise = np.random.default_rng(seed + 100).normal(0, 0.1, (n, 2))
    return motion, regressor.rows(motion) @ truth + noise


def test_fit_returns_self_and_refit_forgets(make: Callable[[], Any]) -> None:
    """A second fit is as if there had been no first one; the same data give the same model."""
    model = make()
    assert model.fit(*_data(0)) is model
    other, _ = _data(2)
    first = model.predict(other)
    model.fit(*_data(1))
    assert np.array_equal(model.predict(other), make().fit(*_data(1)).predict(other))
    assert not np.array_equal(model.predict(other), first)


def test_predict_before_fit(make: Callable[[], Any]) -> None:
    """A model that knows nothing says so, by an error that is also the builtin ones."""
    for kind in (NotFittedError, AttributeError, ValueError, TudorError):
        with pytest.raises(kind, match='fit it, or load'):
            make().predict(np.zeros((3, 6)))


def test_inputs_are_left_alone(make: Callable[[], Any]) -> None:
    """Neither fit nor predict writes to what it is given; a prediction is the caller's own."""
    motion, output = _data(0)
    copies = motion.copy(), output.copy()
    motion.flags.writeable = output.flags.writeable = False
    model = make().fit(motion, output)
    first = model.predict(motion)
    kept = first.copy()
    first[:] = 0.0
    assert np.array_equal(model.predict(motion), kept)
    assert np.array_equal(motion, copies[0]) and np.array_equal(output, copies[1])


def test_blocks_are_the_whole(make: Callable[[], Any]) -> None:
    """Blocks of any size, decimated ones included, give the model of the whole arrays."""
    motion, output = _data(0, 3000)
    kept = np.arange(3000) % 3 == 0
    expected = make().fit(motion[kept], output[kept])

    def blocks() -> list[TrainingBlock]:
        edges = [0, 3, 600, 2997, 3000]
        return [TrainingBlock(motion[a:b], output[a:b:3], Decimation(np.arange(0, b - a, 3)))
                for a, b in zip(edges[:-1], edges[1:])]

    found = make().fit_blocks(blocks)
    other = random_states(600, 2, seed=9)
    scale = np.max(np.abs(expected.predict(other)))
    assert np.allclose(found.predict(other), expected.predict(other), rtol=0, atol=1e-6 * scale)


def test_rows_do_not_depend_on_their_neighbours(make: Callable[[], Any]) -> None:
    """A sample is predicted alone as it is among thousands."""
    model = make().fit(*_data(0))
    motion = random_states(2100, 2, seed=3)
    whole = model.predict(motion)
    assert whole.shape == (2100, 2)
    for k in (0, 511, 512, 2099):
        assert np.allclose(model.predict(motion[k:k + 1]), whole[k], rtol=1e-12)
    assert model.predict(np.zeros((0, 6))).shape == (0, 2)


@pytest.mark.parametrize(('motion', 'output', 'message'), [
    (np.zeros((50, 6)), np.zeros((49, 2)), r'motion has shape \(50, 6\) and output \(49, 2\)'),
    (np.zeros(50), np.zeros((50, 2)), r'motion has shape \(50,\)'),
    (np.zeros((50, 6)), np.zeros(50), r'output \(50,\)'),
    (np.zeros((50, 6)), np.zeros((50, 3)), r'output has shape \(50, 3\); expected .*, 2\)'),
    (np.zeros((50, 6)), np.zeros((50, 1)), r'output has shape \(50, 1\); expected .*, 2\)'),
    (np.full((50, 6), np.nan), np.zeros((50, 2)), 'NaN or infinite'),
    (np.zeros((50, 6)), np.full((50, 2), np.inf), 'NaN or infinite')])
def test_fit_refuses(
    make: Callable[[], Any], motion: FloatArray, output: FloatArray, message: str,
) -> None:
    """Shapes that do not belong together, and values that are no numbers, are refused."""
    with pytest.raises(FitError, match=message):
        make().fit(motion, output)


def test_another_arm_is_refused(make: Callable[[], Any]) -> None:
    """Motion of three joints is not cut down to two."""
    model = make().fit(*_data(0))
    with pytest.raises(FitError, match=r'motion has shape \(4, 9\); expected \(n_samples, 6\)'):
        model.predict(np.zeros((4, 9)))
    with pytest.raises(FitError, match=r'motion has shape \(6,\)'):
        model.predict(np.zeros(6))


def test_failed_fit_leaves_no_mixture(make: Callable[[], Any]) -> None:
    """After a fit that broke off the model predicts as before, or not at all."""
    model = make().fit(*_data(0))
    motion, output = _data(1)
    before = model.predict(motion)
    calls = 0

    def broken() -> list[TrainingBlock]:
        nonlocal calls
        calls += 1
        if calls == 2 or not isinstance(model, ExtremeLearningMachine):
            raise OSError
        return [TrainingBlock(100.0 * motion, output)]

    with pytest.raises(OSError):
        model.fit_blocks(broken)
    try:
        assert np.array_equal(model.predict(motion), before)
    except NotFittedError:
        assert isinstance(model, ExtremeLearningMachine)


@pytest.mark.parametrize('name', list(MAKERS))
def test_saved_and_loaded(name: str, tmp_path: Any) -> None:
    """A model predicts to the last bit the same after it was saved and loaded."""
    kind, maker = MAKERS[name]
    output = 'strain' if name in ('strain', 'paper') else 'effort'
    model = maker().fit(*_data(0))
    save_bundle(ModelBundle(ARM, _spec(ARM), {output: {kind: model}}), tmp_path / 'model')
    loaded = load_bundle(tmp_path / 'model', arm=ARM).models[output][kind]
    motion = random_states(100, 2, seed=4)
    assert np.array_equal(loaded.predict(motion), model.predict(motion))
    assert loaded.channels == model.channels


@pytest.mark.parametrize('name', list(MAKERS))
def test_nothing_to_save(name: str, tmp_path: Any) -> None:
    """A model that was not fitted is not saved."""
    kind, maker = MAKERS[name]
    output = 'strain' if name in ('strain', 'paper') else 'effort'
    with pytest.raises(NotFittedError):
        save_bundle(ModelBundle(ARM, _spec(ARM), {output: {kind: maker()}}), tmp_path / 'model')
    assert list(tmp_path.iterdir()) == []


def _spec(arm: Arm) -> Any:
    return arm.spec.preprocessing
