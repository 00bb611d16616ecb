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

"""Thresholds for a false-alarm rate, and the statistics that they apply to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Annotated, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from tudor_dynamics.compiled import compiled
from tudor_dynamics.online.settings import (
    ACCELERATION_MEMORY, ALARM_SHARES, BLOCK, DRIFT, HOLDING_TIME, LAGS, LONGEST_STEP,
    REVERSAL_SPEED, REVERSAL_WINDOW, STANDING, SUM_BOUND, WINDOW)
from tudor_dynamics.typing import FloatArray


Positive = Annotated[float, Field(gt=0.0)]
NEVER = -2**62  # a stamp before all others [ns]


@compiled
def motion_features(stamp: NDArray[np.int64], motion: FloatArray) -> FloatArray:
    """Give columns of a gapless record: 1, speeds, accelerations now, lately, recent reversals."""
    n, last = motion.shape[1] // 3, NEVER
    out = np.empty((len(motion), 1 + 4 * n))
    direction, lately, reversed_at = np.zeros(n), np.zeros(n), np.full(n, NEVER)
    for k in range(len(stamp)):
        evaluate_features(stamp[k], last, motion[k], direction, lately, reversed_at, out[k])
        last = stamp[k]
    return out


@compiled
def evaluate_features(
    stamp: int, last: int, row: FloatArray, direction: FloatArray, lately: FloatArray,
    reversed_at: NDArray[np.int64], columns: FloatArray,
) -> None:
    """Evaluate the columns at a sample; direction, lately, reversed_at: remembered, (joints,)."""
    n = len(direction)
    decay = math.exp((last - stamp) * 1e-9 / ACCELERATION_MEMORY)
    columns[0] = 1.0
    for i in range(n):
        dq, ddq = row[n + i], abs(row[2 * n + i])
        if abs(dq) > REVERSAL_SPEED:
            if dq * direction[i] < 0.0:
                reversed_at[i] = stamp
            direction[i] = 1.0 if dq > 0.0 else -1.0
        lately[i] = max(ddq, decay * lately[i])
        columns[1 + i] = abs(dq)
        columns[1 + n + i] = ddq
        columns[1 + 2 * n + i] = lately[i]
        columns[1 + 3 * n + i] = 1.0 if stamp - reversed_at[i] <= REVERSAL_WINDOW * 1e9 else 0.0


# The onset statistic: what the residual of the last 100 ms does that its past does not explain.
#
# The residual of a rigid-body model rings with the links, and a threshold above that ringing finds
# a touch late. Ringing can be foretold from its own past: a vector autoregression, learned from
# free motion, predicts the residual one step ahead, and the statistic is the sum of its errors
# over a window. A contact pushes all of them the same way, long before it rises above the ringing.
# It answers to onsets only; what lasts is the business of the residual itself.
#
# The steps are 10 ms long whatever the sample rate is: the past is interpolated.


def learn_taps(records: Sequence[tuple[FloatArray, FloatArray]], step: float) -> FloatArray:
    """Fold autoregression and window into one filter (LAGS + WINDOW, channels, channels)."""
    n = records[0][1].shape[1]
    gram, moment = np.zeros((LAGS * n, LAGS * n)), np.zeros((LAGS * n, n))
    for t, residual in records:
        lagged = _lagged(t, residual, step, LAGS + 1)[_complete(t, step, LAGS + 1)]
        past = lagged[:, 1:].reshape(len(lagged), -1)
        gram += past.T @ past
        moment += past.T @ lagged[:, 0]
    scale = np.sqrt(np.diag(gram)) + 1e-150  # a channel may be zero; its square must not be
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


def onset_statistic(
    t: FloatArray, residual: FloatArray, taps: FloatArray, step: float,
) -> FloatArray:
    """Evaluate the statistic (samples, channels) of a gapless record; 0 until its past is full."""
    lagged = _lagged(t, residual, step, len(taps))
    out = np.einsum('tkc,kcd->td', lagged, taps)
    out[~_complete(t, step, len(taps))] = 0.0
    return np.asarray(out)


@compiled
def onset_now(
    past: FloatArray, begin: int, count: int, step: float, weights: FloatArray, out: FloatArray,
) -> int:
    """
    Evaluate the statistic at the newest sample; gives where the past begins that is still needed.

    past (places, 1 + channels): times [ns] and residuals, of which ``count`` rows are in use;
    weights (taps channels, channels): taps, the oldest first; writes out (channels,).
    """
    n, now, j = len(out), past[count - 1, 0], begin
    taps = len(weights) // n
    out[:] = 0.0
    for k in range(taps):
        age = 1e9 * step * (taps - 1 - k)  # differences of whole ns are exact, sums are not
        while j + 2 < count and now - past[j + 1, 0] >= age:
            j += 1
        if k == 0:
            begin = j
        share = max(0.0, (now - past[j, 0] - age) / (past[j + 1, 0] - past[j, 0]))
        for channel in range(1, n + 1):
            value = past[j, channel] + share * (past[j + 1, channel] - past[j, channel])
            for i in range(n):
                out[i] += value * weights[k * n + channel - 1, i]
    return begin


# The accumulated statistic: what onsets come to that are each too small to be detected.
#
# A soft hit rises for longer than the 100 ms over which an onset is summed, and never stands out
# in any of them. A cumulative sum (Page, 1954) of the onset by its profile, less a drift, adds
# them up: free motion, whose onsets change sign, falls back to zero soon. There is one sum for
# each direction; its unit is the second, that is the time for which the onset stood one profile
# above the drift.
#
# What lasts is no onset: friction that holds a joint is a residual that stays, of which the
# autoregression leaves a part. So the change of the residual is summed: the onset, less what it
# would be had the residual been as it was before the onset's past.


@compiled
def advance(dt: float, z: FloatArray, threshold: FloatArray, sums: FloatArray) -> None:
    """Add one sample to the sums (2, channels) [s]."""
    step = min(dt, LONGEST_STEP)
    for i in range(len(z)):
        if z[i] != z[i]:  # NaN adds nothing
            continue
        for row in range(2):
            before = sums[row, i]
            drift = DRIFT if before >= 0.0 else -DRIFT
            grown = before + ((1.0 - 2.0 * row) * z[i] - drift) * step
            least = min(before, 0.0)
            sums[row, i] = min(max(grown, least), SUM_BOUND * threshold[i])
        for row in range(2):
            if sums[row, i] > threshold[i]:
                sums[1 - row, i] = -threshold[i]


@compiled
def accumulate(dt: FloatArray, z: FloatArray) -> FloatArray:
    """Sum a gapless record up: (samples, channels) [s]."""
    n, out = z.shape[1], np.empty_like(z)
    sums, never = np.zeros((2, n)), np.full(n, np.inf)
    for k in range(len(dt)):
        advance(dt[k], z[k], never, sums)
        for i in range(n):
            out[k, i] = max(sums[0, i], sums[1, i])
    return out


# Friction that holds a joint: how much it may be, and how much of it there is.
#
# A joint that stands keeps whatever friction it came to rest with. As far as friction can hold, a
# residual that stays is none of contact; what is left of it shows changes.

AnyFloat = TypeVar('AnyFloat', float, FloatArray)


@compiled
def held_friction(stiction: AnyFloat, speed: AnyFloat) -> AnyFloat:
    """Give the friction, in the effort's unit, that may hold a joint at a speed."""
    return stiction * np.maximum(0.0, 1.0 - speed / STANDING)


