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
What a motion shows of the parameters of models: information, standard errors, and their slopes.

The information about the parameters of a group of channels is ``sum_c Y_c' Y_c / sigma_c^2`` over
its rows; the inverse is the covariance of weighted least squares. The slope by the motion goes
through the rows: each coordinate of all samples is moved at once, since a row depends on its own
sample alone, so that a gradient costs 3 n_joints evaluations whatever the motion is made of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.regressor import Regressor
from tudor_dynamics.typing import FloatArray

STEP = 1e-6
"""Step of difference quotients [rad, rad/s, rad/s^2 or m, m/s, m/s^2]."""
LEAST = 1e-12
"""Part of the largest eigenvalue of a scaled information matrix that every direction is given:
what a motion does not show at all is expensive, not infinite."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A model whose parameters are to be shown."""

    model: AnalyticalModel  # model of efforts or strains; it need not be fitted
    noise: FloatArray  # standard deviation of each channel, in its unit, (channels,)


@dataclass(frozen=True, eq=False)
class _Group:
    """Channels with common parameters, and what brings their rows to units of the noise."""

    channels: list[int]
    kept: NDArray[np.intp]
    factor: FloatArray

    @classmethod
    def of(cls, subject: Subject, place: int) -> _Group:
        """Give one group of a model."""
        model, base = subject.model, subject.model.base_[place]
        channels = list(base.channels)
        factor = np.repeat(1.0 / subject.noise[channels, None], len(base.kept), axis=1)
        constants = model.groups_[place].constants if model.groups_ else None
        if constants is not None:
            factor[:, model.regressor.scaled[base.kept]] /= constants.values[:, None]
        return cls(channels, base.kept, factor)

    def rows(self, rows: FloatArray) -> FloatArray:
        """Pick the group's own rows, in units of the noise."""
        return rows[:, self.channels][:, :, self.kept] * self.factor


Criterion = Callable[[Sequence[FloatArray]], tuple[float, list[FloatArray]]]
"""From the covariance of each group to a cost, and its slope by the information of each."""


def mean_error(covariances: Sequence[FloatArray]) -> tuple[float, list[FloatArray]]:
    """Give the mean logarithm of all standard errors: units and sizes do not matter."""
    count = sum(len(item) for item in covariances)
    cost, slopes = 0.0, []
    for covariance in covariances:
        variance = np.diag(covariance)
        cost += 0.5 * float(np.sum(np.log(variance))) / count
        slopes.append(-0.5 / count * (covariance / variance) @ covariance)
    return cost, slopes


class Information:
    """Information that motions hold about the parameters of several models."""

    def __init__(self, subjects: Sequence[Subject]) -> None:
        self._parts: list[tuple[Regressor, list[_Group]]] = []
        for subject in subjects:
            regressor = subject.model.regressor
            regressor.assume(None)
            self._parts.append((regressor, [
                _Group.of(subject, place) for place in range(len(subject.model.base_))]))

    def matrices(self, motion: FloatArray) -> list[FloatArray]:
        """
        Give the information matrix of each group of channels of all models.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        return [_square(rows) for rows in self.rows(motion)]

    def rows(self, motion: FloatArray) -> list[FloatArray]:
        """
        Give the rows of each group in units of its noise, (n_samples, n_channels, n_parameters).

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        """
        found = [(regressor.rows(motion), groups) for regressor, groups in self._parts]
        return [group.rows(rows) for rows, groups in found for group in groups]

    def cost(
        self, motion: FloatArray, criterion: Criterion = mean_error,
    ) -> tuple[float, FloatArray]:
        """
        Judge a motion.

        motion (samples, 3 joints): ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2];
        returns (samples, 3 joints).
        """
        rows = [regressor.rows(motion) for regressor, _ in self._parts]
        cost, slopes = criterion([
            covariance_of(_square(group.rows(rows_)))
            for rows_, (_, groups) in zip(rows, self._parts, strict=True) for group in groups])
        slope = np.zeros_like(motion)
        place = 0
        for rows_, (regressor, groups) in zip(rows, self._parts, strict=True):
            pulls = []
            for group in groups:
                pulls.append(2.0 * (group.rows(rows_) @ slopes[place]))
                place += 1
            for k in range(motion.shape[1]):
                moved = motion.copy()
                moved[:, k] += STEP
                change = (regressor.rows(moved) - rows_) / STEP
                for group, pull in zip(groups, pulls, strict=True):
                    slope[:, k] += np.einsum('scp,scp->s', pull, group.rows(change))
        return cost, slope


def _square(rows: FloatArray) -> FloatArray:
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def covariance_of(information: FloatArray) -> FloatArray:
    """
    Invert an information matrix in units of its columns.

    information (parameters, parameters); returns (parameters, parameters).
    """
    size = np.sqrt(np.diag(information))
    size = np.where(size > 0.0, size, 1e-6 * max(float(size.max(initial=0.0)), 1e-300))
    values, vectors = linalg.eigh(information / np.outer(size, size))
    values = np.maximum(values, 0.0) + LEAST * max(float(values[-1]), 1e-300)
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))
