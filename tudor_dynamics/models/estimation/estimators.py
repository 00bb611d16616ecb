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

"""Least squares from accumulated products: plain, weighted by channel, Huber's weights."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import linalg

from tudor_dynamics.errors import FitError
from tudor_dynamics.models.estimation.products import Products, squared_residuals, triangle
from tudor_dynamics.typing import FloatArray

ESTIMATORS = ('ols', 'wls', 'huber')
HUBER_CONSTANT = 1.345  # 95 % efficiency at the normal distribution (Huber, Robust Statistics)
LARGEST_GRAM_CONDITION = 1e6
"""Condition number of the scaled columns above which triangular factors take over."""
UNEXCITED_CONDITION = 1e10
NEGLIGIBLE = 1e-3
"""The prior is left out where it would move a direction by less than this part."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters of one group of channels."""

    parameters: FloatArray  # least-squares solution, in the units of its columns, (parameters,)
    # (parameters,): standard deviations of the parameters, from the residual variance; infinite
    # for those that the motion does not show.
    standard_errors: FloatArray
    condition: float  # condition number of the weighted rows, columns scaled to unit length
    # Parameters that the motion does not show: columns that stay zero or depend on others.
    unexcited: tuple[int, ...]
    variances: FloatArray = field(repr=False)  # residual variance of each channel, (channels,)


def _factor(products: list[Products], weights: FloatArray) -> FloatArray:
    """Square-root information matrix of the weighted, stacked channels, ``[R, Q'y]``."""
    factors = [p.triangle for p in products]
    if all(factor is not None for factor in factors):
        stacked = np.vstack([np.sqrt(w) * t for w, t in zip(weights, factors, strict=True)
                             if t is not None])
        return triangle(stacked)
    gram = sum(w * p.gram for w, p in zip(weights, products, strict=True))
    return np.asarray(gram)


def _solve(products: list[Products], weights: FloatArray, prior: float = 0.0) -> tuple[
        FloatArray, FloatArray, float, tuple[int, ...]]:
    """Solve once for given channel weights: parameters, inverse information, condition, unseen."""
    factor = _factor(products, weights)
    triangular = all(product.triangle is not None for product in products)
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
    information = np.where(good, values, 1.0) ** 2
    information = information + np.where(prior > NEGLIGIBLE * information, prior, 0.0)
    parameters = vectors @ (np.where(good, values / information, 0.0) * projected) / safe
    covariance = (vectors * np.where(good, 1.0 / information, 0.0)) @ vectors.T
    covariance = covariance / np.outer(safe, safe)
    # columns without any signal are reported, but say nothing about the others' conditioning
    rest = np.sort(values)[int(np.sum(~seen)):]
    condition = float(largest / rest[0]) if len(rest) and rest[0] > 0 else np.inf
    hidden = np.zeros(p)
    for k in np.flatnonzero(~good):
        hidden = np.maximum(hidden, np.abs(vectors[:, k]))
    unexcited = tuple(int(i) for i in np.flatnonzero((hidden > 0.1) | ~seen))
    return parameters, covariance, condition, unexcited


def _prior(products: list[Products], weights: FloatArray, noise: float) -> float:
    """
    Give the information of a weak prior on each column's contribution to the outputs.

    No parameter is expected to contribute more than the outputs' own size. Where the motion says
    anything, this says nothing beside it; directions that short or poor recordings show only by
    their noise are drawn to zero, instead of to values that cancel in training and nowhere else.
    """
    power = sum(w * p.gram[-1, -1] for w, p in zip(weights, products, strict=True))
    return noise / power if power > 0.0 else 0.0


def _variance_floors(products: list[Products]) -> FloatArray:
    """
    Bound each channel's residual variance from below by what its products can resolve.

    A channel that is fitted to rounding (or that is constant zero) would otherwise be given an
    endless weight, against which the other channels vanish.
    """
    squares = np.array([product.gram[-1, -1] / max(product.n, 1) for product in products])
    largest = float(np.max(squares, initial=0.0))
    return np.maximum(1e-14 * np.maximum(squares, 1e-6 * largest), 1e-300)


def solve(products: list[Products], *, weighted: bool = True) -> Estimate:
    """Estimate the parameters that a group of channels shares."""
    p = products[0].gram.shape[0] - 1
    rows = sum(product.n for product in products)
    floors = _variance_floors(products)
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
        noise = np.array([
            squared_residuals(product, parameters) / (max(product.n, 1) * freedom)
            for product in products])
        variances = np.maximum(noise, floors)
        if weighted:
            weights = 1.0 / variances
    if weighted:
        weights = 1.0 / variances
        parameters, inverse, condition, unexcited = _solve(
            products, weights, _prior(products, weights, float(np.mean(noise / variances))))
        covariance = inverse
    else:
        parameters, inverse, condition, unexcited = _solve(
            products, weights, _prior(products, weights, float(np.mean(noise))))
        # equal weights, but each channel brings in noise of its own size
        spread = sum(v * product.gram[:p, :p] for v, product in zip(
            variances, products, strict=True))
        covariance = inverse @ spread @ inverse
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors[list(unexcited)] = np.inf  # their share of the pseudo-inverse says nothing about them
    return Estimate(parameters, errors, condition, unexcited, variances)


def expected(products: list[Products], variances: FloatArray) -> Estimate:
    """
    Say how well data will show parameters, whatever their outputs will be.

    variances (channels,).
    """
    _, covariance, condition, unexcited = _solve(products, 1.0 / variances)
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors[list(unexcited)] = np.inf
    return Estimate(np.full(len(errors), np.nan), errors, condition, unexcited, variances)


def huber_weights(residuals: FloatArray) -> FloatArray:
    """
    Weigh residuals for iteratively re-weighted least squares.

    residuals (samples,); returns (samples,).
    """
    sigma = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    if sigma == 0.0:
        return np.ones_like(residuals)
    return np.minimum(1.0, HUBER_CONSTANT * sigma / np.maximum(np.abs(residuals), 1e-300))
