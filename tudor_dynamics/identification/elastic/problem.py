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
The least-squares problem behind the elastic model: simulated against measured strain.

Output error: the arm is driven by measured positions and never corrected, so the whole oscillation
has to come out of the parameters. These are searched as logarithms, each with a prior as wide as
one can know it from drawings. Gain and offset of a gauge are linear and are eliminated (variable
projection, Golub and Pereyra 1973, with Kaufman's Jacobian), so that only physics is searched.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.elastic.explained import fit_percent, robust_scale
from tudor_dynamics.identification.elastic.record import Record
from tudor_dynamics.identification.elastic.simulations import Simulations
from tudor_dynamics.models.elastic.arm import INNER_STEP
from tudor_dynamics.typing import FloatArray

STEP = 1e-4
"""Of the differences, in the logarithm: the simulation is smooth to 1e-9, and its phase curved."""
TRUSTED = 6.0
"""Errors beyond this many standard deviations are a spoilt reading's, and draw no farther."""
HOPELESS = 1e3
"""Residual of a sample for parameters that cannot be simulated, in standard deviations."""


class Problem:
    """
    Residuals and derivatives for a choice of parameters and records.

    center, width (names,), inner [s], strain, weights (samples, gauges).
    """

    def __init__(
        self, arm: Arm, records: Sequence[Record], names: tuple[str, ...],
        fixed: dict[str, float], center: FloatArray, width: FloatArray, *,
        inner: float = INNER_STEP,
    ) -> None:
        self.arm, self.records, self.names = arm, tuple(records), names
        self.center, self.width = center, width
        self.strain = np.vstack([r.strain[r.skip:] for r in records])
        spread = np.maximum(self.strain.std(axis=0), 1e-12)
        self.weights = np.tile(1.0 / spread, (len(self.strain), 1))
        self._simulations = Simulations(arm, self.records, names, fixed, inner)
        self._last: list[tuple[FloatArray, FloatArray | None]] = []
        self._gains: FloatArray | None = None

    @property
    def runs(self) -> int:
        """Give the number of simulations done so far."""
        return self._simulations.runs

    @property
    def inner(self) -> float:
        """Give the longest inner step of the simulation [s]."""
        return self._simulations.inner

    @inner.setter
    def inner(self, seconds: float) -> None:
        self._simulations.inner = seconds

    @property
    def unknowns(self) -> int:
        """Length of the vectors: parameters, and logarithms of gains where they draw."""
        return len(self.names) + (0 if self._gains is None else self.strain.shape[1])

    def extended(self, x: FloatArray) -> FloatArray:
        """
        Give the vector of these parameters, with the gains as they were when drawn.

        x (names,).
        """
        return np.concatenate([x[:len(self.names)], np.zeros(self.unknowns - len(self.names))])

    def moments(self, x: FloatArray) -> FloatArray | None:
        """
        Simulate the moments that bend the gauges.

        x (unknowns,); returns (samples, gauges) [N m], None where they cannot be simulated.
        """
        for known, result in self._last:
            if np.array_equal(known, x):
                return result
        return self._kept([x])[0]

    def _kept(self, several: Sequence[FloatArray]) -> list[FloatArray | None]:
        """Simulate, and remember it: one of them is asked for again."""
        found = self._simulations.several(several)
        self._last = [(x.copy(), one) for x, one in zip(several, found, strict=True)]
        return found

    def draw(self, x: FloatArray, bandwidth: float) -> FloatArray:
        """
        Draw the simulations towards the measured strain from now on.

        An error of phase grows along a recording, and small differences where a gear crosses its
        play grow by themselves; so an arm that only follows positions is far off wherever its
        parameters are a little wrong. Drawn towards the strain it forgets errors within
        1/bandwidth, and what is left are errors of prediction, smooth in the parameters. Gains of
        gauges then act on the simulation too, and are searched like the parameters.

        x (unknowns,); bandwidth [1/s]: 0 to follow positions alone; returns (unknowns,).
        """
        moments = self.moments(x)
        gauges = None if moments is None else self.gauges(moments, x)
        drawn = False
        if moments is not None and gauges is not None and bandwidth > 0.0:
            errors = self.errors(moments, x)
            noise = robust_scale(errors, self.strain)
            trusted = self.strain + np.clip(errors, -TRUSTED * noise, TRUSTED * noise) - errors
            drawn = self._simulations.draw(x, trusted, gauges, noise / np.abs(gauges[:, 0]),
                                           bandwidth)
        else:
            self._simulations.release()
        self._gains = None if gauges is None or not drawn else gauges[:, 0]
        self._last = []
        return self.extended(x)

    def gauges(self, moments: FloatArray, x: FloatArray) -> FloatArray:
        """
        Find gain and offset of each gauge for given moments.

        moments (samples, gauges) [N m], x (unknowns,); returns (gauges, 2): gain
        [unit of the gauge per N m] and offset [unit of the gauge].
        """
        result = np.empty((moments.shape[1], 2))
        for g in range(moments.shape[1]):
            w = self.weights[:, g]
            if self._gains is None:
                columns = np.column_stack([moments[:, g] * w, w])
                result[g] = np.linalg.lstsq(columns, self.strain[:, g] * w, rcond=None)[0]
            else:
                gain = self._gains[g] * np.exp(x[len(self.names) + g])
                result[g] = gain, w**2 @ (self.strain[:, g] - gain * moments[:, g]) / (w @ w)
        return result

    def errors(self, moments: FloatArray, x: FloatArray) -> FloatArray:
        """
        Give measured less simulated strain, with the gains and offsets of ``gauges``.

        moments (samples, gauges) [N m], x (unknowns,).
        """
        gains = self.gauges(moments, x)
        return np.asarray(self.strain - moments * gains[:, 0] - gains[:, 1])

    def fits(self, several: Sequence[FloatArray]) -> list[float]:
        """
        Give the fit on all records for several vectors; -inf where one cannot be simulated [%].

        several (unknowns,).
        """
        return [-np.inf if moments is None else fit_percent(self.errors(moments, x), self.strain)
                for x, moments in zip(several, self._simulations.several(several), strict=True)]

    def residuals(self, several: Sequence[FloatArray]) -> list[FloatArray]:
        """
        Give the weighted errors, and how far the parameters are from their prior.

        several (unknowns,); returns (samples * gauges + names,).
        """
        result = []
        for x, moments in zip(several, self._kept(several), strict=True):
            errors = (np.full(self.strain.size, HOPELESS) if moments is None
                      else (self.errors(moments, x) * self.weights).ravel())
            result.append(np.concatenate([
                errors, (x[:len(self.names)] - self.center) / self.width]))
        return result

    def slopes(self, x: FloatArray) -> FloatArray:
        """
        Differentiate the moments by each unknown.

        x (unknowns,); returns (unknowns, samples, gauges).
        """
        here = self.moments(x)
        if here is None:
            return np.zeros((len(x), *self.strain.shape))

        return np.array([
            np.zeros_like(here) if there is None else (there - here) / STEP
            for there in self._simulations.several(list(x + STEP * np.eye(len(x))))])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """
        Differentiate ``residuals``; what a gain or an offset can take up is left out.

        x (unknowns,).
        """
        slopes = self.slopes(x)
        moments = self.moments(x)
        size, n = self.strain.size, len(self.names)
        result = np.zeros((size + n, len(x)))
        result[size:, :n] = np.diag(1.0 / self.width)
        if moments is None:
            return result
        gains = self.gauges(moments, x)
        shape = self.strain.shape
        for g in range(shape[1]):
            w = self.weights[:, g]
            columns = -(slopes[:, :, g] * gains[g, 0] * w).T
            if self._gains is None:
                basis, _ = np.linalg.qr(np.column_stack([moments[:, g] * w, w]))
            else:
                columns[:, n + g] -= moments[:, g] * gains[g, 0] * w
                basis = (w / np.linalg.norm(w))[:, None]
            columns -= basis @ (basis.T @ columns)
            result[g:size:shape[1]] = columns
        return result