@compiled
def advance_held(
    dt: float, value: FloatArray, held: FloatArray, friction: FloatArray, out: FloatArray,
) -> None:
    """Follow the friction that holds each joint, dt 0 to restart; give the rest of a residual."""
    share = 1.0 if dt <= 0.0 else dt / (HOLDING_TIME + dt)
    for i in range(len(value)):
        if value[i] == value[i]:  # NaN says nothing
            friction[i] += share * (value[i] - friction[i])
        friction[i] = min(max(friction[i], -held[i]), held[i])
        out[i] = value[i] - friction[i]


@compiled
def released(t: FloatArray, value: FloatArray, held: FloatArray) -> FloatArray:
    """Take the friction that holds off a gapless record (samples, channels)."""
    out, friction = np.empty_like(value), np.zeros(value.shape[1])
    for k in range(len(value)):
        dt = t[k] - t[k - 1] if k else 0.0
        advance_held(dt, value[k], held[k], friction, out[k])
    return out


# Thresholds for a false-alarm rate.
#
# Each statistic of each channel has a profile, its typical size as a function of speed,
# acceleration and recent reversals, and a tail: the distribution of the largest ratio to that
# profile in a second of free motion. The threshold is the profile times the ratio which the tail
# exceeds as often as the user allows, a number in false alarms per hour, and never a multiple of
# sigma.


