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

"""Small arrays in compiled code: reductions as numpy has them, references that nobody counts."""

from __future__ import annotations

import sys

import numba
import numpy as np
import pytest

from tudor_dynamics.compiled import array_at, places_of, REAL, TRUTH, unowned, WHOLE


@numba.njit
def fill(tables: tuple, count: bool) -> float:
    """Write into the arrays by their rows."""
    (rows, whole), share = tables if count else unowned(tables)
    total = 0.0
    for i in range(rows.shape[0]):
        row = rows[i]
        row[0] = share * i
        total += row[0] + whole[i]
    return total


def test_arrays_without_owner_are_the_same_arrays() -> None:
    """Read and written in place, inside of nested tables; whoever owned them still does."""
    tables = (np.zeros((4, 2)), np.arange(4)), 0.5
    before = [sys.getrefcount(array) for array in tables[0]]
    totals = {fill(tables, count) for count in (True, False) for _ in range(100)}
    assert totals == {0.5 * 6 + 6}
    assert (tables[0][0][:, 0] == [0.0, 0.5, 1.0, 1.5]).all()
    assert [sys.getrefcount(array) for array in tables[0]] == before


@numba.njit
def fill_by_place(places: np.ndarray) -> float:
    """Write into the first of four arrays by all others, of which only places are known."""
    cube, whole = array_at(places, 0, REAL, 3), array_at(places, 1, WHOLE, 2)
    truth, share = array_at(places, 2, TRUTH, 1), array_at(places, 3, REAL, 1)
    for i in range(cube.shape[0]):
        for j in range(cube.shape[1]):
            for k in range(cube.shape[2]):
                if truth[k]:
                    cube[i, j, k] += whole[i, j] + share[k]
    return cube[1].sum()


def test_arrays_by_their_places_are_the_same_arrays() -> None:
    """Of any kind and up to three axes, read and written as numpy does."""
    arrays = (np.zeros((2, 3, 4)), np.arange(6).reshape(2, 3),
              np.array([True, False, True, True]), np.array([0.1, 0.2, 0.3, 0.4]))
    wanted = np.where(arrays[2], arrays[1][:, :, None] + arrays[3], 0.0)
    assert fill_by_place(places_of(arrays)) == pytest.approx(wanted[1].sum())
    np.testing.assert_array_equal(arrays[0], wanted)


@pytest.mark.parametrize('array', [np.zeros((4, 4))[:, ::2], np.zeros(3, dtype=np.float32)])
def test_arrays_that_no_place_describes(array: np.ndarray) -> None:
    """Rows with gaps between their numbers, other types."""
    with pytest.raises(ValueError, match='by its place'):
        places_of([array])
