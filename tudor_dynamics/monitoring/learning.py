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
from tudor_dynamics.monitoring.features import MotionFeatures
from tudor_dynamics.monitoring.onset import LAGS, learn_taps, OnsetFilter, STEP, WINDOW
from tudor_dynamics.monitoring.thresholds import BLOCK, MethodThresholds, Tail

FloatArray = NDArray[np.float64]

GROUP = 0.08
"""Time of which the largest value counts for the profile [s]."""
QUANTILE = 0.8
"""Share of the groups that stay below the profile."""
ROWS = 1500
"""Rows of a quantile regression; more make it slow and hardly better."""
MIN_BLOCKS = 30
"""Seconds of free motion below which nothing can be said of a tail."""
MAX_BOUND = 0.5
"""Tails that end more abruptly are an artefact of few peaks."""
UPPER = 0.2
"""Share of the peaks whose excess makes up the tail."""


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """
    A gapless stretch of residuals while nothing touched the arm.

    Attributes
    ----------
    stamp : ndarray of int64, shape (n_samples,)
        Header stamps [ns].
    motion : ndarray of shape (n_samples, 3 n_joints)
        ``[q, dq, ddq]``.
    residual : ndarray of shape (n_samples, n_channels)
        Residuals of a model that was not fitted to these samples.

    """

    stamp: NDArray[np.int64]
    motion: FloatArray
    residual: FloatArray

    @property
    def t(self) -> FloatArray:
        """Time since the first sample [s]."""
        return np.asarray((self.stamp - self.stamp[0]) * 1e-9)


def learn_thresholds(
    records: Sequence[FreeMotion], channels: tuple[str, ...],
) -> MethodThresholds:
    """
    Learn the thresholds of one method.

    Parameters
    ----------
    records : sequence of FreeMotion
        Residuals of unseen free motion.
    channels : tuple of str
        Gauges or joints.

    Returns
    -------
    MethodThresholds
        Thresholds for any false-alarm rate.

    Raises
    ------
    FitError
        If there is too little free motion.

    """
    if not records:
        msg = 'no free motion to learn thresholds from'
        raise FitError(msg)
    period = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
    step = max(STEP, period)
    records = [r for r in records if r.t[-1] > (LAGS + WINDOW) * step + GROUP]
    seconds = float(sum(r.t[-1] for r in records))
    if seconds < MIN_BLOCKS * BLOCK:
        msg = (f'{seconds:.1f} s of free motion are too little for thresholds; at least '
               f'{MIN_BLOCKS * BLOCK:g} s without a gap are needed')
        raise FitError(msg)
    taps = learn_taps([(r.t, r.residual) for r in records], step)
    n_joints = records[0].motion.shape[1] // 3
    skip = int(math.ceil((LAGS + WINDOW) * step / period))
    columns, sizes = [], []
    for record in records:
        features = MotionFeatures(n_joints)
        rows = np.array([features.step(s, m) for s, m in zip(
            record.stamp.tolist(), record.motion, strict=True)])
        statistic = OnsetFilter(taps, step).process(record.t, record.residual)
        both = np.abs(np.hstack([record.residual, statistic]))
        columns.append(rows[skip:])
        sizes.append(both[skip:])
    group, block = (max(1, round(x / period)) for x in (GROUP, BLOCK))
    grouped = np.vstack([_largest(c, group) for c in columns])
    peaks = np.vstack([_largest(s, group) for s in sizes])
    profile = np.array([_profile(grouped, peaks[:, i]) for i in range(peaks.shape[1])])
    ratios = np.vstack([_largest(s / (c @ profile.T), block)
                        for c, s in zip(columns, sizes, strict=True)])
    return MethodThresholds(channels, step, taps, profile,
                            tuple(_tail(column) for column in ratios.T), seconds)


def _largest(x: FloatArray, count: int) -> FloatArray:
    """Take the largest of each ``count`` rows."""
    whole = len(x) // count * count
    return np.asarray(x[:whole].reshape(-1, count, x.shape[1]).max(axis=1))


def _profile(columns: FloatArray, peaks: FloatArray) -> FloatArray:
    """Fit a quantile of the peaks by non-negative columns, as a linear program."""
    stride = -(-len(peaks) // ROWS)
    columns, peaks = columns[::stride], peaks[::stride]
    n, p = columns.shape
    largest = np.maximum(columns.max(axis=0), 1e-12)
    unit = max(float(np.median(peaks)), 1e-300)
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


def _tail(peaks: FloatArray) -> Tail:
    """Fit a generalised Pareto distribution to the highest peaks by L-moments (Hosking, 1987)."""
    location = float(np.quantile(peaks, 1.0 - UPPER))
    above = np.sort(peaks[peaks > location] - location)
    n = len(above)
    largest = float(peaks.max())
    if n < 3 or above[-1] <= 0.0:
        return Tail(location, 0.0, 0.0, UPPER, largest)
    first = float(above.mean())
    second = 2.0 * float((np.arange(n) / (n - 1) * above).mean()) - first
    shape = min(max(first / second - 2.0, 0.0), MAX_BOUND)
    return Tail(location, first * (1.0 + shape), shape, UPPER, largest)
