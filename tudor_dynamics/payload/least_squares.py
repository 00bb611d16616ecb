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
Least squares of a load on what a model leaves over, with errors for residuals that are coloured.

Each channel has terms to itself (zero, another day's friction), which are projected out. Residuals
of a model ring and drift: the covariance of the estimate is that of Newey and West ("A simple,
positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix",
Econometrica 55(3), 1987) over a window that is longer than an oscillation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.typing import FloatArray

WINDOW = 2.0
"""Time over which residuals are taken to depend on each other [s]."""
PASSES = 4
"""Turns of weights of the channels and parameters."""
FLAT = 1e-9
"""Part of a row's size below which it is nothing but rounding."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Parameters of a load as one output tells them."""

    parameters: FloatArray  # (parameters,): least squares; directions that are not shown are zero
    # (parameters, parameters): inverse of the covariance; singular where directions are not shown.
    information: FloatArray
    # (samples, channels): what is left over without and with the load, each channel's own terms
    # left out, in its unit.
    before: FloatArray
    after: FloatArray


def solve_load(
    residual: FloatArray, rows: FloatArray, own: Sequence[FloatArray], rate: float,
) -> Solution:
    """
    Explain residuals by a load.

    residual (samples, channels), rows (samples, channels, parameters), own (samples, own), rate
    [Hz].
    """
    count = residual.shape[1]
    free, left = np.empty_like(rows), np.empty_like(residual)
    for i in range(count):
        basis = np.linalg.qr(own[i])[0]
        free[:, i] = rows[:, i] - basis @ (basis.T @ rows[:, i])
        left[:, i] = residual[:, i] - basis @ (basis.T @ residual[:, i])
    size = np.linalg.norm(rows, axis=(0, 1))
    # a row that its own terms take up leaves rounding, which is no information
    free[:, :, np.linalg.norm(free, axis=(0, 1)) <= FLAT * size] = 0.0
    scale = np.where(size > 0.0, size, 1.0)
    free = free / scale
    before = left.std(axis=0)
    told = before > 0.0
    deviation = before.copy()
    parameters: FloatArray = np.zeros(rows.shape[2])
    for _ in range(PASSES):
        weight = np.where(told, 1.0 / np.where(told, deviation, 1.0), 0.0)
        x = (free * weight[:, None]).reshape(-1, rows.shape[2])
        parameters = np.asarray(
            np.linalg.lstsq(x, (left * weight).reshape(-1), rcond=1e-8)[0])
        error = left - free @ parameters
        deviation = np.maximum(error.std(axis=0), 1e-9 * before)
    scores = np.einsum('kcp,kc->kp', free * weight[:, None] ** 2, error)
    gram = x.T @ x
    window = min(round(WINDOW * rate), len(scores) // 4)
    # a window that is a part of the recording has an error of its own: two standard deviations
    # are those of Kiefer and Vogelsang, "A new asymptotic theory for heteroskedasticity-
    # autocorrelation robust tests", Econometric Theory 21(6), 2005, Table 1, Bartlett's kernel
    share = window / len(scores)
    wider = 1.0 + (2.9694 * share + 0.4160 * share ** 2 - 0.5324 * share ** 3) / 1.96
    spread = long_run(scores, window) * wider ** 2
    # of a load as of the noise: a spread that a short recording shows by chance is no less
    spread = spread + FLAT * np.trace(spread) * np.eye(len(spread))
    information = gram @ np.linalg.pinv(spread, rcond=1e-12, hermitian=True) @ gram
    return Solution(parameters / scale, information * np.outer(scale, scale), left, error)


def long_run(scores: FloatArray, window: int) -> FloatArray:
    """
    Sum the covariances of a series over lags, with weights that fall linearly.

    scores (samples, parameters); returns (parameters, parameters).
    """
    total = scores.T @ scores
    for lag in range(1, window + 1):
        part = scores[lag:].T @ scores[:-lag]
        total += (1.0 - lag / (window + 1.0)) * (part + part.T)
    return np.asarray(total)
