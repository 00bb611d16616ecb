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

from tudor_dynamics.compiled import unowned


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
