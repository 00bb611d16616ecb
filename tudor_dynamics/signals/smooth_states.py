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

"""A signal with its first and second derivative, all three behind the same filter."""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.signals.filters import low_pass, low_pass_gain
from tudor_dynamics.typing import FloatArray

SETTLED = 10.0
"""Lags of one stage until the beginning is forgotten."""


class SmoothStates:
    """
    Three first-order low-passes in a row, whose differences are the derivatives.

    Of signals that went through the same one, each derivative is late by the same time, and what
    is linear between them stays so (the state variable filter of continuous-time identification:
    Garnier, Mensler and Richard, "Continuous-time model identification from sampled data", Int. J.
    Control 76(13), 2003).

    Parameters
    ----------
    cutoff : float
        Corner frequency of each [Hz].

    """

    def __init__(self, cutoff: float) -> None:
        self.cutoff = cutoff
        self._pole = 2.0 * math.pi * cutoff
        self._stages: FloatArray | None = None
        # the last stage, how it changes, and how that does
        pole = self._pole
        self._differences = np.array([[0.0, 0.0, 1.0], [0.0, pole, -pole],
                                      [pole ** 2, -2.0 * pole ** 2, pole ** 2]])

    @property
    def settle(self) -> float:
        """Give the time behind a beginning for which derivatives are wrong [s]."""
        return SETTLED / self._pole

    def step(self, dt: float, x: FloatArray) -> FloatArray:
        """
        Filter one sample.

        Parameters
        ----------
        dt : float
            Time since the sample before; 0 begins anew [s].
        x : ndarray of shape (n_channels,)
            Sample of the signal.

        Returns
        -------
        ndarray of shape (3, n_channels)
            Signal, its first and its second derivative [1, 1/s, 1/s^2 of its unit].

        """
        if self._stages is None or dt <= 0.0:
            self._stages = np.tile(x, (3, 1))
        else:
            gain, before = low_pass_gain(self.cutoff, dt), x
            for stage in self._stages:
                stage += gain * (before - stage)
                before = stage
        return self._differences @ self._stages

    def process(self, dt: FloatArray, x: FloatArray) -> FloatArray:
        """
        Filter a gapless record at once.

        Parameters
        ----------
        dt : ndarray of shape (n_samples,)
            Time since the sample before; that of the first counts for nothing [s].
        x : ndarray of shape (n_samples, n_channels)
            Signal, a channel a column.

        Returns
        -------
        ndarray of shape (3, n_samples, n_channels)
            As from `step`.

        """
        stages = [x]
        for _ in range(3):
            later = low_pass(stages[-1][1:], dt[1:], self.cutoff, x[0])
            stages.append(np.vstack([x[:1], later]))
        return np.tensordot(self._differences, np.array(stages[1:]), 1)
