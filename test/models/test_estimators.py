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

"""Estimators: accumulated products against plain least squares, weights, errors, robustness."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.errors import FitError, TudorWarning
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation import (
    ESTIMATORS, huber_weights, LARGEST_GRAM_CONDITION, Products, solve, squared_residuals)
from tudor_dynamics.models.regressor import Regressor
from tudor_dynamics.signals.preprocessing import Decimation, TrainingBlock
from tudor_dynamics.typing import FloatArray


class Linear(Regressor):
    """Rows that are the motion of one joint itself: parameters can be seen directly."""

    columns = ('q', 'dq', 'ddq')
    scaled = np.zeros(3, dtype=bool)

    def __init__(self, n_channels: int = 1) -> None:
        self.channels = tuple('abcd'[:n_channels])
        self.groups = (tuple(range(n_channels)),)

    def rows(self, motion: FloatArray, out: FloatArray | None = None) -> FloatArray:
        """Repeat the motion for each channel."""
        rows = np.repeat(motion[:, None, :], len(self.channels), axis=1)
        if out is None:
            return rows
        out[:] = rows
        return out

    def outputs(self, motion: FloatArray, parameters: FloatArray) -> FloatArray:
        """Give rows times parameters."""
        return np.einsum('kcp,cp->kc', self.rows(motion), parameters)


TRUTH = np.array([2.0, -1.0, 0.5])


def _linear(n_channels: int = 1, estimator: str = 'wls') -> AnalyticalModel:
    return AnalyticalModel(Linear(n_channels), 1, estimator=estimator)


def _products(x: FloatArray, y: FloatArray, *, triangular: bool = False) -> Products:
    products = Products.empty(x.shape[1], triangular=triangular)
    for part in np.array_split(np.arange(len(x)), 3):
        products.add(x[part], y[part])
    return products


@pytest.mark.parametrize('triangular', [False, True])
@pytest.mark.parametrize('weighted', [False, True])
def test_one_channel_is_plain_least_squares(triangular: bool, weighted: bool) -> None:
    """Parameters, residual variance and standard errors are those of numpy's lstsq."""
    generator = np.random.default_rng(0)
    x = generator.normal(0, [1.0, 100.0, 0.01, 1.0], (200, 4))
    y = x @ np.array([1.0, -0.02, 30.0, 4.0]) + generator.normal(0, 0.3, 200)
    expected, rss, _, _ = np.linalg.lstsq(x, y, rcond=None)
    variance = rss[0] / (200 - 4)
    errors = np.sqrt(np.diag(np.linalg.inv(x.T @ x)) * variance)
    found = solve([_products(x, y, triangular=triangular)], weighted=weighted)
    assert np.allclose(found.parameters, expected, rtol=1e-10)
    assert found.variances[0] == pytest.approx(variance, rel=1e-9)
    assert np.allclose(found.standard_errors, errors, rtol=1e-8)
    assert found.unexcited == ()
    scaled = x / np.linalg.norm(x, axis=0)
    assert found.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-6)


def test_triangular_factors_where_the_gram_matrix_fails() -> None:
    """Columns equal to 1e-8 are told apart by the triangular path, which takes over by itself."""
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (2000, 3))
    motion[:, 1] = motion[:, 0] + 1e-8 * motion[:, 1]
    y = motion @ TRUTH
    expected = np.linalg.lstsq(motion, y, rcond=None)[0]
    gram = solve([_products(motion, y)])
    assert gram.condition > LARGEST_GRAM_CONDITION
    assert np.max(np.abs(gram.parameters - TRUTH)) > 0.1
    model = _linear().fit(motion, y[:, None])
    group, = model.groups_
    found = group.estimate.parameters[np.argsort(group.base.kept)]
    assert np.allclose(expected, TRUTH, atol=1e-4)
    assert np.allclose(found, TRUTH, atol=1e-4)
    assert group.estimate.unexcited == ()
    # singular values of two unit columns 1e-8 apart: sqrt(2) and 1e-8 / sqrt(2)
    assert group.estimate.condition == pytest.approx(2e8, rel=0.1)


