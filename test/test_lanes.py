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
import os
from pathlib import Path
import subprocess
import sys

from hypothesis import given, settings, strategies as st
import numpy as np

from tudor_dynamics.compiled import compiled, in_lanes, LANES, side_by_side

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


PROGRAM = """
import math
import numpy as np
from tudor_dynamics.compiled import (
    compiled, in_lanes, LANES, PLAIN, side_by_side, unowned, with_lanes)


@with_lanes(1)
def grow(bound, states, seen, place):
    x, y, at = in_lanes((states, seen, place))
    for k in range(y.shape[0]):
        x[0] = 1.5 * x[0] + math.sin(x[0]) - math.cos(x[1])
        x[at[0]] += 0.1 * x[0]
        if not abs(x[0]) < bound:
            return k
        y[k] = x[0]
    return y.shape[0]


@compiled
def total(tables):
    a, b = unowned(tables)
    return a.sum() + b[0]


for first in (0.01, 14.0):
    several = [np.array([0.1 + 0.01 * k, 0.2]) for k in range(LANES - 2)]
    several.append(np.array([first, 0.5]))
    states, seen, place = side_by_side(several), np.zeros((6, LANES)), np.array([1])
    done = grow(40.0, states, seen, place)
    bad = ~(np.abs(states[0]) < 40.0)
    print(PLAIN, done, *np.flatnonzero(bad), *(states[:, ~bad].ravel() if done == 6 else ()))
print(total((np.ones((2, 3)), np.array([2, 3]))))
"""


def test_the_plain_way_gives_the_same(tmp_path: Path) -> None:
    """One lane after the other, as where numba has changed: the same numbers and failures."""
    (tmp_path / 'program.py').write_text(PROGRAM)

    def said(plain: str) -> list[list[str]]:
        run = subprocess.run(
            [sys.executable, str(tmp_path / 'program.py')], capture_output=True, text=True,
            check=True, env={**os.environ, 'TUDOR_PLAIN_LANES': plain})
        return [line.split() for line in run.stdout.splitlines()]
    vectors, plain = said(''), said('1')
    assert [line.pop(0) for line in vectors[:2]] == ['False'] * 2
    assert [line.pop(0) for line in plain[:2]] == ['True'] * 2
    assert vectors[1] == plain[1] and 0 < int(plain[1][0]) < 6  # the same lanes fail, as early
    assert plain[0][0] == '6' and vectors[2] == plain[2]
    np.testing.assert_allclose(np.array(plain[0], float), np.array(vectors[0], float), rtol=1e-12)
