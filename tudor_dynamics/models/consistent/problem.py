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

"""Errors of full parameters on data, their distance from a description, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base_parameters import random_inputs
from tudor_dynamics.models.consistent.bodies import PARAMETERS, parameters_of, Prior, slopes_of
from tudor_dynamics.models.consistent.drives import energy_rows, PEAK, raised
from tudor_dynamics.models.estimation.products import Products, triangle
from tudor_dynamics.models.estimation.torque_constants import CORRELATED, PRIOR_WIDTH
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.typing import FloatArray

WIDTH_DRIVE = 3.0
"""Width of what drives may contribute to an output, in units of the output's size: no knowledge,
but a bound on what nothing shows."""
WIDTH_CONSTANT = 3.0
"""Standard deviation of the logarithm of all torque constants together: no knowledge."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Full parameters."""

    # Mass, first moments, inertia about the joint of each body, (bodies, 10) [kg, kg m, kg m^2].
    bodies: FloatArray
    # (drive_columns,): rotor inertias and friction, in the units of the regressor's columns.
    drives: FloatArray
    # (channels,): torque per unit of each channel beyond what is described; 1 where that is known.
    constants: FloatArray
    # Standard errors of the same shapes; of the constants relative ones.
    body_errors: FloatArray
    drive_errors: FloatArray
    constant_errors: FloatArray
    body_widths: FloatArray  # standard deviations before any data, (bodies, 10)
    described: bool  # whether masses stood in the description
    # Largest speed of each joint over which its friction is known to take energy, (channels,)
    # [rad/s or m/s].
    speeds: FloatArray
    # Root mean square of what each joint carries, where friction grows with it; else 0,
    # (channels,) [N m or N].
    loads: FloatArray
    # (channels,): relative error of each channel on the training data: of these parameters, and of
    # base parameters that need not belong to any bodies.
    relative_errors: FloatArray
    free_errors: FloatArray


