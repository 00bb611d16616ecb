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

"""Stamps: order, gaps, segments, and the alignment of streams of different rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.typing import FloatArray

GAP_PERIODS = 5.0
GAP_FLOOR = 0.02
"""
A gap is longer than five sample times and than 20 ms [s].

Five sample times pass the odd lost message. The floor is for fast recordings: at 1 kHz a stall of
a few milliseconds is scheduling, and motion and oscillation of arms (below 20 Hz) are still
sampled faster than twice their frequency across 20 ms.
"""

LEAST_BEHIND = 3
"""Messages in a row behind the newest stamp that make a clock that was set back."""


@dataclass(frozen=True, eq=False)
class Order:
    """Which messages increase in time."""

    keep: NDArray[np.bool_]  # messages later than all before them, (n,)
    # Messages with the stamp of the newest one before them, and with an older one.
    duplicate: int
    backward: int


def increasing(stamp: NDArray[np.int64]) -> Order:
    """Find the messages whose stamps increase: stamp (n,) [ns]."""
    newest = np.maximum.accumulate(stamp)[:-1] if len(stamp) else stamp
    later = stamp[1:] > newest
    duplicate = int(np.sum(stamp[1:] == newest))
    keep = np.concatenate([np.ones(min(1, len(stamp)), dtype=bool), later])
    return Order(keep, duplicate, int(np.sum(~keep)) - duplicate)


def set_backs(stamp: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """
    Find where a clock was set back: messages in a row that begin again before the newest stamp.

    stamp (n,) [ns]; returns newest stamp before, by how much the clock was set back [ns].
    """
    if len(stamp) < 3:
        return []
    newest = np.maximum.accumulate(stamp)
    behind = np.concatenate([[False], stamp[1:] < newest[:-1]])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], behind, [False]]).astype(int)))
    step = int(np.median(np.abs(np.diff(stamp))))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        # one or two late messages were overtaken on their way
        if last - first >= LEAST_BEHIND and np.mean(np.diff(stamp[first:last]) > 0) > 0.9:
            before = int(newest[first - 1])
            found.append((before, before + step - int(stamp[first]), int(last - first)))
    return found


def gap_limit(stamp: NDArray[np.int64]) -> float:
    """
    Give the longest time between samples that is not a gap.

    stamp (n,) [ns]; returns limit [s].
    """
    if len(stamp) < 2:
        return GAP_FLOOR
    return max(GAP_PERIODS * float(np.median(np.diff(stamp))) * 1e-9, GAP_FLOOR)


def split_at_gaps(stamp: NDArray[np.int64]) -> tuple[slice, ...]:
    """Split a record at its gaps: stamp (n,) [ns]."""
    cuts = np.flatnonzero(np.diff(stamp) * 1e-9 > gap_limit(stamp)) + 1
    ends = [0, *cuts.tolist(), len(stamp)]
    return tuple(slice(a, b) for a, b in zip(ends, ends[1:]) if b > a)


def interpolate(
    at: NDArray[np.int64], stamp: NDArray[np.int64], values: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """
    Bring a stream onto other stamps.

    Samples with the same stamp are taken as they are, others interpolated linearly between their
    neighbours, unless there is a gap between these.

    at (m,) [ns], stamp (n,) [ns]; values (n, k): NaN marks a sample without value; returns (m, k)
    and (m,).
    """
    result = np.full((len(at), values.shape[1]), np.nan)
    if not len(stamp):
        return result, np.zeros(len(at), dtype=bool)
    right = np.minimum(np.searchsorted(stamp, at), len(stamp) - 1)
    left = np.maximum(right - 1, 0)
    exact = stamp[right] == at
    width = (stamp[right] - stamp[left]) * 1e-9
    inside = (stamp[left] < at) & (at < stamp[right]) & (width <= gap_limit(stamp))
    result[exact] = values[right[exact]]
    a, b = left[inside], right[inside]
    weight = ((at[inside] - stamp[a]) / (stamp[b] - stamp[a]))[:, None]
    result[inside] = (1 - weight) * values[a] + weight * values[b]
    return result, exact | inside