def test_weights_by_channel() -> None:
    """
    With channels of unlike noise the weighted estimate is better, and knows how good it is.

    300 repetitions of two channels with noise 0.02 and 1.0; the spread of the estimates is what
    the standard errors say, within 15 % (the spread itself is known to 4 %).
    """
    generator = np.random.default_rng(0)
    x = [generator.normal(0, size, (60, 3)) for size in ([1, 1, 1], [4, 0.5, 1])]
    found: dict[bool, list[FloatArray]] = {False: [], True: []}
    errors: dict[bool, list[FloatArray]] = {False: [], True: []}
    for _ in range(300):
        products = [_products(a, a @ TRUTH + generator.normal(0, s, 60))
                    for a, s in zip(x, (0.02, 1.0))]
        for weighted in (False, True):
            estimate = solve(products, weighted=weighted)
            found[weighted].append(estimate.parameters)
            errors[weighted].append(estimate.standard_errors)
    spread = {key: np.std(value, axis=0) for key, value in found.items()}
    assert np.all(spread[True] < 0.1 * spread[False])
    for key in (False, True):
        assert np.allclose(np.mean(errors[key], axis=0), spread[key], rtol=0.15)
        assert np.allclose(np.mean(found[key], axis=0), TRUTH, atol=5 * spread[key] / 17)


def test_a_channel_without_noise_does_not_silence_the_others() -> None:
    """A channel that is fitted exactly, a dead one, gets no endless weight."""
    generator = np.random.default_rng(0)
    x = generator.normal(0, 1, (400, 3))
    products = [_products(x * [1, 0, 0], np.zeros(400)),
                _products(x * [0, 1, 1], x @ [0, -1.0, 0.5] + generator.normal(0, 1, 400))]
    estimate = solve(products)
    assert estimate.unexcited == ()
    assert estimate.parameters[0] == 0.0
    assert np.all(np.abs(estimate.parameters[1:] - [-1.0, 0.5]) < 0.2)
    assert np.allclose(estimate.standard_errors[1:], 0.05, rtol=0.2)


def test_huber_resists_outliers() -> None:
    """Five per cent of gross errors hardly move Huber's estimate, and move the plain one."""
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (2000, 3))
    y = (motion @ TRUTH)[:, None] + generator.normal(0, 0.05, (2000, 1))
    bad = generator.random(2000) < 0.05
    y[bad] += generator.normal(20, 20, (int(bad.sum()), 1)) * np.sign(motion[bad, :1])
    plain = np.max(np.abs(_linear(estimator='ols').fit(motion, y).coefficients()[0] - TRUTH))
    robust = np.max(np.abs(_linear(estimator='huber').fit(motion, y).coefficients()[0] - TRUTH))
    assert plain > 0.3
    assert robust < 0.02


@pytest.mark.parametrize('estimator', ESTIMATORS)
def test_every_estimator_finds_the_truth(estimator: str) -> None:
    """In noise, each finds parameters within a few of the standard errors that it reports."""
    generator = np.random.default_rng(1)
    motion = generator.normal(0, 1, (2000, 3))
    y = (motion @ TRUTH)[:, None] + generator.normal(0, 0.05, (2000, 1))
    group, = _linear(estimator=estimator).fit(motion, y).groups_
    errors = group.estimate.standard_errors
    assert np.all(np.abs(group.estimate.parameters - TRUTH) < 4.0 * errors)
    assert np.allclose(errors, 0.05 / np.sqrt(2000), rtol=0.2)


def test_huber_on_decimated_blocks() -> None:
    """Weights meet the samples they belong to where blocks are decimated, filtered or not."""
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (3000, 3))
    y = (motion @ TRUTH)[:, None] + generator.normal(0, 0.05, (3000, 1))
    keep = np.arange(0, 1000, 3)
    blocks = []
    for i in range(3):
        part = slice(1000 * i, 1000 * (i + 1))
        output = y[part][keep].copy()
        output[i::11] += 30.0
        blocks.append(TrainingBlock(motion[part], output, Decimation(keep)))
    robust = _linear(estimator='huber').fit_blocks(lambda: blocks)
    assert np.max(np.abs(robust.coefficients()[0] - TRUTH)) < 0.03


def test_huber_keeps_triangular_factors() -> None:
    """Where the first pass needs triangular factors, the weighted passes have them too."""
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (1000, 3))
    motion[:, 1] = motion[:, 0] + 1e-8 * motion[:, 1]
    y = (motion @ TRUTH)[:, None] + generator.normal(0, 1e-12, (1000, 1))
    model = _linear(estimator='huber').fit(motion, y)
    estimate = model.groups_[0].estimate
    assert estimate.condition == pytest.approx(2e8, rel=0.1)
    assert np.allclose(model.coefficients()[0], TRUTH, atol=1e-3)


