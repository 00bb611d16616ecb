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

"""Numbers side by side are what numpy makes of each by itself."""

from __future__ import annotations

import math

from hypothesis import given, settings, strategies as st
import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.lanes import in_lanes, LANES, side_by_side

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=2 * LANES, max_size=2 * LANES)


@compiled
def many_things(a: np.ndarray, b: np.ndarray, places: np.ndarray, result: np.ndarray) -> None:
    """Do what kernels do: arithmetic with numbers, sums that begin with one, parts of arrays."""
    x, y, where, out = in_lanes((a, b, places, result))
    for k in range(x.shape[0]):
        total = 0.0
        for value in (x[k], y[k]):
            total += abs(value) * 2
        out[k, where[0]] = total - x[k] / (y[k] * y[k] + 1.0)
        row = out[k]
        row[1] = math.sqrt(abs(x[k])) - 3
        row[2], row[3] = math.sin(x[k]), math.cos(x[k])
        row[4] = -x[k]
        row[4] -= 1
        row[5:7] = 2.0
        row[7] = x[k] if x[k] > 1e6 else y[k]


@compiled
def orders(a: np.ndarray, bound: float) -> tuple[bool, bool, bool, bool, int]:
    """Compare."""
    x, = in_lanes((a,))
    return x[0] < bound, x[0] <= bound, x[0] > bound, x[0] >= bound, int(x[0])


@settings(deadline=None, max_examples=60)
@given(NUMBERS, NUMBERS)
def test_arithmetic(first: list[float], second: list[float]) -> None:
    """Every operation in every lane."""
    x, y = (np.array(values).reshape(2, LANES) for values in (first, second))
    out = np.zeros((2, 8, LANES))
    many_things(x, y, np.array([0]), out)
    expected = np.stack([2 * np.abs(x) + 2 * np.abs(y) - x / (y * y + 1), np.sqrt(np.abs(x)) - 3,
                         np.sin(x), np.cos(x), -x - 1, np.full_like(x, 2), np.full_like(x, 2), y],
                        axis=1)
    # an angle is exact to rounding of itself
    assert np.all(np.abs(out - expected) <= 4e-16 * (10 + np.abs(expected) + np.abs(x)[:, None]))


def test_orders_hold_in_all_lanes() -> None:
    """One lane that differs is enough for no, and so is one that is no number."""
    x = np.full((1, LANES), 3.0)
    assert orders(x, 4.0) == (True, True, False, False, 3)
    assert orders(x, 3.0) == (False, True, False, True, 3)
    x[0, 5] = 9.0
    assert orders(x, 4.0) == (False, False, False, False, 3)
    x[0, 5] = math.nan
    assert orders(x, 4.0) == (False, False, False, False, 3)


def test_lanes_that_are_left_are_filled() -> None:
    """With the last one: they do nothing that the others do not."""
    several = [np.array([1.0, 2.0]), np.array([3.0, 4.0])]
    together = side_by_side(several)
    assert together.shape == (2, LANES)
    assert np.array_equal(together[:, :2], np.array(several).T)
    assert np.all(together[:, 2:] == several[-1][:, None])
