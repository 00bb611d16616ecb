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
Least squares from accumulated products: memory independent of the length of the recordings.

Per channel the Gram matrix of ``[rows, output]`` is summed up in chunks. Weighting channels,
leaving out a bag, ridge, covariance and condition number then cost microseconds. Where the scaled
Gram matrix is too ill-conditioned for that (it squares the condition number), triangular factors
are accumulated instead (tall-skinny QR).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tudor_dynamics.errors import FitError

FloatArray = NDArray[np.float64]

ESTIMATORS = ('ols', 'wls', 'huber')
HUBER_CONSTANT = 1.345  # 95 % efficiency at the normal distribution (Huber, Robust Statistics)
LARGEST_GRAM_CONDITION = 1e6
"""Condition number of the scaled columns above which triangular factors take over."""
UNEXCITED_CONDITION = 1e10


def _triangle(matrix: FloatArray) -> FloatArray:
    return np.asarray(linalg.qr(matrix, mode='r', check_finite=False)[0][:matrix.shape[1]])


@dataclass(eq=False)
class Products:
    """
    Accumulated products of one channel.

    Attributes
    ----------
    gram : ndarray of shape (n_parameters + 1, n_parameters + 1)
        Gram matrix of ``[rows, output]``.
    n : int
        Number of rows.
    triangle : ndarray or None
        Upper triangular factor of ``[rows, output]`` where it is accumulated too.

    """

    gram: FloatArray
    n: int = 0
    triangle: FloatArray | None = None

    @classmethod
    def empty(cls, n_parameters: int, *, triangular: bool = False) -> Products:
        """Start with nothing for ``n_parameters`` columns."""
        size = n_parameters + 1
        return cls(np.zeros((size, size)), 0, np.zeros((0, size)) if triangular else None)

    def add(self, rows: FloatArray, output: FloatArray, weight: FloatArray | None = None) -> None:
        """
        Add rows.

        Parameters
        ----------
        rows : ndarray of shape (n_rows, n_parameters)
            Regressor rows.
        output : ndarray of shape (n_rows,)
            Measured output.
        weight : ndarray of shape (n_rows,), optional
            Weight of each squared residual.

        """
        both = np.column_stack([rows, output])
        if weight is not None:
            both *= np.sqrt(weight)[:, None]
        self.gram += both.T @ both
        self.n += len(output)
        if self.triangle is not None:
            self.triangle = _triangle(np.vstack([self.triangle, both]))

    def spread(self, places: NDArray[np.intp], n_parameters: int) -> Products:
        """
        Give the products on more parameters, which these rows do not depend on.

        Parameters
        ----------
        places : ndarray of int, shape (n_own,)
            Where the own parameters stand among all.
        n_parameters : int
            Number of all parameters.

        Returns
        -------
        Products
            The same data, with zero columns.

        """
        index = np.append(places, n_parameters)
        wide = Products.empty(n_parameters)
        wide.gram[np.ix_(index, index)] = self.gram
        wide.n = self.n
        if self.triangle is not None:
            wide.triangle = np.zeros((len(self.triangle), n_parameters + 1))
            wide.triangle[:, index] = self.triangle
        return wide

    def __add__(self, other: Products) -> Products:
        """Join the rows of two sets of data."""
        triangle = None
        if self.triangle is not None and other.triangle is not None:
            triangle = _triangle(np.vstack([self.triangle, other.triangle]))
        return Products(self.gram + other.gram, self.n + other.n, triangle)


@dataclass(frozen=True, eq=False)
class Estimate:
    """
    Parameters of one group of channels.

    Attributes
    ----------
    parameters : ndarray of shape (n_parameters,)
        Least-squares solution.
    standard_errors : ndarray of shape (n_parameters,)
        Standard deviations of the parameters, from the residual variance.
    condition : float
        Condition number of the weighted rows, columns scaled to unit length.
    unexcited : tuple of int
        Parameters that the motion does not show: columns that stay zero or depend on others.
    variances : ndarray of shape (n_channels,)
        Residual variance of each channel.

    """

    parameters: FloatArray
    standard_errors: FloatArray
    condition: float
    unexcited: tuple[int, ...]
    variances: FloatArray = field(repr=False)


def _factor(products: list[Products], weights: FloatArray) -> FloatArray:
    """Square-root information matrix of the weighted, stacked channels, ``[R, Q'y]``."""
    triangles = [p.triangle for p in products]
    if all(triangle is not None for triangle in triangles):
        stacked = np.vstack([np.sqrt(w) * t for w, t in zip(weights, triangles, strict=True)
                             if t is not None])
        return _triangle(stacked)
    gram = sum(w * p.gram for w, p in zip(weights, products, strict=True))
    return np.asarray(gram)


