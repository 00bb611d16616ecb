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
The onset statistic: what the residual of the last 100 ms does that its past does not explain.

The residual of a rigid-body model rings with the links, and a threshold above that ringing finds a
touch late. Ringing can be foretold from its own past: a vector autoregression, learned from free
motion, predicts the residual one step ahead, and the statistic is the sum of its errors over a
window. A contact pushes all of them the same way, long before it rises above the ringing. It
answers to onsets only; what lasts is the business of the residual itself.

The steps are 10 ms long whatever the sample rate is: the past is interpolated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

STEP = 0.01
"""Step of the autoregression; longer where samples come more slowly [s]."""
LAGS = 10
"""Steps of the past that foretell the next."""
WINDOW = 10
"""Steps over which errors are summed."""
GROWTH = 1024


def learn_taps(
    records: Sequence[tuple[FloatArray, FloatArray]], step: float,
) -> FloatArray:
    """
    Learn the autoregression and fold it with the window into one filter.

    step [s]; returns (LAGS + WINDOW, channels, channels).
    """
    n = records[0][1].shape[1]
    gram, moment = np.zeros((LAGS * n, LAGS * n)), np.zeros((LAGS * n, n))
    for t, residual in records:
        lagged = _lagged(t, residual, step, LAGS + 1)[_complete(t, step, LAGS + 1)]
        past = lagged[:, 1:].reshape(len(lagged), -1)
        gram += past.T @ past
        moment += past.T @ lagged[:, 0]
    scale = np.sqrt(np.diag(gram)) + 1e-300
    scaled = gram / np.outer(scale, scale) + 1e-9 * np.eye(len(gram))
    weights = (np.linalg.solve(scaled, moment / scale[:, None]) / scale[:, None])
    weights = weights.reshape(LAGS, n, n)
    taps = np.zeros((LAGS + WINDOW, n, n))
    for k in range(WINDOW):
        taps[k] += np.eye(n)
        taps[k + 1:k + 1 + LAGS] -= weights
    return taps


def _lagged(t: FloatArray, x: FloatArray, step: float, count: int) -> FloatArray:
    """Give x at t, t - step, ...; shape (n_samples, count, n_channels)."""
    out = np.empty((len(t), count, x.shape[1]))
    for lag in range(count):
        for channel in range(x.shape[1]):
            out[:, lag, channel] = np.interp(t - lag * step, t, x[:, channel])
    return out


def _complete(t: FloatArray, step: float, count: int) -> NDArray[np.bool_]:
    return np.asarray(t - t[0] >= (count - 1) * step - 1e-6 * step)


class OnsetFilter:
    """
    Evaluates the statistic.

    taps (taps, channels, channels), step [s], t, x (places,) [s], ages (taps,) [s], weights
    (taps channels, channels).
    """

    def __init__(self, taps: FloatArray, step: float) -> None:
        self.taps = taps
        self.step_time = step
        self.ages: FloatArray = step * np.arange(len(taps), dtype=np.float64)[::-1]
        # interp wants increasing times: the oldest first
        self.weights = np.ascontiguousarray(taps[::-1]).reshape(-1, taps.shape[1])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        channels = self.taps.shape[1]
        self.t = np.empty(2 * GROWTH)
        self.x = np.empty((2 * GROWTH, channels))
        self.count = self.begin = 0
        self._origin = 0

    def process(self, t: FloatArray, residual: FloatArray) -> FloatArray:
        """
        Evaluate a gapless record at once.

        t (samples,) [s], residual (samples, channels) [its unit]; returns (samples, channels).
        """
        lagged = _lagged(t, residual, self.step_time, len(self.taps))
        out = np.einsum('tkc,kcd->td', lagged, self.taps)
        out[~_complete(t, self.step_time, len(self.taps))] = 0.0
        return np.asarray(out)

    def step(self, stamp: int, residual: FloatArray, first: bool) -> FloatArray:
        """
        Evaluate one sample.

        stamp [ns], residual (channels,) [its unit]; returns (channels,).
        """
        known = self.take_place(stamp, first)
        self.x[self.count - 1] = residual
        if not known:
            return np.zeros(len(residual))
        out = np.empty(len(residual))
        self.begin = weigh(self.t, self.x, self.begin, self.count, self.ages, self.weights, out)
        return out

    def take_place(self, stamp: int, first: bool) -> bool:
        """
        Make a place for the residual of a sample, the last in use; whoever asks fills it.

        stamp [ns].
        """
        if first or self.count == 0:
            self.count = self.begin = 0
            self._origin = stamp
        now = (stamp - self._origin) * 1e-9
        if self.count == len(self.x):
            self._make_room()
        self.t[self.count] = now
        self.count += 1
        return bool(self.count >= 2 and now >= self.ages[0] - 1e-6 * self.step_time)

    def _make_room(self) -> None:
        keep = self.count - self.begin
        t, x = self.t, self.x
        if keep > len(x) // 2:
            t, x = np.empty(2 * len(x)), np.empty((2 * len(x), x.shape[1]))
        t[:keep] = self.t[self.begin:self.count].copy()
        x[:keep] = self.x[self.begin:self.count].copy()
        self.t, self.x, self.count, self.begin = t, x, keep, 0


@compiled
def weigh(
    t: FloatArray, x: FloatArray, begin: int, count: int, ages: FloatArray, weights: FloatArray,
    out: FloatArray,
) -> int:
    """Interpolate the past at the ages, oldest first, and weigh it; gives the new beginning."""
    n, now, j = len(out), t[count - 1], begin
    out[:] = 0.0
    for k in range(len(ages)):
        at = now - ages[k]
        while j + 2 < count and t[j + 1] <= at:
            j += 1
        if k == 0:
            begin = j
        share = max(0.0, (at - t[j]) / (t[j + 1] - t[j]))
        for channel in range(n):
            value = x[j, channel] + share * (x[j + 1, channel] - x[j, channel])
            for i in range(n):
                out[i] += value * weights[k * n + channel, i]
    return begin
