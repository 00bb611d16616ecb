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
How far the arm is from what thresholds were learned on, and how much wider they have to be.

Two distances are known. Speeds beyond those of the recordings show at once. Whatever else differs,
damper, sample rate, drives or friction, shows in the onset statistic, which is small between
collisions and blind to forces that last: a quantile of its ratio to the profile is followed, so
slowly that a push hardly moves it, and compared with what was usual in free motion.
"""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

QUANTILE = 0.8
"""Share of the samples that stay below the level that is followed."""
SPEED = 0.5
"""How fast the level follows, in its logarithm [1/s]."""
WIDEST = 4.0
"""Thresholds are not widened more than so many times: the detector would be blind."""
USUAL = 0.9
"""Share of the time in free motion for which the level was lower than what counts as usual."""
UNLIKE = 1.5
"""Widening that the user should know of."""
OUTLIER = 6.0
"""Ratios that are so many times the level are collisions, and do not move it."""
LOWEST = 0.5
"""The level does not fall further below that of free motion: an arm at rest would forget it."""


class Familiarity:
    """
    Follows how large onsets are at present, beside how large they were in free motion.

    widening (channels,); usual (channels,): infinite where it is not known; reach (joints,)
    [rad/s or m/s]: infinite where they are not known.
    """

    def __init__(self, usual: FloatArray, reach: FloatArray) -> None:
        self.usual, self.reach = usual, reach
        self.level = np.where(np.isfinite(usual), usual, 0.0)
        self.widening = np.ones(len(usual))

    def step(self, dt: float, speeds: FloatArray, ratio: FloatArray) -> None:
        """
        Take one sample into account; its widening holds for the next.

        dt [s], speeds (joints,) [rad/s or m/s], ratio (channels,).
        """
        follow(dt, speeds, ratio, self.usual, self.reach, self.level, self.widening)


@compiled
def _track(dt: float, ratio: FloatArray, level: FloatArray) -> None:
    """Follow a quantile of each ratio, in steps of its logarithm."""
    up, down = math.exp(SPEED * QUANTILE * dt), math.exp(-SPEED * (1.0 - QUANTILE) * dt)
    for i in range(len(ratio)):
        if ratio[i] <= level[i]:
            level[i] *= down
        elif ratio[i] <= OUTLIER * level[i]:
            level[i] *= up


@compiled
def follow(
    dt: float, speeds: FloatArray, ratio: FloatArray, usual: FloatArray, reach: FloatArray,
    level: FloatArray, widening: FloatArray,
) -> None:
    """Compare levels and speeds with what was learned."""
    faster = 1.0
    for j in range(len(speeds)):
        faster = max(faster, speeds[j] / reach[j])
    _track(dt, ratio, level)
    for i in range(len(ratio)):
        if math.isfinite(usual[i]):
            level[i] = min(max(level[i], LOWEST * usual[i]), WIDEST * usual[i])
            widening[i] = min(max(level[i] / usual[i], faster), WIDEST)
        else:
            widening[i] = min(faster, WIDEST)


def levels(dt: FloatArray, ratio: FloatArray) -> FloatArray:
    """
    Follow the level along a record.

    dt (samples,) [s], ratio (samples, channels); returns (samples, channels).
    """
    out = np.empty_like(ratio)
    _record(dt, ratio, np.quantile(ratio, QUANTILE, axis=0), out)
    return out


@compiled
def _record(dt: FloatArray, ratio: FloatArray, level: FloatArray, out: FloatArray) -> None:
    """Follow a record, and keep the levels."""
    for k in range(len(dt)):
        _track(dt[k], ratio[k], level)
        out[k] = level
