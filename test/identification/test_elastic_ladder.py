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

"""Searches whose answer is known: straight, bent, bounded, and with nowhere to go."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.optimize import lsq_linear

from tudor_dynamics.identification.elastic_search import LADDER, LONGER, minimised
from tudor_dynamics.typing import FloatArray

ANYWHERE = (np.full(3, -np.inf), np.full(3, np.inf))
MATRIX = np.random.default_rng(2).normal(size=(50, 3)) * 1e3
TARGET = np.random.default_rng(3).normal(size=50) * 1e3


def straight(several: Sequence[FloatArray]) -> list[FloatArray]:
    """Give a linear problem's residuals."""
    return [MATRIX @ x - TARGET for x in several]


def test_a_straight_problem_takes_one_step() -> None:
    """As far as the least damping lets it."""
    found = minimised(straight, lambda _: MATRIX, np.zeros(3), ANYWHERE, np.ones(3), steps=1,
                      enough=1e-9)
    assert_allclose(found, np.linalg.lstsq(MATRIX, TARGET, rcond=None)[0], rtol=1e-5)


def test_slopes_that_are_too_steep_do_not_shorten_steps() -> None:
    """Twice the slopes ask for half of the way; the other half is not left to the next step."""
    found = minimised(straight, lambda _: 2.0 * MATRIX, np.zeros(3), ANYWHERE, np.ones(3), steps=1,
                      enough=1e-9)
    assert_allclose(found, np.linalg.lstsq(MATRIX, TARGET, rcond=None)[0], rtol=1e-5)


def test_bounds() -> None:
    """What a bound stops stays there, and the others do what is best beside it."""
    free = np.linalg.lstsq(MATRIX, TARGET, rcond=None)[0]
    bounds = (free - np.array([1.0, 1.0, -0.1]), free + 1.0)
    begin = np.clip(np.zeros(3), *bounds)
    found = minimised(straight, lambda _: MATRIX, begin, bounds, np.ones(3), steps=5, enough=1e-12)
    expected = lsq_linear(MATRIX, TARGET, bounds, method='bvls').x
    assert_allclose(found, expected, rtol=1e-4)
    assert found[2] == pytest.approx(bounds[0][2])


def bent(x: FloatArray) -> FloatArray:
    """Rosenbrock's valley, and a third unknown of another scale."""
    return np.array([10.0 * (x[1] - x[0]**2), 1.0 - x[0], 1e-3 * (x[2] - 500.0)])


def bent_slopes(x: FloatArray) -> FloatArray:
    """Its derivatives."""
    return np.array([[-20.0 * x[0], 10.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1e-3]])


def test_a_bent_valley() -> None:
    """The sum of squares never rises from step to step, and ends at nothing."""
    begin, costs = np.array([-1.2, 1.0, 0.0]), []
    for steps in range(60):
        found = minimised(lambda several: [bent(x) for x in several], bent_slopes, begin, ANYWHERE,
                          np.array([1.0, 1.0, 1e3]), steps=steps, enough=0.0)
        costs.append(float(bent(found) @ bent(found)))
    assert all(later <= sooner for sooner, later in zip(costs, costs[1:], strict=False))
    assert costs[-1] < 1e-6


def test_where_nothing_can_be_computed_steps_get_shorter() -> None:
    """Beyond a wall everything is hopeless: the search comes close to it all the same."""
    asked = []

    def walled(several: Sequence[FloatArray]) -> list[FloatArray]:
        asked.append(len(several))
        return [np.array([1e3]) if abs(x[0]) > 1e-3 else np.array([1.0 - 100.0 * x[0]])
                for x in several]

    one = np.ones(1)
    found = minimised(walled, lambda _: np.array([[-100.0]]), np.zeros(1), (-one, one), one,
                      steps=8, enough=1e-9)
    assert 2e-4 < found[0] <= 1e-3
    assert set(asked) == {1, len(LADDER) + len(LONGER)}