@dataclass(frozen=True)
class Tail:
    """How the largest ratio in a second is distributed where it is large."""

    # A generalised Pareto distribution, exponential or with a bound: residuals of free motion are
    # bounded by physics. Seconds at rest and in motion are mixed, and only the upper part of that
    # mixture follows one law.

    location: Positive  # ratio that a share of the seconds exceeds
    scale: Positive  # scale of their excess
    # 0 for an exponential tail; otherwise the excess is below scale / shape
    shape: Annotated[float, Field(ge=0.0, le=1.0)]
    share: Annotated[float, Field(gt=0.0, le=1.0)]  # share of the samples above that value
    largest: Positive  # largest ratio that was seen
    count: Annotated[float, Field(ge=1.0)]  # peaks that the distribution was fitted to

    def ratio(self, per_hour: float) -> float:
        """Give the ratio that is exceeded so often."""
        # The scale is known as well as its peaks are many. What is left of the doubt is counted
        # in: the ratio is that of the predictive distribution, which for an exponential tail is (1
        # + x / (n scale))^-n, and larger than that of the tail itself.
        certain = math.log(min(per_hour * BLOCK / 3600.0, self.share) / self.share)
        relative = -self.count * math.expm1(-certain / self.count)
        if self.shape == 0.0:
            return self.location - self.scale * relative
        return self.location - self.scale * math.expm1(self.shape * relative) / self.shape


@dataclass(frozen=True, eq=False)
class MethodThresholds:
    """All that is learned for one method: strain, effort or momentum observer."""

    channels: tuple[str, ...]  # gauges or joints
    step: float  # step of the onset statistic [s]
    taps: FloatArray  # weights of the onset statistic, (taps, channels, channels)
    # (2 channels, 1 + 4 joints): typical size of the residuals, then of the onset statistics, in
    # the unit of the output per column of `motion_features`.
    profile: FloatArray
    # One for each row of `profile`, then of the accumulated onset of each channel.
    tails: tuple[Tail, ...]
    seconds: float  # duration of free motion that this was learned from [s]
    usual: FloatArray  # usual level of the onset statistics there, see `follow`, (channels,)
    reach: FloatArray  # largest speeds there, (joints,) [rad/s or m/s]
    # (channels,): friction that may hold each joint while it stands, in the unit of its effort:
    # added to the threshold of the residual there. Zeros for gauges.
    stiction: FloatArray

    @property
    def n_joints(self) -> int:
        """Give the number of active joints of the arm."""
        return (self.profile.shape[1] - 1) // 4

    def doubt(self, per_hour: float) -> float:
        """Say how much wider thresholds are than those of as much motion as one could wish for."""
        sure = replace(self, tails=tuple(replace(tail, count=1e9) for tail in self.tails))
        n = len(self.channels)
        return float(np.max(self.ratios(per_hour)[:n] / sure.ratios(per_hour)[:n]))

    def ratios(self, per_hour: float) -> FloatArray:
        """Share a false-alarm rate among all statistics: (3 channels,) [s]."""
        weights = np.repeat(ALARM_SHARES, len(self.channels))
        shares = per_hour * weights / weights.sum()
        # Alarms rarer than once in what was seen: what was seen must not be one.
        return np.array([
            max(tail.ratio(each), tail.largest if each * self.seconds < 3600.0 else 0.0)
            for tail, each in zip(self.tails, shares, strict=True)])