def test_huber_weights() -> None:
    """Within 1.345 robust deviations the weight is 1, beyond it falls with the residual."""
    residuals = np.random.default_rng(0).normal(0, 2.0, 20_000)
    weights = huber_weights(residuals)
    inside = np.abs(residuals) < 1.3 * 2.0
    assert np.all(weights[inside] == 1.0)
    far = np.abs(residuals) > 1.4 * 2.0
    assert np.allclose(weights[far] * np.abs(residuals[far]), 1.345 * 2.0, rtol=0.03)
    assert np.all(huber_weights(np.zeros(5)) == 1.0)


def test_huber_that_does_not_settle_warns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever gets an unfinished estimate is told so."""
    monkeypatch.setattr('tudor_dynamics.models.analytical.WEIGHT_PASSES', 1)
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (100, 3))
    y = motion[:, :1] + generator.standard_t(1, (100, 1))
    with pytest.warns(TudorWarning, match='has not settled after 1 passes'):
        _linear(estimator='huber').fit(motion, y)


@pytest.mark.parametrize(('motion_of', 'lost'), [
    (lambda x: x * [1.0, 1.0, 0.0], {2}),
    (lambda x: np.column_stack([x[:, 0], 2.0 * x[:, 0], x[:, 2]]), {0, 1})])
def test_unexcited_parameters(motion_of: object, lost: set[int]) -> None:
    """What the motion does not show is reported, unknown in size, and harmless elsewhere."""
    generator = np.random.default_rng(0)
    shown = motion_of(generator.normal(0, 1, (300, 3)))  # type: ignore[operator]
    y = (shown @ TRUTH)[:, None] + generator.normal(0, 0.01, (300, 1))
    model = _linear().fit(shown, y)
    group, = model.groups_
    assert {int(group.base.kept[k]) for k in group.estimate.unexcited} == lost
    for k, column in enumerate(group.base.kept):
        assert np.isinf(group.estimate.standard_errors[k]) == (int(column) in lost)
    assert np.max(np.abs(model.predict(shown) - (shown @ TRUTH)[:, None])) < 0.02
    assert np.max(np.abs(model.predict(generator.normal(0, 1, (100, 3))))) < 20.0


@pytest.mark.parametrize('triangular', [False, True])
def test_products_add_up(triangular: bool) -> None:
    """Products of two bags, added, are those of both together; so is the estimate."""
    generator = np.random.default_rng(0)
    motion = generator.normal(0, 1, (300, 3))
    y = motion @ TRUTH[:, None] + generator.normal(0, 0.1, (300, 2))
    model = _linear(2)

    def products(part: slice) -> list[list[Products]]:
        return model.products(lambda: [TrainingBlock(motion[part], y[part])],
                              triangular=triangular)

    both = [[a + b for a, b in zip(one, other)] for one, other in zip(
        products(slice(0, 100)), products(slice(100, None)))]
    whole = products(slice(None))
    for a, b in zip(both[0], whole[0]):
        assert a.n == b.n == 300
        assert np.allclose(a.gram, b.gram, rtol=1e-12)
        if triangular:
            assert a.triangle is not None
            assert np.allclose(a.triangle.T @ a.triangle, b.gram, rtol=1e-10)
    added = model.fit_data([both]).coefficients()
    together = _linear(2).fit(motion, y).coefficients()
    assert np.allclose(added, together, rtol=1e-9)


def test_residuals_from_products() -> None:
    """The residual sum of squares needs no second pass over the data."""
    generator = np.random.default_rng(0)
    x, y = generator.normal(0, 1, (50, 2)), generator.normal(0, 1, 50)
    parameters = np.array([0.3, 0.4])
    expected = np.sum((y - x @ parameters) ** 2)
    for triangular in (False, True):
        product = _products(x, y, triangular=triangular)
        assert squared_residuals(product, parameters) == pytest.approx(expected, rel=1e-12)


def test_refusals() -> None:
    """Too few samples and an unknown estimator are refused with figures."""
    with pytest.raises(FitError, match='3 samples for 3 parameters; record longer'):
        _linear().fit(np.eye(3), np.ones((3, 1)))
    with pytest.raises(FitError, match='0 samples for 3 parameters'):
        _linear().fit_blocks(lambda: [])
    with pytest.raises(FitError, match="unknown estimator 'lasso'; use ols"):
        _linear(estimator='lasso').fit(np.ones((9, 3)), np.ones((9, 1)))
