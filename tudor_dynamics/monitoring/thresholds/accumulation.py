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
The accumulated statistic: what onsets come to that are each too small to be told.

A soft hit rises for longer than the 100 ms over which an onset is summed, and never stands out in
any of them. A cumulative sum (Page, 1954) of the onset by its profile, less a drift, adds them up:
free motion, whose onsets change sign, falls back to zero soon. There is one sum for each
direction; its unit is the second, that is the time for which the onset stood one profile above
the drift.

What lasts is no onset: friction that holds a joint is a residual that stays, of which the
autoregression leaves a part. So the change of the residual is summed: the onset, less what it
would be had the residual been as it was before the onset's past (see `OnsetFilter`).
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

DRIFT = 1.0
"""Ratio to the onset's profile that adds nothing: four fifths of free motion stay below."""
LONGEST = 0.1
"""A sample counts for no longer than this, however late the next one comes [s]."""
UNSURE = 0.5
"""Share of the friction that may hold a joint by which that friction may be larger for a while."""
BEYOND = 1.1
"""Times its threshold that a sum reaches at most: it must fall back when the force has gone."""


@compiled
def advance(
    dt: float, z: FloatArray, threshold: FloatArray, sums: FloatArray,
) -> None:
    """
    Add one sample to the sums.

    dt [s], z (channels,), threshold (channels,) [s]; writes sums (2, channels) [s].
    """
    step = min(dt, LONGEST)
    for i in range(len(z)):
        if z[i] != z[i]:  # NaN adds nothing
            continue
        for row in range(2):
            before = sums[row, i]
            drift = DRIFT if before >= 0.0 else -DRIFT
            grown = before + ((1.0 - 2.0 * row) * z[i] - drift) * step
            least = min(before, 0.0)
            sums[row, i] = min(max(grown, least), BEYOND * threshold[i])
        for row in range(2):
            if sums[row, i] > threshold[i]:
                sums[1 - row, i] = -threshold[i]


@compiled
def _record(dt: FloatArray, z: FloatArray, out: FloatArray) -> None:
    n = z.shape[1]
    sums, never = np.zeros((2, n)), np.full(n, np.inf)
    for k in range(len(dt)):
        advance(dt[k], z[k], never, sums)
        for i in range(n):
            out[k, i] = max(sums[0, i], sums[1, i])


def accumulate(dt: FloatArray, z: FloatArray) -> FloatArray:
    """
    Sum a gapless record up.

    dt (samples,) [s], z (samples, channels); returns (samples, channels) [s].
    """
    out = np.empty_like(z)
    _record(dt, z, out)
    return out
