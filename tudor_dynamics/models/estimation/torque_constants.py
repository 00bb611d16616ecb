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
Unknown torque constants, found together with one set of inertial parameters.

A joint with the torque constant k draws the current ``Y chi / k + friction``. For given constants
that is linear least squares in ``chi`` and friction; what is left over is a function of the
constants alone, which is minimised over their logarithms: variable projection (Golub and Pereyra,
SIAM J. Numer. Anal. 10(2), 1973). All of it is done on Gram matrices, without another pass over
the recordings. A common factor of all constants is nobody's: where no channel has a known unit,
one joint is the measure of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tudor_dynamics.models.estimation.products import Products
from tudor_dynamics.typing import FloatArray

PRIOR_WIDTH = 0.5
"""Standard deviation of the logarithm of a constant about the mean of all, before any data: joints
of one arm have drives of one kind. It decides for wrists whose bodies hardly show."""
CORRELATED = 50.0
"""Samples that count as one: residuals of a motion are no white noise (2.5 s at 20 Hz)."""
PASSES = 3
RIDGE = 1e-9
"""Part of a column's own information that is added to it: parameters may be hard to tell apart."""
STEP = 1e-3


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
    """
    Give the products of a channel whose torque constant is another.

    scaled (parameters,) [unit of the channel].
    """
    factor = np.append(np.where(scaled, 1.0 / constant, 1.0), 1.0)
    triangle = None if products.triangle is None else products.triangle * factor
    return Products(products.gram * np.outer(factor, factor), products.n, triangle)


def find_constants(
    products: Sequence[Products], scaled: NDArray[np.bool_], unknown: Sequence[int],
) -> Constants:
    """
    Find the torque constants of some of the channels that share their parameters.

    scaled (parameters,).
    """
    problem = _Problem(products, scaled, list(unknown))
    logs = np.zeros(len(unknown))
    for _ in range(PASSES):
        logs = problem.minimise(logs)
        problem.weigh(logs)
    return problem.constants(logs)


class _Problem:
    """What is left over by the best parameters, as a function of the constants' logarithms."""

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

    def parameters(self, logs: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        """Give the scaled Gram matrices, and the parameters that are best for them."""
        scales = np.zeros(len(self.grams))
        scales[self.unknown] = -logs
        grams = []
        for gram, log in zip(self.grams, scales, strict=True):
            factor = np.where(self.columns, np.exp(log), 1.0)
            grams.append(gram * np.outer(factor, factor))
        total = sum(w * gram for w, gram in zip(self.weights, grams, strict=True))
        total = np.asarray(total)
        size = np.sqrt(np.diag(total)[:-1])
        size = np.where(size > 1e-12 * size.max(initial=0.0), size, np.inf)
        information = total[:-1, :-1] / np.outer(size, size) + RIDGE * np.eye(len(size))
        return grams, linalg.solve(information, total[:-1, -1] / size, assume_a='pos') / size

    def residual(self, logs: FloatArray) -> tuple[list[FloatArray], FloatArray, FloatArray]:
        """Give Gram matrices, ``[-parameters, 1]``, and the sum of squares of each channel."""
        grams, best = self.parameters(logs)
        vector = np.append(-best, 1.0)
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

    @property
    def absolute(self) -> bool:
        """Say whether a channel with a known unit is the measure of all."""
        return len(self.unknown) < len(self.grams)

    def minimise(self, logs: FloatArray) -> FloatArray:
        """Go to the least cost."""
        from scipy import optimize  # slow to import, and few arms need it

        found = optimize.minimize(self.cost, logs, jac=True, method='BFGS',
                                  options={'gtol': 1e-4})
        return np.asarray(found.x)

    def weigh(self, logs: FloatArray) -> None:
        """Weight each channel by the inverse of its residual variance."""
        self.weights = 1.0 / np.maximum(self.residual(logs)[2] / self.counts, self.floor)

    def constants(self, logs: FloatArray) -> Constants:
        """Give constants with their errors, relative to the best known."""
        n = len(logs)
        # half of the second derivatives of the sum of squares
        hessian = np.array([self.cost(logs + shift)[1] - self.cost(logs - shift)[1]
                            for shift in STEP * np.eye(n)]) / (4.0 * STEP)
        free = np.arange(n)
        if not self.absolute:
            measure = int(np.argmax(np.diag(hessian)))
            logs, free = logs - logs[measure], np.delete(free, measure)
        errors, values = np.zeros(len(self.grams)), np.ones(len(self.grams))
        values[self.unknown] = np.exp(logs)
        inner = hessian[np.ix_(free, free)]
        variances = np.diag(linalg.pinvh((inner + inner.T) / 2.0))
        errors[np.array(self.unknown)[free]] = np.sqrt(np.maximum(variances, 0.0))
        return Constants(values, errors)