def _solve(products: list[Products], weights: FloatArray) -> tuple[
        FloatArray, FloatArray, float, tuple[int, ...]]:
    """Solve once for given channel weights: parameters, inverse information, condition, unseen."""
    factor = _factor(products, weights)
    triangular = products[0].triangle is not None
    p = factor.shape[1] - 1
    left, right = factor[:, :p], factor[:, p]
    scale = np.linalg.norm(left, axis=0) if triangular else np.sqrt(np.diag(left)[:p])
    # A column without signal has no scale of its own.
    seen = scale > 1e-12 * float(np.max(scale, initial=0.0))
    safe = np.where(seen, scale, 1.0)
    if triangular:
        u, s, vt = np.linalg.svd(left / safe, full_matrices=False)
        values, vectors = s, vt.T
        projected = u.T @ right
    else:
        scaled = left[:p] / np.outer(safe, safe)
        squares, vectors = linalg.eigh(scaled)
        values = np.sqrt(np.maximum(squares, 0.0))
        projected = np.divide(vectors.T @ (right[:p] / safe), values, where=values > 0,
                              out=np.zeros(p))
    largest = float(np.max(values, initial=0.0))
    floor = largest / (UNEXCITED_CONDITION if triangular else LARGEST_GRAM_CONDITION * 10.0)
    good = values > max(floor, 1e-300)
    inverse = np.where(good, 1.0 / np.where(good, values, 1.0), 0.0)
    parameters = vectors @ (inverse * projected) / safe
    covariance = (vectors * inverse ** 2) @ vectors.T / np.outer(safe, safe)
    # columns without any signal are reported, but say nothing about the others' conditioning
    rest = np.sort(values)[int(np.sum(~seen)):]
    condition = float(largest / rest[0]) if len(rest) and rest[0] > 0 else np.inf
    hidden = np.zeros(p)
    for k in np.flatnonzero(~good):
        hidden = np.maximum(hidden, np.abs(vectors[:, k]))
    unexcited = tuple(int(i) for i in np.flatnonzero((hidden > 0.1) | ~seen))
    return parameters, covariance, condition, unexcited


def squared_residuals(product: Products, parameters: FloatArray) -> float:
    """
    Give the residual sum of squares of a channel from its products.

    Parameters
    ----------
    product : Products
        Accumulated products.
    parameters : ndarray of shape (n_parameters,)
        Parameters.

    Returns
    -------
    float
        Sum of squares, never negative.

    """
    vector = np.append(-parameters, 1.0)
    if product.triangle is not None:
        return float(np.sum((product.triangle @ vector) ** 2))
    return max(0.0, float(vector @ product.gram @ vector))


def solve(products: list[Products], *, weighted: bool = True) -> Estimate:
    """
    Estimate the parameters that a group of channels shares.

    Parameters
    ----------
    products : list of Products
        One for each channel of the group.
    weighted : bool, default=True
        Weight each channel by the inverse of its residual variance (IDIM-WLS; Gautier, 1997),
        found in a first pass with equal weights.

    Returns
    -------
    Estimate
        Parameters with their standard errors.

    Raises
    ------
    FitError
        If there are fewer rows than parameters.

    """
    p = products[0].gram.shape[0] - 1
    rows = sum(product.n for product in products)
    if rows <= p:
        msg = f'{rows} samples for {p} parameters; record longer or decimate less'
        raise FitError(msg)
    weights = np.ones(len(products))
    variances = weights
    passes = 3 if weighted and len(products) > 1 else 1
    for _ in range(passes):
        parameters, inverse, condition, unexcited = _solve(products, weights)
        # each channel pays for its share of the parameters
        freedom = 1.0 - p / rows
        variances = np.array([
            max(squared_residuals(product, parameters) / (max(product.n, 1) * freedom), 1e-300)
            for product in products])
        if weighted:
            weights = 1.0 / variances
    if weighted:
        parameters, inverse, condition, unexcited = _solve(products, 1.0 / variances)
        spread = 1.0
    else:
        total = sum(squared_residuals(product, parameters) for product in products)
        spread = total / (rows - p)
    errors = np.sqrt(np.maximum(np.diag(inverse) * spread, 0.0))
    return Estimate(parameters, errors, condition, unexcited, variances)


def huber_weights(residuals: FloatArray) -> FloatArray:
    """
    Weigh residuals for iteratively re-weighted least squares.

    Parameters
    ----------
    residuals : ndarray of shape (n_samples,)
        Residuals of one channel.

    Returns
    -------
    ndarray of shape (n_samples,)
        1 within 1.345 robust standard deviations, falling with the residual beyond.

    """
    sigma = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    if sigma == 0.0:
        return np.ones_like(residuals)
    return np.minimum(1.0, HUBER_CONSTANT * sigma / np.maximum(np.abs(residuals), 1e-300))
