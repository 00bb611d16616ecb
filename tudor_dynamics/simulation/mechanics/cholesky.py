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

"""Small dense systems in compiled code: a call of LAPACK costs more than the work."""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled


@compiled
def cholesky(a: NDArray) -> bool:
    """Factorise a symmetric matrix in place (lower triangle); False if it is not definite."""
    n = a.shape[0]
    for j in range(n):
        row = a[j]
        for k in range(j):
            other = a[k]
            total = row[k]
            for i in range(k):
                total -= row[i] * other[i]
            row[k] = total * other[k]
        total = row[j]
        for i in range(j):
            total -= row[i] * row[i]
        if not total > 0.0:
            return False
        row[j] = 1.0 / math.sqrt(total)  # the inverse saves divisions later
    return True


@compiled
def solve(a: NDArray, b: NDArray) -> None:
    """Solve with the factors of ``cholesky``, in place."""
    n = a.shape[0]
    for j in range(n):
        total = b[j]
        row = a[j]
        for i in range(j):
            total -= row[i] * b[i]
        b[j] = total * row[j]
    for j in range(n - 1, -1, -1):
        row = a[j]
        value = b[j] * row[j]
        b[j] = value
        for i in range(j):
            b[i] -= row[i] * value


@compiled
def factor_norm(a: NDArray, v: NDArray) -> float:
    """Give v^T A v from the factors of A."""
    n = a.shape[0]
    total = 0.0
    for j in range(n):
        part = v[j] / a[j, j]
        for i in range(j + 1, n):
            part += a[i, j] * v[i]
        total += part * part
    return total
