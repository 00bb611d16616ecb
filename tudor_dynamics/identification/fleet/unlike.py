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

"""
Which arm is unlike the others, and which one drifts: robust statistics with standard errors.

An arm is compared with the median of the others, so that it has no hand in what it is compared
with; their scatter is that of their median absolute deviation, wider where they are few. What
differs by less than a tenth is nothing that anybody would mend, however certain it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.typing import FloatArray

RELEVANT = 0.1
"""Part of a quantity that a difference must be."""
SIGMAS = 5.0
"""Standard errors that it must be: many numbers of many arms are looked at, and errors from few
parts are themselves uncertain."""
FEWEST_OTHERS = 3
"""Arms that an arm is compared with."""
FEWEST_DATES = 3
"""Dates that make a drift."""
FEW = 4.0
"""Widens the scatter of few arms: their median absolute deviation may be small by chance."""


@dataclass(frozen=True, eq=False)
class Series:
    """A quantity of one arm over time."""

    days: FloatArray  # time since the first date of the fleet, (dates,) [d]
    # Values with their standard errors, (dates,).
    values: FloatArray
    errors: FloatArray


@dataclass(frozen=True)
class Difference:
    """How far a number is from what was to be expected."""

    # The number; that of the other arms, or of the first date on the line through all.
    value: float
    expected: float
    sigmas: float  # their difference over its standard error
    named: bool  # whether it is large and certain enough to be named


def unlike(series: Sequence[Series]) -> list[Difference | None]:
    """Compare the levels of arms; returns None where there are too few others."""
    scale = day_scatter(series)
    levels, errors = (np.array(column) for column in zip(
        *(_level(item, scale) for item in series), strict=True))
    found: list[Difference | None] = []
    for i, (level, error) in enumerate(zip(levels.tolist(), errors.tolist(), strict=True)):
        others = np.delete(levels, i)
        n = len(others)
        if n < FEWEST_OTHERS:
            found.append(None)
            continue
        middle = float(np.median(others))
        # the median absolute deviation of few values is small by chance; not below their errors
        spread = max(1.4826 * float(np.median(np.abs(others - middle))),
                     float(np.median(np.delete(errors, i)))) * (1.0 + FEW / n)
        found.append(_difference(level, middle, float(np.hypot(error, spread)), abs(middle)))
    return found


def drifts(series: Sequence[Series]) -> list[Difference | None]:
    """Look for arms that change over time; returns None where there are too few dates."""
    scale = day_scatter(series)
    found: list[Difference | None] = []
    for item in series:
        if len(item.days) < FEWEST_DATES:
            found.append(None)
            continue
        line, covariance = _line(item)
        span = float(item.days[-1] - item.days[0])
        first = float(line[0] + line[1] * item.days[0])
        error = span * float(np.sqrt(covariance[1, 1])) * scale
        found.append(_difference(first + float(line[1]) * span, first, error,
                                 abs(float(np.median(item.values)))))
    return found


def day_scatter(series: Sequence[Series]) -> float:
    """Say how much more a quantity scatters from date to date than its standard errors tell."""
    ratios = []
    for item in series:
        freedom = len(item.days) - 2
        if freedom < 1:
            continue
        line, _ = _line(item)
        left = (item.values - line[0] - line[1] * item.days) / item.errors
        # median of chi squared over its mean (Wilson and Hilferty, 1931)
        usual = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3
        ratios.append(float(left @ left) / usual)
    return float(np.sqrt(max(1.0, np.median(ratios)))) if ratios else 1.0


def _level(item: Series, scale: float) -> tuple[float, float]:
    weights = item.errors ** -2.0
    return (float(weights @ item.values / weights.sum()),
            float(scale / np.sqrt(weights.sum())))


def _line(item: Series) -> tuple[FloatArray, FloatArray]:
    columns = np.column_stack([np.ones_like(item.days), item.days]) / item.errors[:, None]
    covariance: FloatArray = np.asarray(np.linalg.pinv(columns.T @ columns), dtype=float)
    return covariance @ columns.T @ (item.values / item.errors), covariance


def _difference(value: float, expected: float, error: float, size: float) -> Difference:
    sigmas = (value - expected) / max(error, 1e-300)
    return Difference(value, expected, sigmas, abs(sigmas) > SIGMAS
                      and abs(value - expected) > RELEVANT * size)
