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

SETTLED = 16.0
"""Lags of one stage until the beginning is forgotten, to 1e-4 of an acceleration."""


class SmoothStates:
    """
    Three first-order low-passes in a row, and central differences of the last one's output.

    Of signals that went through the same one, each derivative is late by the same time, and what
    is linear between them stays so (the state variable filter of continuous-time identification:
    Garnier, Mensler and Richard, "Continuous-time model identification from sampled data", Int. J.
    Control 76(13), 2003).

    cutoff [Hz].
    """

    def __init__(self, cutoff: float) -> None:
        self.cutoff = cutoff
        self._pole = 2.0 * math.pi * cutoff
        self._stages: FloatArray | None = None
        self._before = 0.0

    @property
    def settle(self) -> float:
        """Give the time behind a beginning for which derivatives are wrong [s]."""
        return SETTLED / self._pole

    def step(self, dt: float, x: FloatArray) -> FloatArray:
        """
        Filter one sample.

        x (channels,); dt [s]: 0 begins anew; returns (3, channels) [1, 1/s, 1/s^2 of its unit].
        """
        if self._stages is None or dt <= 0.0:
            self._stages = np.tile(x, (5, 1))
            self._before = 0.0
            return central(1.0, 1.0) @ self._stages[2:]
        stages, gain, before = self._stages, low_pass_gain(self.cutoff, dt), x
        stages[4], stages[3] = stages[3], stages[2]
        for stage in stages[:3]:
            stage += gain * (before - stage)
            before = stage
        earlier, self._before = self._before or dt, dt
        return central(dt, earlier) @ stages[2:]

    def process(self, dt: FloatArray, x: FloatArray) -> FloatArray:
        """
        Filter a gapless record at once.

        dt (samples,) [s], x (samples, channels); returns (3, samples, channels).
        """
        if not len(x):
            return np.zeros((3, *x.shape))
        last = x
        for _ in range(3):
            last = np.vstack([x[:1], low_pass(last[1:], dt[1:], self.cutoff, x[0])])
        lasts = np.array([last, last[np.maximum(np.arange(len(x)) - 1, 0)],
                          last[np.maximum(np.arange(len(x)) - 2, 0)]])
        times = np.maximum(np.where(np.arange(len(x)) > 0, dt, 1.0), 1e-9)
        earlier = np.concatenate([[1.0], times[1:2], times[1:-1]])[:len(x)]
        found: FloatArray = np.einsum('dvn,vnc->dnc', central(times, earlier), lasts)
        return found


def central(dt: float | FloatArray, earlier: float | FloatArray) -> FloatArray:
    """
    Give what the middle of three values, and its derivatives, take of them, the last first.

    dt, earlier (samples,) [s]; returns (3, 3) or (3, 3, samples) [1, 1/s, 1/s^2].
    """
    both, nothing = dt + earlier, 0.0 * dt
    return np.array([
        [nothing, nothing + 1.0, nothing],
        [earlier / (dt * both), (dt / earlier - earlier / dt) / both, -dt / (earlier * both)],
        [2.0 / (dt * both), -2.0 / (dt * earlier), 2.0 / (earlier * both)]])
