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

"""Figures of a prediction against their formulas."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.validation import score


def test_formulas() -> None:
    """
    Figures worked out by hand for four samples of two channels.

    Errors are (1, 0), (-1, 0), (0, 2), (0, -2): squares sum to 10, norms are 1, 1, 2, 2.
    Deviations from the means (2.5 and 0): 5 and 20. Predictions from the measured means:
    (-2.5, -1), (0.5, 2), (0.5, -4), (1.5, 3), squares 9 + 30. Measured squares: 30 and 20.
    """
    measured = np.array([[1.0, -1.0], [2.0, 2.0], [3.0, -2.0], [4.0, 1.0]]) * [1, 1]
    measured[:, 1] *= np.sqrt(2.0)
    predicted = measured - [[1, 0], [-1, 0], [0, 2], [0, -2]]
    found = score(measured, predicted, ('a', 'b'))
    assert found.samples == 4
    assert found.rmse == pytest.approx(np.sqrt(10 / 8))
    assert found.sigma_e == pytest.approx(0.5)
    assert found.fit == pytest.approx(100 * (1 - np.sqrt(10 / 25)))
    b = np.sqrt(2.0)
    printed = (2.5 ** 2 + 0.5 ** 2 + 0.5 ** 2 + 1.5 ** 2
               + b ** 2 + (2 * b) ** 2 + (2 * b + 2) ** 2 + (b + 2) ** 2)
    assert found.fit_printed == pytest.approx(100 * (1 - np.sqrt(10 / printed)))
    assert found.relative_error == pytest.approx(np.sqrt(10 / 50))
    assert found.channels['a'].rmse == pytest.approx(np.sqrt(0.5))
    assert found.channels['a'].fit == pytest.approx(100 * (1 - np.sqrt(2 / 5)))
    assert found.channels['b'].relative_error == pytest.approx(np.sqrt(8 / 20))
    assert found.as_dict()['channels']['b']['rmse'] == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize('noise', [0.1, 0.5, 2.0])
def test_printed_fit_and_fit(noise: float) -> None:
    """
    For least squares with a bias on its own training data the two fits determine each other.

    Pythagoras: |yhat - mean|^2 = |y - mean|^2 - |e|^2; with k = 1 - printed / 100 the fit is
    100 (1 - k / sqrt(1 + k^2)), and never smaller than the printed one.
    """
    generator = np.random.default_rng(0)
    x = np.column_stack([generator.normal(0, 1, (200, 2)), np.ones(200)])
    y = x @ [[1.0], [2.0], [3.0]] + generator.normal(0, noise, (200, 1))
    found = score(y, x @ np.linalg.lstsq(x, y, rcond=None)[0], ('a',))
    k = 1 - found.fit_printed / 100
    assert found.fit == pytest.approx(100 * (1 - k / np.sqrt(1 + k * k)), rel=1e-9)
    assert found.fit > found.fit_printed


def test_published_pairs() -> None:
    """
    The relation gives the pairs that belong to figures printed by Malzahn et al., Table I.

    91.44 -> 91.47, 61.28 -> 63.89; made here of an error and a prediction at right angles.
    """
    for printed, fit in ((91.44, 91.47), (61.28, 63.89)):
        predicted = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
        error = (1 - printed / 100) * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
        found = score(predicted + error, predicted, ('a',))
        assert found.fit_printed == pytest.approx(printed, abs=1e-9)
        assert found.fit == pytest.approx(fit, abs=0.005)


@pytest.mark.parametrize('level', [0.0, 0.1, 1e6 / 3])
def test_constant_channel(level: float) -> None:
    """A channel that stands still has no fit, met or missed; nor has a bag without any other."""
    measured = np.column_stack([np.full(1001, level), np.linspace(0, 1, 1001)])
    met = score(measured, measured, ('a', 'b'))
    missed = score(measured, measured + 0.01, ('a', 'b'))
    for found in (met, missed):
        assert np.isnan(found.channels['a'].fit)
        assert np.isfinite(found.fit) and found.channels['b'].fit > 95
    alone = score(measured[:, :1], measured[:, :1], ('a',))
    assert np.isnan(alone.fit) and np.isnan(alone.fit_printed)


def test_refusals() -> None:
    """Shapes that differ, and nothing at all, cannot be judged."""
    for measured, predicted in ((np.zeros((3, 2)), np.zeros((3, 1))), (np.zeros(3), np.zeros(3)),
                                (np.zeros((0, 2)), np.zeros((0, 2)))):
        with pytest.raises(FitError, match='expected two equal shapes'):
            score(measured, predicted, ('a', 'b'))
