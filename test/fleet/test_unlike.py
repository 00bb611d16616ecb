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

"""Robust comparison of arms: what is named, and how seldom somebody is named for nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.fleet.comparison import day_scatter, drifts, History, outliers

OWN, ERROR = 0.05, 0.03
"""Scatter from arm to arm, and standard error of a value."""


def fleet(seed: int, arms: int = 8, dates: int = 4, scatter: float = 1.5) -> list[History]:
    """Draw arms that are alike; values scatter more from date to date than their errors tell."""
    generator = np.random.default_rng(seed)
    days = 30.0 * np.arange(dates)
    return [History(days, generator.normal(1.0, OWN) + scatter * ERROR * generator.normal(
        size=dates), np.full(dates, ERROR)) for _ in range(arms)]


@pytest.mark.parametrize('arms', [4, 8, 16])
def test_few_are_named_for_nothing(arms: int) -> None:
    """In a hundred fleets of arms that are alike, at most two name anybody."""
    for found in (outliers, drifts):
        false = sum(any(item is not None and item.named for item in found(fleet(seed, arms)))
                    for seed in range(100))
        assert false <= 2


def test_who_differs_is_named() -> None:
    """Half as much again stands out, also where another arm drifts meanwhile."""
    found = drifting = 0
    for seed in range(50):
        series = fleet(seed)
        series[2].values[:] *= 1.6
        series[5].values[:] *= np.linspace(1.0, 1.5, 4)
        level, drift = outliers(series)[2], drifts(series)[5]
        assert level is not None and drift is not None
        found, drifting = found + level.named, drifting + drift.named
        assert level.value > level.expected and drift.value > drift.expected
    assert found >= 35 and drifting >= 45


def test_little_is_not_named_however_certain() -> None:
    """Five percent are nothing to mend."""
    days = np.array([0.0, 30.0, 60.0])
    series = [History(days, np.full(3, value), np.full(3, 1e-6))
              for value in (1.0, 1.0, 1.0, 1.0, 1.05)]
    series.append(History(days, np.array([1.0, 1.025, 1.05]), np.full(3, 1e-6)))
    for told in (outliers(series), drifts(series)):
        assert not any(item is not None and item.named for item in told)
    last = outliers(series)[4]
    assert last is not None and last.sigmas > 100.0


def test_scatter_from_date_to_date_counts() -> None:
    """It is found from all arms, and widens the errors of each."""
    assert day_scatter(fleet(0, arms=200, scatter=3.0)) == pytest.approx(3.0, rel=0.15)
    assert day_scatter(fleet(0, arms=200, scatter=0.5)) == 1.0


def test_too_few_are_not_compared() -> None:
    """Three arms and two dates say nothing of who is unlike."""
    assert outliers(fleet(0, arms=3)) == [None] * 3
    assert drifts(fleet(0, dates=2)) == [None] * 8
