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

"""Least squares from accumulated products; estimators and unknown torque constants."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tudor_dynamics.errors import FitError
from tudor_dynamics.models.settings import (
    CONSTANT_PASSES, CONSTANT_STEP, CORRELATED, HUBER_CONSTANT, LARGEST_GRAM_CONDITION,
    NEGLIGIBLE, PRIOR_WIDTH, RIDGE, UNEXCITED_CONDITION)
from tudor_dynamics.typing import FloatArray


# -- Accumulated products of regressor rows: memory independent of the length of the recordings.
#
# Per channel the Gram matrix of ``[rows, output]`` is summed up in chunks. Weighting channels,
# leaving out a bag, covariance and condition number then cost microseconds. Where the scaled Gram
# matrix is too ill-conditioned for that (it squares the condition number), triangular factors are
# accumulated as well (tall-skinny QR).

def triangle(matrix: FloatArray) -> FloatArray:
    """Reduce rows to a triangular factor with the same Gram matrix."""
    return np.asarray(linalg.qr(matrix, mode='r', check_finite=False)[0][:matrix.shape[1]])


@dataclass(eq=False)
class Products:
    """Accumulated products of one channel."""

    gram: FloatArray  # gram matrix of `[rows, output]`, (parameters + 1, parameters + 1)
    n: int = 0  # number of rows
    triangle: FloatArray | None = None  # factor of `[rows, output]`, if accumulated

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
        """Give the products on more parameters, at other ``places``, on which no row depends."""
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
    return [[reduce(add, channel) for channel in zip(*groups, strict=True)]
            for groups in zip(*parts, strict=True)]


def squared_residuals(product: Products, parameters: FloatArray) -> float:
    """Give the residual sum of squares of a channel from its products."""
    vector = np.append(-parameters, 1.0)
    if product.triangle is not None:
        return float(np.sum((product.triangle @ vector) ** 2))
    return max(0.0, float(vector @ product.gram @ vector))


# -- Least squares from accumulated products: plain, weighted by channel, Huber's weights

@dataclass(frozen=True)
class Estimator:
    """A way to estimate parameters, and all that depends on which one it is."""

    words: str  # its name in texts
    weighted: bool = True  # whether channels are weighted by the inverse of their variance
    # Weights of the samples of a channel by its residuals, for iterated least squares.
    sample_weights: Callable[[FloatArray], FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters of one group of channels."""

    parameters: FloatArray  # least-squares solution, in the units of its columns, (parameters,)
    # (parameters,): standard deviations of the parameters, from the residual variance; infinite
    # for those that the motion does not show.
    standard_errors: FloatArray
    condition: float  # condition number of the weighted rows, columns scaled to unit length
    unexcited: tuple[int, ...]  # not shown: columns of zeros, or of others
    variances: FloatArray = field(repr=False)  # residual variance of each channel, (channels,)


def _solve(products: list[Products], weights: FloatArray, prior: float = 0.0) -> tuple[
        FloatArray, FloatArray, float, tuple[int, ...]]:
    """Solve once for given channel weights: parameters, inverse information, condition, unseen."""
    factors = [product.triangle for product in products if product.triangle is not None]
    triangular = len(factors) == len(products)
    factor = (triangle(np.vstack([np.sqrt(w) * t for w, t in zip(weights, factors, strict=True)]))
              if triangular else
              np.asarray(sum(w * p.gram for w, p in zip(weights, products, strict=True))))
    p = factor.shape[1] - 1
    left, right = factor[:, :p], factor[:, p]
    scale = np.linalg.norm(left, axis=0) if triangular else np.sqrt(np.diag(left)[:p])
    # A column without signal has no scale of its own.
    seen = scale > 1e-12 * float(np.max(scale, initial=0.0))
    safe = np.where(seen, scale, 1.0)
    if triangular:
        u, values, vt = np.linalg.svd(left / safe, full_matrices=False)
        vectors, projected = vt.T, u.T @ right
    else:
        squares, vectors = linalg.eigh(left[:p] / np.outer(safe, safe))
        values = np.sqrt(np.maximum(squares, 0.0))
        projected = np.divide(vectors.T @ (right[:p] / safe), values, where=values > 0,
                              out=np.zeros(p))
    largest = float(np.max(values, initial=0.0))
    floor = largest / (UNEXCITED_CONDITION if triangular else LARGEST_GRAM_CONDITION * 10.0)
    good = values > max(floor, 1e-300)
    information = np.where(good, values, 1.0) ** 2
    information += np.where(prior > NEGLIGIBLE * information, prior, 0.0)
    parameters = vectors @ (np.where(good, values / information, 0.0) * projected) / safe
    covariance = (vectors * np.where(good, 1.0 / information, 0.0)) @ vectors.T
    covariance = covariance / np.outer(safe, safe)
    # columns without any signal are reported, but say nothing about the others' conditioning
    rest = np.sort(values)[int(np.sum(~seen)):]
    condition = float(largest / rest[0]) if len(rest) and rest[0] > 0 else np.inf
    hidden = np.abs(vectors[:, ~good]).max(axis=1, initial=0.0)
    unexcited = tuple(int(i) for i in np.flatnonzero((hidden > 0.1) | ~seen))
    return parameters, covariance, condition, unexcited


