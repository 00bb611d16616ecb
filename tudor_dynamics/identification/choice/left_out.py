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
What a candidate is worth: its errors on parts of the training data that it was not fitted to.

A candidate with more in it is taken where the left-out parts clearly pay for it, by the rule of
one standard error (Breiman et al., Classification and Regression Trees, 1984, Section 3.4.3): the
gain over all parts has to exceed its own scatter between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import JointSpec
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.choice.rows import WideRows
from tudor_dynamics.models.estimation.estimators import solve
from tudor_dynamics.models.estimation.products import Products, squared_residuals
from tudor_dynamics.models.estimation.torque_constants import find_constants, rescaled
from tudor_dynamics.typing import FloatArray

LEAST_GAIN = 0.01
"""Part of the error that a choice has to bring: less is no reason for more parameters."""


def paid(before: FloatArray, after: FloatArray, least: float = LEAST_GAIN) -> bool:
    """Say whether left-out parts clearly pay for a candidate: before, after (parts,)."""
    gains = before - after
    if not np.all(np.isfinite(gains)) or not before.sum() > 0.0:
        return False
    scatter = float(np.std(gains, ddof=1)) * np.sqrt(len(gains)) if len(gains) > 1 else np.inf
    return bool(np.sqrt(after.sum() / before.sum()) < 1.0 - least and gains.sum() > scatter)


class LeftOut:
    """Errors of candidates on parts that are left out, each once."""

    def __init__(self, rows: WideRows) -> None:
        self.rows = rows
        self._renew()

    def _renew(self) -> None:
        self._parts = self.rows.products()
        self._total = [reduce(add, channel) for channel in zip(*self._parts, strict=True)]

    def errors(
        self, joints: Sequence[JointSpec], *, shared: bool = False, weighted: bool = True,
        constants: FloatArray | None = None,
    ) -> FloatArray:
        """
        Fit a candidate to all parts but one, and predict that, for every part.

        constants (channels,); returns (parts, channels), infinite where a fit has too few samples.
        """
        errors = np.zeros((len(self._parts), len(self._total)))
        for channels, kept in self.rows.groupings[shared]:
            places = self.rows.taken(joints, kept)
            for k, part in enumerate(self._parts):
                others = [_narrow(self._total[i], places, part[i]) for i in channels]
                try:
                    parameters, found = self._solve(others, places, shared, weighted, constants)
                except FitError:
                    errors[k, list(channels)] = np.inf
                    continue
                for i, values in zip(channels, parameters, strict=True):
                    errors[k, i] = squared_residuals(_narrow(part[i], places), values)
        return errors

    def fitted(
        self, joints: Sequence[JointSpec], *, shared: bool = False,
    ) -> tuple[FloatArray, FloatArray | None]:
        """
        Fit a candidate to all parts.

        Returns parameters (channels, columns) and constants (channels,).
        """
        full = np.zeros((len(self._total), self.rows.n_columns))
        constants = None
        for channels, kept in self.rows.groupings[shared]:
            places = self.rows.taken(joints, kept)
            parameters, constants = self._solve(
                [_narrow(self._total[i], places) for i in channels], places, shared, True, None)
            for i, values in zip(channels, parameters, strict=True):
                full[i, places] = values
        return full, constants

    def assume(self, parameters: FloatArray) -> None:
        """Take parameters by which loads are known; see ``WideRows.assume``."""
        self.rows.assume(parameters)
        self._renew()

    def _solve(
        self, products: list[Products], places: NDArray[np.intp], shared: bool, weighted: bool,
        constants: FloatArray | None,
    ) -> tuple[list[FloatArray], FloatArray | None]:
        if not shared:
            return [solve(products, weighted=weighted).parameters] * len(products), None
        bodies = places < len(self.rows.columns)
        scaled = np.zeros(len(places), dtype=bool)
        scaled[bodies] = self.rows.scaled[places[bodies]]
        if constants is None:
            constants = find_constants(products, scaled, self.rows.unknown).values
        common = solve([rescaled(product, scaled, value) for product, value in
                        zip(products, constants, strict=True)], weighted=weighted).parameters
        return [np.where(scaled, common / value, common) for value in constants], constants


def _narrow(
    product: Products, places: NDArray[np.intp], without: Products | None = None,
) -> Products:
    index = np.append(places, len(product.gram) - 1)
    gram, n = product.gram[np.ix_(index, index)], product.n
    if without is None:
        return Products(gram, n)
    return Products(gram - without.gram[np.ix_(index, index)], n - without.n)
