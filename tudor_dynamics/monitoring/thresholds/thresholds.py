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
Thresholds for a false-alarm rate.

Each statistic of each channel has a profile, its typical size as a function of speed, acceleration
and recent reversals, and a tail: the distribution of the largest ratio to that profile in a second
of free motion. The threshold is the profile times the ratio which the tail exceeds as often as
the user allows, a number in false alarms per hour, and never a multiple of sigma.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from tudor_dynamics.typing import FloatArray

WEIGHTS = (50.0, 50.0, 1.0)
"""Shares of a false-alarm rate: residual, onset, and accumulated onset, which tells the soft hits
that the others tell late."""
BLOCK = 1.0
"""Time of which the largest ratio counts: longer than the ringing's memory of one event [s]."""


@dataclass(frozen=True)
class Tail:
    """
    How the largest ratio in a second is distributed where it is large.

    A generalised Pareto distribution, exponential or with a bound: residuals of free motion are
    bounded by physics. Seconds at rest and in motion are mixed, and only the upper part of that
    mixture follows one law.
    """

    location: float  # ratio that a share of the seconds exceeds
    scale: float  # scale of their excess
    shape: float  # 0 for an exponential tail; otherwise the excess is below scale / shape
    share: float  # share of the samples above that value
    largest: float  # largest ratio that was seen
    count: float  # peaks that the distribution was fitted to

    def ratio(self, per_hour: float) -> float:
        """
        Give the ratio that is exceeded so often.

        The scale is known as well as its peaks are many. What is left of the doubt is counted
        in: the ratio is that of the predictive distribution, which for an exponential tail is
        (1 + x / (n scale))^-n, and larger than that of the tail itself.
        """
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
    # the unit of the output per column of `MotionFeatures`.
    profile: FloatArray
    # One for each row of `profile`, then of the accumulated onset of each channel, if there are so
    # many; bundles that are older have none.
    tails: tuple[Tail, ...]
    seconds: float  # duration of free motion that this was learned from [s]
    # (channels,): usual level of the onset statistics there, see `Familiarity`; infinite where
    # unknown.
    usual: FloatArray
    reach: FloatArray  # (joints,): largest speeds there [rad/s or m/s]; infinite where unknown
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
        """
        Share a false-alarm rate out among all statistics.

        Returns (3 channels,) [s], infinite where they have no tail.
        """
        n = len(self.channels)
        weights = np.repeat(WEIGHTS, n)[:len(self.tails)]
        found = np.full(3 * n, np.inf)
        for place, (tail, each) in enumerate(zip(
                self.tails, per_hour * weights / weights.sum(), strict=True)):
            # Alarms rarer than once in what was seen: what was seen must not be one.
            rare = each * self.seconds < 3600.0
            found[place] = max(tail.ratio(each), tail.largest if rare else 0.0)
        return found
