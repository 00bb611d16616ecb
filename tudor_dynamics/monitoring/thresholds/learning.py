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

"""Learns thresholds from residuals of free motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, sparse

from tudor_dynamics.errors import FitError
from tudor_dynamics.monitoring.familiarity import levels, USUAL
from tudor_dynamics.monitoring.thresholds.accumulation import accumulate, UNSURE
from tudor_dynamics.monitoring.thresholds.features import MotionFeatures, REVERSAL_SPEED
from tudor_dynamics.monitoring.thresholds.onset import LAGS, learn_taps, OnsetFilter, STEP, WINDOW
from tudor_dynamics.monitoring.thresholds.stiction import held_friction, released
from tudor_dynamics.monitoring.thresholds.thresholds import BLOCK, MethodThresholds, Tail
from tudor_dynamics.typing import FloatArray

GROUP = 0.08
"""Time of which the largest value counts for the profile [s]."""
QUANTILE = 0.8
"""Share of the groups that stay below the profile."""
ROWS = 1500
"""Rows of a quantile regression; more make it slow and hardly better."""
MIN_BLOCKS = 8
"""Seconds of free motion below which nothing can be said of a tail."""
MAX_BOUND = 0.5
"""Tails that end more abruptly are an artefact of few peaks."""
UPPER = 0.2
"""Share of the peaks whose excess makes up the tail, where there are enough."""
FEWEST = 20
"""Peaks that make up a tail at least, where there are no more."""
MAX_SHARE = 0.5
"""More of the peaks are no tail."""
SHAPE_ERROR = 2.0 / math.sqrt(3.0)
"""Standard error of an exponential tail's shape, times the root of the number of peaks."""
LEAST = (0.1, 0.1, 0.02)
"""Least scales: of residual and onset as ratios to their profiles, of the sum of onsets [s]."""
DOUBT = 2.0
"""Standard errors of the shape by which a bound is doubted."""


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """A gapless stretch of residuals while nothing touched the arm."""

    stamp: NDArray[np.int64]  # header stamps, (samples,) [ns]
    # `[q, dq, ddq]` of the active joints, in columns, (samples, 3 joints)
    # [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    # Residuals of a model that was not fitted to these samples, (samples, channels).
    residual: FloatArray

    @property
    def t(self) -> FloatArray:
        """Time since the first sample [s]."""
        return np.asarray((self.stamp - self.stamp[0]) * 1e-9)


