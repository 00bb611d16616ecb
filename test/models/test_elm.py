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

"""The extreme learning machine: equations, seed, normalisation, inputs beyond the training."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.errors import FitError
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.signals.preprocessing import Decimation, TrainingBlock
from tudor_dynamics.typing import FloatArray

CHANNELS = ('a', 'b')


def _data(n: int = 300) -> tuple[FloatArray, FloatArray]:
    generator = np.random.default_rng(0)
    motion = generator.uniform(-1, 1, (n, 6)) * [1, 1, 2, 2, 50, 50] + 3.0
    return motion, np.column_stack(
        [np.sin(motion[:, 0]) * 400.0, 0.01 * motion[:, 4] + motion[:, 1]])


def _scaled(x: FloatArray, reference: FloatArray) -> FloatArray:
    low, high = reference.min(axis=0), reference.max(axis=0)
    return np.asarray((2 * x - low - high) / (high - low))


def test_equations() -> None:
    """
    Outputs are those of Malzahn et al., Eqs. (16) and (17), for the same hidden weights.

    The equations are written out here once more, with an explicit inverse as the paper has it;
    ridge 1e-2 keeps that inverse accurate.
    """
    motion, output = _data()
    elm = ExtremeLearningMachine(CHANNELS, hidden=30, ridge=1e-2, seed=4).fit(motion, output)
    hidden = 1.0 / (1.0 + np.exp(-(_scaled(motion, motion) @ elm.input_weights_ + elm.biases_)))
    target = _scaled(output, output)
    weights = np.linalg.inv(hidden.T @ hidden + 1e-2 * np.eye(30)) @ hidden.T @ target
    assert elm.output_weights_ is not None
    assert np.allclose(elm.output_weights_, weights, rtol=1e-6, atol=1e-8)
    low, high = output.min(axis=0), output.max(axis=0)
    expected = ((hidden @ weights) * (high - low) + low + high) / 2
    assert np.allclose(elm.predict(motion), expected, rtol=1e-8)


def test_settings_of_the_paper() -> None:
    """H = 100, lambda = 1e-6, weights and biases uniform in [-1, 1]."""
    elm = ExtremeLearningMachine(CHANNELS).fit(*_data())
    assert (elm.hidden, elm.ridge) == (100, 1e-6)
    for values in (elm.input_weights_.ravel(), elm.biases_):
        assert np.max(np.abs(values)) <= 1.0
        assert abs(values.mean()) < 0.25
        assert values.std() == pytest.approx(1 / np.sqrt(3), rel=0.2)
    assert elm.input_weights_.shape == (6, 100)


def test_learns() -> None:
    """A smooth function is learned well where it was shown."""
    motion, output = _data(1000)
    elm = ExtremeLearningMachine(CHANNELS).fit(motion[:700], output[:700])
    error = elm.predict(motion[700:]) - output[700:]
    assert np.all(error.std(axis=0) < 0.05 * output.std(axis=0))


def test_seed() -> None:
    """The same seed gives the same model, another one another hidden layer."""
    motion, output = _data()
    one, same, other = (ExtremeLearningMachine(CHANNELS, seed=seed).fit(motion, output)
                        for seed in (1, 1, 2))
    assert np.array_equal(one.predict(motion), same.predict(motion))
    assert not np.allclose(one.input_weights_, other.input_weights_)


def test_units_do_not_matter() -> None:
    """Inputs and outputs are normalised: in other units the model is the same."""
    motion, output = _data()
    factor, scale = np.array([1e3, 1.0, 57.3, 1.0, 1e-3, 1.0]), np.array([1e-6, 1e3])
    plain = ExtremeLearningMachine(CHANNELS, ridge=1e-3).fit(motion, output)
    scaled = ExtremeLearningMachine(CHANNELS, ridge=1e-3).fit(motion * factor, output * scale)
    assert np.allclose(scaled.predict(motion * factor), plain.predict(motion) * scale, rtol=1e-6)


def test_constant_input_and_output() -> None:
    """A joint that never moves gives no division by zero; a constant output stays constant."""
    motion, output = _data()
    motion[:, 1], output[:, 1] = 0.7, 5.0
    elm = ExtremeLearningMachine(CHANNELS).fit(motion, output)
    found = elm.predict(motion)
    assert np.all(np.isfinite(found))
    assert np.allclose(found[:, 1], 5.0)
    moved = motion.copy()
    moved[:, 1] = 9.0
    assert np.array_equal(elm.predict(moved), found)


def test_clip() -> None:
    """Inputs beyond the training are brought back to its edge; those within are left alone."""
    motion, output = _data()
    clipped = ExtremeLearningMachine(CHANNELS).fit(motion, output)
    free = ExtremeLearningMachine(CHANNELS, clip=False).fit(motion, output)
    assert np.array_equal(clipped.predict(motion), free.predict(motion))
    spike = motion[:5].copy()
    spike[:, 4] = [1e3, -1e3, 60.0, 1e9, -60.0]
    edge = spike.copy()
    edge[:, 4] = np.clip(spike[:, 4], motion[:, 4].min(), motion[:, 4].max())
    assert np.allclose(clipped.predict(spike), clipped.predict(edge), rtol=1e-12)
    assert np.max(np.abs(free.predict(spike) - free.predict(edge))) > 1.0


def test_decimated_blocks() -> None:
    """Filtered decimation goes over the hidden layer as over the outputs; ranges are of both."""
    t = np.arange(600) * 0.01
    motion = np.sin(t[:, None] * np.arange(1, 7))
    output = np.column_stack([motion[:, 0] * motion[:, 1], motion[:, 2]])
    keep = np.arange(0, 600, 2)
    decimation = Decimation(keep, np.array([[0.25, 0.0, 0.0]]))
    block = TrainingBlock(motion, decimation(output), decimation)
    elm = ExtremeLearningMachine(CHANNELS, ridge=1e-4).fit_blocks(lambda: [block])
    low, high = block.output.min(axis=0), block.output.max(axis=0)
    assert np.allclose(elm.output_range_, [low, high])
    assert np.allclose(elm.input_range_[0], motion[keep].min(axis=0))
    error = decimation(elm.predict(motion)) - block.output
    assert np.max(error.std(axis=0) / block.output.std(axis=0)) < 0.01


@pytest.mark.parametrize('settings', [{'hidden': 0}, {'ridge': -1.0}, {'ridge': float('nan')}])
def test_impossible_settings(settings: dict[str, float]) -> None:
    """No neurons, or a ridge that is none, are refused."""
    (name, value), = settings.items()
    expected = rf'^elm_{name}= {value}: give [01] or more'
    with pytest.raises(FitError, match=expected):
        ExtremeLearningMachine(CHANNELS, **settings).fit(*_data())  # type: ignore[arg-type]


def test_singular_hidden_layer() -> None:
    """Without a ridge, fewer samples than neurons cannot be solved; the message says how."""
    motion, output = _data(20)
    with pytest.raises(FitError, match='singular with ridge 0.0; use a ridge above 0'):
        ExtremeLearningMachine(CHANNELS, ridge=0.0).fit(motion, output)


def test_no_data() -> None:
    """Nothing cannot be learned from."""
    with pytest.raises(FitError, match='no training data'):
        ExtremeLearningMachine(CHANNELS).fit_blocks(lambda: [])