class Problem:
    """
    Residuals of data and of prior knowledge, and their derivatives.

    Unknowns are log-Cholesky parameters of all bodies, in units of their widths from their
    centres; parameters of drives in units of their sizes; logarithms of unknown torque constants.
    What drives must not do (``energy_rows``) counts as an error where they do it.
    """

    def __init__(
        self, arm: Arm, model: AnalyticalModel, products: Sequence[Sequence[Products]],
        prior: Prior,
    ) -> None:
        together = EffortRegressor(arm, shared=True)
        self.columns = model.regressor.columns
        self.scaled = together.scaled if together.unknown else np.zeros(
            len(self.columns), dtype=np.bool_)
        self.unknown = together.unknown
        self.absolute = len(self.unknown) < len(model.channels)
        self.prior = prior
        self.n_channels = len(model.channels)
        self.n_bodies = len(prior.center)
        self.first = PARAMETERS * self.n_bodies
        self.parts: list[tuple[int, FloatArray, FloatArray]] = []
        self.free = np.zeros(self.n_channels)
        rows = model.regressor.rows(random_inputs(
            model.regressor, model.n_joints, len(self.columns) + 20, 0))
        coefficients = model.coefficients()
        for group, data in zip(model.groups_, products, strict=True):
            kept = group.base.kept
            for channel, product, variance in zip(
                    group.base.channels, data, group.estimate.variances, strict=True):
                # what of a row the other columns are, on the base columns
                mixture = np.linalg.lstsq(rows[:, channel, kept], rows[:, channel], rcond=1e-10)[0]
                factor = product.factor() / np.sqrt(variance)
                self.parts.append((channel, factor[:, :-1] @ mixture, factor[:, -1]))
                best = np.linalg.norm(factor[:, :-1] @ coefficients[channel, kept]
                                      - factor[:, -1])
                self.free[channel] = best / max(float(np.linalg.norm(factor[:, -1])), 1e-300)
        self.parts.sort(key=lambda part: part[0])
        self.sizes = self._sizes()
        self.data = self._joined()
        speeds = _mean_sizes(model, products, 'viscous')
        self.speeds = PEAK * np.where(speeds > 0.0, speeds, 1.0 / PEAK)
        self.loads = _mean_sizes(model, products, 'load')
        self.rows = energy_rows(arm, self.columns[self.first:], self.speeds)
        steps = self.rows * self.sizes
        self.steps = steps / np.maximum(np.abs(steps).max(axis=1, keepdims=True), 1e-300)
        self.trusted = self.strict = 1.0

    def _joined(self) -> list[tuple[int, FloatArray, FloatArray]]:
        """Give the data with all channels of known constants as one, which has fewer rows."""
        known = [part for part in self.parts if part[0] not in self.unknown]
        if not known:
            return self.parts
        whole = triangle(np.vstack([np.column_stack([matrix, target])
                                    for _, matrix, target in known]))
        return [(known[0][0], whole[:, :-1], whole[:, -1]),
                *(part for part in self.parts if part[0] in self.unknown)]

    def _sizes(self) -> FloatArray:
        """Give the size of each drive parameter that would make an output's whole size."""
        size = np.full(len(self.columns) - self.first, np.inf)
        for _, matrix, target in self.parts:
            norms = np.linalg.norm(matrix[:, self.first:], axis=0)
            whole = float(np.linalg.norm(target))
            size = np.minimum(size, np.where(norms > 1e-9 * whole, whole / np.maximum(
                norms, 1e-300), np.inf))
        return np.where(np.isfinite(size), size, 1.0)

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give full parameters, logarithms of constants, log-Cholesky parameters."""
        end = self.first + len(self.sizes)
        logs = self.prior.center + self.prior.width * x[:self.first].reshape(-1, PARAMETERS)
        constants = np.zeros(self.n_channels)
        constants[list(self.unknown)] = x[end:]
        full = np.concatenate([*(parameters_of(log) for log in logs),
                               self.sizes * x[self.first:end]])
        return full, constants, logs

    def start(self) -> FloatArray:
        """Begin with the bodies as described, and drives and constants that suit them best."""
        x = np.zeros(self.first + len(self.sizes) + len(self.unknown))
        full, _, _ = self._split(x)
        for channel, matrix, target in self.parts:
            own = np.flatnonzero(np.linalg.norm(matrix[:, self.first:], axis=0) > 0.0)
            bodies = matrix[:, :self.first] @ full[:self.first]
            columns = np.column_stack([matrix[:, self.first + own] * self.sizes[own], bodies])
            best = np.linalg.lstsq(columns, target, rcond=1e-8)[0]
            x[self.first + own] = best[:-1]
            if channel in self.unknown:
                share = max(float(best[-1]), 1e-3 * float(np.linalg.norm(target))
                            / max(float(np.linalg.norm(bodies)), 1e-300))
                x[self.first + len(self.sizes) + self.unknown.index(channel)] = -np.log(share)
        return x

    def residual(self, x: FloatArray) -> FloatArray:
        """
        Give errors of the data in their noise, distances from the prior, energy of drives.

        x (unknowns,).
        """
        full, constants, _ = self._split(x)
        found = []
        for channel, matrix, target in self.data:
            factor = np.where(self.scaled, np.exp(-constants[channel]), 1.0)
            found.append(self.trusted * (matrix @ (full * factor) - target))
        taken = self.steps @ x[self.first:self.first + len(self.sizes)]
        return np.concatenate([*found, self._distance(x), self.strict * np.minimum(taken, 0.0)])

    def _distance(self, x: FloatArray) -> FloatArray:
        end = self.first + len(self.sizes)
        logs = x[end:]
        mean = logs.mean(keepdims=True) if len(logs) else logs
        return np.concatenate([
            x[:self.first], x[self.first:end] / WIDTH_DRIVE, (logs - mean) / PRIOR_WIDTH,
            mean / WIDTH_CONSTANT])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Differentiate `residual`, shape (n_residuals, n_unknowns): x (unknowns,)."""
        full, constants, logs = self._split(x)
        end = self.first + len(self.sizes)
        inner = np.zeros((len(full), end))
        for i, log in enumerate(logs):
            part = slice(PARAMETERS * i, PARAMETERS * (i + 1))
            inner[part, part] = slopes_of(log) * self.prior.width[i]
        inner[self.first:, self.first:] = np.diag(self.sizes)
        found = []
        for channel, matrix, _ in self.data:
            factor = np.where(self.scaled, np.exp(-constants[channel]), 1.0)
            block = np.zeros((len(matrix), len(x)))
            block[:, :end] = matrix @ (factor[:, None] * inner)
            if channel in self.unknown:
                block[:, end + self.unknown.index(channel)] = -matrix @ (
                    full * np.where(self.scaled, factor, 0.0))
            found.append(self.trusted * block)
        n = len(self.unknown)
        own = np.eye(len(x))
        own[self.first:end] /= WIDTH_DRIVE
        own[end:, end:] = (np.eye(n) - 1.0 / max(n, 1)) / PRIOR_WIDTH
        mean = np.zeros((min(n, 1), len(x)))
        mean[:, end:] = 1.0 / (max(n, 1) * WIDTH_CONSTANT)
        energy = np.zeros((len(self.steps), len(x)))
        active = self.steps @ x[self.first:end] < 0.0
        energy[active, self.first:end] = self.strict * self.steps[active]
        return np.vstack([*found, own, mean, energy])

    def reweigh(self, x: FloatArray) -> None:
        """
        Take the noise of each channel from what bodies that can exist leave over of it.

        x (unknowns,).
        """
        ratios = self.free / np.maximum(self._errors(x), 1e-300)
        self.parts = [(channel, ratios[channel] * matrix, ratios[channel] * target)
                      for channel, matrix, target in self.parts]
        self.data = self._joined()

    def _errors(self, x: FloatArray) -> FloatArray:
        """Give the relative error of each channel."""
        full, constants, _ = self._split(x)
        factors = np.where(self.scaled, np.exp(-constants)[:, None], 1.0)
        return np.array([
            np.linalg.norm(matrix @ (full * factors[channel]) - target)
            / max(float(np.linalg.norm(target)), 1e-300)
            for channel, matrix, target in self.parts])

    def solution(self, x: FloatArray) -> Solution:
        """
        Give the parameters with their errors; several samples of data count as one.

        x (unknowns,).
        """
        full, constants, logs = self._split(x)
        end = self.first + len(self.sizes)
        jacobian = self.jacobian(x)[:-len(self.steps) or None]
        rows = sum(len(matrix) for _, matrix, _ in self.data)
        jacobian[:rows] /= np.sqrt(CORRELATED)
        information = jacobian.T @ jacobian
        covariance = linalg.pinvh(information)
        errors, widths = np.empty((2, self.n_bodies, PARAMETERS))
        for i, log in enumerate(logs):
            part = slice(PARAMETERS * i, PARAMETERS * (i + 1))
            slope = slopes_of(log) * self.prior.width[i]
            errors[i] = np.sqrt(np.diag(slope @ covariance[part, part] @ slope.T))
            before = slopes_of(self.prior.center[i]) * self.prior.width[i]
            widths[i] = np.sqrt(np.sum(before ** 2, axis=1))
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        relative = np.zeros(self.n_channels)
        relative[list(self.unknown)] = deviation[end:]
        drives = raised(full[self.first:], self.columns[self.first:], self.rows)
        return Solution(full[:self.first].reshape(-1, PARAMETERS), drives, np.exp(constants),
                        errors, self.sizes * deviation[self.first:end], relative, widths,
                        self.prior.described, self.speeds, self.loads, self._errors(x),
                        self.free)


def _mean_sizes(
    model: AnalyticalModel, products: Sequence[Sequence[Products]], term: str,
) -> FloatArray:
    """Give the root mean square of a friction term's columns by joint, 0 where there are none."""
    found = np.zeros(len(model.channels))
    for group, data in zip(model.groups_, products, strict=True):
        for channel, product in zip(group.base.channels, data, strict=True):
            factor, joint = product.factor(), model.channels[channel]
            for i, column in enumerate(group.base.kept.tolist()):
                name = model.regressor.columns[column]
                if name.startswith(term) and name.endswith(f'({joint})'):
                    found[channel] += float(factor[:, i] @ factor[:, i]) / max(product.n, 1)
    return np.sqrt(found)