def learn_thresholds(
    records: Sequence[FreeMotion], channels: tuple[str, ...],
    stiction: FloatArray | None = None,
) -> MethodThresholds:
    """Learn the thresholds of one method: stiction (channels,) [unit of the residual]."""
    if not records:
        msg = 'no free motion to learn thresholds from'
        raise FitError(msg)
    period = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
    step = max(STEP, period)
    records = [r for r in records if r.t[-1] > 2.0 * ((LAGS + WINDOW) * step + BLOCK)]
    seconds = float(sum(r.t[-1] for r in records))
    if seconds < MIN_BLOCKS * BLOCK:
        msg = (f'{seconds:.1f} s of free motion are too little for thresholds; at least '
               f'{MIN_BLOCKS * BLOCK:g} s without a gap are needed')
        raise FitError(msg)
    stiction = np.zeros(len(channels)) if stiction is None else stiction
    rows = _Rows(records, step, period, stiction)
    halves = [_Rows([_half(r, which) for r in records], step, period, stiction)
              for which in (0, 1)]
    # Ratios to a profile that was not learned from them: others are too small.
    laws = [(judged, learned.law()) for learned, judged in (halves, halves[::-1])]
    ratios = np.vstack([judged.ratios(*law, round(BLOCK / period)) for judged, law in laws])
    usual = np.quantile(np.vstack([judged.levels(*law) for judged, law in laws]), USUAL, axis=0)
    taps, profile = rows.law()
    n, alive = len(channels), rows.noise() > 0.0
    tails = tuple(_tail(column, LEAST[place // n] if alive[place % n] else 0.0)
                  for place, column in enumerate(ratios.T))
    return MethodThresholds(channels, step, taps, profile, tails, seconds,
                            np.asarray(usual), rows.reach(), stiction)


def _half(record: FreeMotion, which: int) -> FreeMotion:
    middle = len(record.stamp) // 2
    part = slice(middle, None) if which else slice(middle)
    return FreeMotion(record.stamp[part], record.motion[part], record.residual[part])


class _Rows:
    """What is learned from: residuals with the columns of their motion."""

    def __init__(
        self, records: Sequence[FreeMotion], step: float, period: float, stiction: FloatArray,
    ) -> None:
        self._records, self._step = records, step
        self._held = [held_friction(stiction, np.abs(r.motion[:, n:2 * n]))
                      if stiction.any() else np.zeros_like(r.residual)
                      for r in records for n in (len(stiction),)]
        self._free = [released(r.t, r.residual, held)
                      for r, held in zip(records, self._held, strict=True)]
        self._group = max(1, round(GROUP / period))
        self._skip = int(math.ceil((LAGS + WINDOW) * step / period))
        self._columns = []
        for record in records:
            features = MotionFeatures(record.motion.shape[1] // 3)
            self._columns.append(np.array([features.step(s, m) for s, m in zip(
                record.stamp.tolist(), record.motion, strict=True)])[self._skip:])

    def law(self) -> tuple[FloatArray, FloatArray]:
        """Learn taps and profile."""
        taps = learn_taps([(r.t, x) for r, x in zip(self._records, self._free, strict=True)],
                          self._step)
        columns = np.vstack([_largest(c, self._group) for c in self._columns])
        peaks = np.vstack([_largest(s, self._group) for s in self._sizes(taps)])
        least = np.concatenate([self.noise(), np.zeros(taps.shape[1])])
        return taps, np.array([_profile(columns, peaks[:, i], least[i])
                               for i in range(peaks.shape[1])])

    def ratios(self, taps: FloatArray, profile: FloatArray, block: int) -> FloatArray:
        """Give the largest ratio to a profile in each block, and the largest sums of onsets."""
        parts, n = [], taps.shape[1]
        for record, held, columns, sizes in zip(
                self._records, self._held, self._columns, self._sizes(taps), strict=True):
            usual = columns @ profile.T
            signs = np.sign(record.residual[self._skip:])
            scale = usual[:, :n] + UNSURE * held[self._skip:]
            sums = accumulate(np.diff(record.t[self._skip - 1:]), signs * sizes[:, :n] / scale)
            parts.append(_largest(np.hstack([sizes / usual, sums]), block))
        return np.vstack(parts)

    def levels(self, taps: FloatArray, profile: FloatArray) -> FloatArray:
        """Give the level of the onset statistics at each sample, as ratios to a profile."""
        n = taps.shape[1]
        return np.vstack([levels(np.diff(r.t[self._skip - 1:]), (s / (c @ profile.T))[:, n:])
                          for r, c, s in zip(self._records, self._columns, self._sizes(taps),
                                             strict=True)])

    def reach(self) -> FloatArray:
        """Give the largest speed of each joint; one that stood still moves from there on."""
        joints = (self._columns[0].shape[1] - 1) // 4
        largest = np.max([c[:, 1:1 + joints].max(axis=0) for c in self._columns], axis=0)
        return np.asarray(np.maximum(largest, REVERSAL_SPEED))

    def noise(self) -> FloatArray:
        """Give the size of what changes from sample to sample, for each residual."""
        return np.asarray(np.sqrt(0.5 * np.mean(np.vstack([
            np.diff(r.residual, axis=0) for r in self._records]) ** 2, axis=0)))

    def _sizes(self, taps: FloatArray) -> list[FloatArray]:
        """Give the sizes of residuals and onset statistics, once the past is complete."""
        return [np.hstack([np.maximum(np.abs(r.residual) - held, 0.0), np.abs(
            OnsetFilter(taps, self._step).process(r.t, x))])[self._skip:]
            for r, held, x in zip(self._records, self._held, self._free, strict=True)]


def _largest(x: FloatArray, count: int) -> FloatArray:
    """Take the largest of each ``count`` rows."""
    whole = len(x) // count * count
    return np.asarray(x[:whole].reshape(-1, count, x.shape[1]).max(axis=1))


def _profile(columns: FloatArray, peaks: FloatArray, least: float) -> FloatArray:
    """Fit a quantile of the peaks by non-negative columns, as a linear program."""
    stride = -(-len(peaks) // ROWS)
    columns, peaks = columns[::stride], peaks[::stride]
    n, p = columns.shape
    largest = np.maximum(columns.max(axis=0), 1e-12)
    # friction that holds covers a joint at rest altogether
    unit = float(np.median(peaks[peaks > 0.0])) if (peaks > 0.0).any() else max(least, 1e-300)
    identity = sparse.identity(n, format='csr')
    equal = sparse.hstack([sparse.csr_matrix(columns / largest), identity, -identity])
    found = optimize.linprog(
        np.concatenate([np.zeros(p), np.full(n, QUANTILE), np.full(n, 1.0 - QUANTILE)]),
        A_eq=equal, b_eq=peaks / unit, bounds=(0, None), method='highs')
    if not found.success:
        msg = f'the profile of a threshold could not be found ({found.message})'
        raise FitError(msg)
    profile = found.x[:p] * unit / largest
    # without a floor, standstill in the data would make the slightest noise a collision
    profile[0] = max(profile[0], 0.1 * unit)
    return np.asarray(profile)


def _tail(peaks: FloatArray, least: float) -> Tail:
    """
    Fit a generalised Pareto distribution to the highest peaks by L-moments (Hosking, 1987).

    A bound is believed as far as the peaks prove it: two standard errors below the estimate.
    The scale is at least what is given: friction may cover a joint that stands, and sums may stay
    at zero, which is no reason to be alarmed by the next touch of noise.
    """
    share = max(UPPER, min(FEWEST / len(peaks), MAX_SHARE))
    location = max(float(np.quantile(peaks, 1.0 - share)), 1e-6)
    above = np.sort(peaks[peaks > location] - location)
    n = len(above)
    largest = float(peaks.max())
    if n < 3 or above[-1] <= 0.0:
        return Tail(location, least, 0.0, share, max(largest, location), max(n, 3))
    first = float(above.mean())
    second = 2.0 * float((np.arange(n) / (n - 1) * above).mean()) - first
    shape = first / second - 2.0 - DOUBT * SHAPE_ERROR / math.sqrt(n)
    shape = min(max(shape, 0.0), MAX_BOUND)
    return Tail(location, max(first * (1.0 + shape), least), shape, share, largest, n)
