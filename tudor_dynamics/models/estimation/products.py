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
Accumulated products of regressor rows: memory independent of the length of the recordings.

Per channel the Gram matrix of ``[rows, output]`` is summed up in chunks. Weighting channels,
leaving out a bag, covariance and condition number then cost microseconds. Where the scaled Gram
matrix is too ill-conditioned for that (it squares the condition number), triangular factors are
accumulated as well (tall-skinny QR).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tudor_dynamics.typing import FloatArray


def triangle(matrix: FloatArray) -> FloatArray:
    """
    Reduce rows to a triangular factor with the same Gram matrix.

    matrix (rows, columns); returns (min(rows, columns), columns).
    """
    return np.asarray(linalg.qr(matrix, mode='r', check_finite=False)[0][:matrix.shape[1]])


@dataclass(eq=False)
class Products:
    """Accumulated products of one channel."""

    gram: FloatArray  # gram matrix of `[rows, output]`, (parameters + 1, parameters + 1)
    n: int = 0  # number of rows
    # Upper triangular factor of `[rows, output]` where it is accumulated too.
    triangle: FloatArray | None = None

    @classmethod
    def empty(cls, n_parameters: int, *, triangular: bool = False) -> Products:
        """Start with nothing for ``n_parameters`` columns."""
        size = n_parameters + 1
        return cls(np.zeros((size, size)), 0, np.zeros((0, size)) if triangular else None)

    def add(self, rows: FloatArray, output: FloatArray, weight: FloatArray | None = None) -> None:
        """Add rows: rows (rows, parameters), output, weight (rows,)."""
        both = np.column_stack([rows, output])
        if weight is not None:
            both *= np.sqrt(weight)[:, None]
        self.gram += both.T @ both
        self.n += len(output)
        if self.triangle is not None:
            self.triangle = triangle(np.vstack([self.triangle, both]))

    def spread(self, places: NDArray[np.intp], n_parameters: int) -> Products:
        """
        Give the products on more parameters, which these rows do not depend on.

        places (own,).
        """
        index = np.append(places, n_parameters)
        wide = Products.empty(n_parameters)
        wide.gram[np.ix_(index, index)] = self.gram
        wide.n = self.n
        if self.triangle is not None:
            wide.triangle = np.zeros((len(self.triangle), n_parameters + 1))
            wide.triangle[:, index] = self.triangle
        return wide

    def factor(self) -> FloatArray:
        """Give a factor F with the Gram matrix F' F, shape (n_rows, n_parameters + 1)."""
        if self.triangle is not None:
            return self.triangle
        size = np.sqrt(np.diag(self.gram))
        size = np.where(size > 0.0, size, 1.0)
        values, vectors = linalg.eigh(self.gram / np.outer(size, size))
        return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * size)

    def __add__(self, other: Products) -> Products:
        """Join the rows of two sets of data."""
        factor = None
        if self.triangle is not None and other.triangle is not None:
            factor = triangle(np.vstack([self.triangle, other.triangle]))
        return Products(self.gram + other.gram, self.n + other.n, factor)


def summed(parts: Iterable[Sequence[Sequence[Products]]]) -> list[list[Products]]:
    """Join the data of several parts."""
    first, *others = parts
    total = [list(group) for group in first]
    for part in others:
        total = [[one + other for one, other in zip(*groups, strict=True)]
                 for groups in zip(total, part, strict=True)]
    return total


def triangular(parts: Iterable[Sequence[Sequence[Products]]]) -> bool:
    """Say whether parts were accumulated as triangular factors."""
    return any(product.triangle is not None for part in parts for group in part
               for product in group)


def squared_residuals(product: Products, parameters: FloatArray) -> float:
    """
    Give the residual sum of squares of a channel from its products.

    parameters (parameters,).
    """
    vector = np.append(-parameters, 1.0)
    if product.triangle is not None:
        return float(np.sum((product.triangle @ vector) ** 2))
    return max(0.0, float(vector @ product.gram @ vector))