def solve(products: list[Products], *, weighted: bool = True) -> Estimate:
    """Estimate the parameters that a group of channels shares."""
    p = products[0].gram.shape[0] - 1
    rows = sum(product.n for product in products)
    if rows <= p:
        raise FitError(f'only {rows} samples for {p} parameters; record longer, or raise the rate')
    # a channel that is fitted to rounding (or that is constant zero) would otherwise be given an
    # endless weight, against which the other channels vanish
    squares = np.array([product.gram[-1, -1] / max(product.n, 1) for product in products])
    floors = np.maximum(1e-14 * np.maximum(squares, 1e-6 * squares.max(initial=0.0)), 1e-300)
    weights = np.ones(len(products))
    for _ in range(3 if weighted and len(products) > 1 else 1):
        parameters, *_ = _solve(products, weights)
        # each channel pays for its share of the parameters
        freedom = 1.0 - p / rows
        noise = np.array([
            squared_residuals(product, parameters) / (max(product.n, 1) * freedom)
            for product in products])
        variances = np.maximum(noise, floors)
        if weighted:
            weights = 1.0 / variances
    size = float(np.mean(noise / variances if weighted else noise))
    # no parameter is expected to contribute more than the outputs' own size. Where the motion says
    # anything, this adds nothing to it; directions that short or poor recordings show only by
    # their noise are drawn to zero, instead of to values that cancel in training and nowhere else
    power = sum(w * own.gram[-1, -1] for w, own in zip(weights, products, strict=True))
    parameters, covariance, condition, unexcited = _solve(
        products, weights, size / power if power > 0.0 else 0.0)
    if not weighted:
        # equal weights, but each channel brings in noise of its own size
        spread = sum(v * product.gram[:p, :p] for v, product in zip(
            variances, products, strict=True))
        covariance = covariance @ spread @ covariance
    return Estimate(parameters, _errors(covariance, unexcited), condition, unexcited, variances)


def _errors(covariance: FloatArray, unexcited: tuple[int, ...]) -> FloatArray:
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    errors[list(unexcited)] = np.inf  # their share of the pseudo-inverse says nothing about them
    return errors


def expected(products: list[Products], variances: FloatArray) -> Estimate:
    """Say how well data of such variances (channels,) will show parameters, whatever they are."""
    _, covariance, condition, unexcited = _solve(products, 1.0 / variances)
    return Estimate(np.full(len(covariance), np.nan), _errors(covariance, unexcited), condition,
                    unexcited, variances)


def huber_weights(residuals: FloatArray) -> FloatArray:
    """Weigh residuals (samples,) for iteratively re-weighted least squares."""
    sigma = 1.4826 * float(np.median(np.abs(residuals - np.median(residuals))))
    if sigma == 0.0:
        return np.ones_like(residuals)
    return np.minimum(1.0, HUBER_CONSTANT * sigma / np.maximum(np.abs(residuals), 1e-300))


ESTIMATORS = {
    'ols': Estimator('plain least squares', weighted=False),
    'wls': Estimator('weighted least squares'),
    'huber': Estimator("Huber's estimator", sample_weights=huber_weights)}
"""Estimators by name; a new one is an entry, and words in docs/explanation/models.md."""


# -- Unknown torque constants, found together with one set of inertial parameters.
#
# A joint with the torque constant k draws the current ``Y chi / k + friction``. For given
# constants that is linear least squares in ``chi`` and friction; the residual is a function
# of the constants alone, which is minimised over their logarithms: variable projection (Golub and
# Pereyra, SIAM J. Numer. Anal. 10(2), 1973). All of it is done on Gram matrices, without another
# pass over the recordings. A common factor of all constants is nobody's: where no channel has a
# known unit, one joint is the measure of the others.


@dataclass(frozen=True, eq=False)
class Constants:
    """Torque constants of the channels of a group."""

    # (channels,): torque per unit of each channel: in N m or N where a channel of known unit is
    # among them, else in that of the channel that the data determine best, which has 1.
    values: FloatArray
    # (channels,): standard deviations of their logarithms; 0 for those that are known or the
    # measure.
    relative_errors: FloatArray


def rescaled(products: Products, scaled: NDArray[np.bool_], constant: float) -> Products:
    """Give the products of a channel whose torque constant is another."""
    factor = np.append(np.where(scaled, 1.0 / constant, 1.0), 1.0)
    triangle = None if products.triangle is None else products.triangle * factor
    return Products(products.gram * np.outer(factor, factor), products.n, triangle)


def find_constants(
    products: Sequence[Products], scaled: NDArray[np.bool_], unknown: Sequence[int],
) -> Constants:
    """Find the torque constants of some of the channels that share their parameters."""
    from scipy import optimize  # slow to import, and few arms need it

    problem = _Problem(products, scaled, list(unknown))
    logs = np.zeros(len(unknown))
    for _ in range(CONSTANT_PASSES):
        logs = np.asarray(optimize.minimize(
            problem.cost, logs, jac=True, method='BFGS', options={'gtol': 1e-4}).x)
        problem.weigh(logs)
    return problem.constants(logs)


class _Problem:
    """Residual of the best parameters, as a function of the constants' logarithms."""

    def __init__(
        self, products: Sequence[Products], scaled: NDArray[np.bool_], unknown: list[int],
    ) -> None:
        self.grams = [product.gram for product in products]
        self.counts = np.array([max(product.n, 1) for product in products], dtype=float)
        self.columns = np.append(scaled, False)
        self.unknown = unknown
        power = np.array([gram[-1, -1] for gram in self.grams])
        self.floor = 1e-12 * power / self.counts + 1e-300
        self.weights = self.counts / np.maximum(power, 1e-300)

    def residual(self, logs: FloatArray) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Give scaled Gram matrices, ``[-parameters, 1]``, and the squares of each channel."""
        scales = np.zeros(len(self.grams))
        scales[self.unknown] = -logs
        grams = []
        for gram, log in zip(self.grams, scales, strict=True):
            factor = np.where(self.columns, np.exp(min(max(log, -50.0), 50.0)), 1.0)
            grams.append(gram * np.outer(factor, factor))
        total = np.asarray(sum(w * gram for w, gram in zip(self.weights, grams, strict=True)))
        size = np.sqrt(np.diag(total)[:-1])
        size = np.where(size > 1e-12 * size.max(initial=0.0), size, np.inf)
        information = total[:-1, :-1] / np.outer(size, size) + RIDGE * np.eye(len(size))
        try:
            best = linalg.solve(information, total[:-1, -1] / size, assume_a='pos')
        except linalg.LinAlgError:
            raise FitError('the motion does not determine the torque constants', remedy='record '
                           'more motion, or add joints[].effort.torque_constant') from None
        vector = np.append(-(best / size), 1.0)
        return grams, vector, np.array([max(0.0, float(vector @ g @ vector)) for g in grams])

    def cost(self, logs: FloatArray) -> tuple[float, FloatArray]:
        """Give the sum of squares with the prior, and its slope (that of the parameters is 0)."""
        grams, vector, squares = self.residual(logs)
        explained = np.where(self.columns, vector, 0.0)
        # the column of a channel scales with exp(-log): the slope of r'r is 2 r' (bodies chi)
        slope = np.array([-2.0 * self.weights[i] * float(vector @ grams[i] @ explained)
                          for i in self.unknown]) / CORRELATED
        centred = logs - float(np.mean(logs))
        value = float(self.weights @ squares) / CORRELATED
        return (value + float(centred @ centred) / PRIOR_WIDTH ** 2,
                slope + 2.0 * centred / PRIOR_WIDTH ** 2)

    def weigh(self, logs: FloatArray) -> None:
        """Weight each channel by the inverse of its residual variance."""
        self.weights = 1.0 / np.maximum(self.residual(logs)[2] / self.counts, self.floor)

    def constants(self, logs: FloatArray) -> Constants:
        """Give constants with their errors, relative to the best known."""
        n = len(logs)
        # half of the second derivatives of the sum of squares
        hessian = np.array([self.cost(logs + shift)[1] - self.cost(logs - shift)[1]
                            for shift in CONSTANT_STEP * np.eye(n)]) / (4.0 * CONSTANT_STEP)
        free = np.arange(n)
        if n == len(self.grams):  # no channel with a known unit is the measure of all
            measure = int(np.argmax(np.diag(hessian)))
            logs, free = logs - logs[measure], np.delete(free, measure)
        errors, values = np.zeros(len(self.grams)), np.ones(len(self.grams))
        values[self.unknown] = np.exp(logs)
        inner = hessian[np.ix_(free, free)]
        variances = np.diag(linalg.pinvh((inner + inner.T) / 2.0))
        errors[np.array(self.unknown)[free]] = np.sqrt(np.maximum(variances, 0.0))
        return Constants(values, errors)
