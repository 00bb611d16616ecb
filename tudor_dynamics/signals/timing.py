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

"""Do stamps jitter on an even sampling? Positions tell, and even stamps take their place."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.typing import FloatArray

LEAST_JITTER = 0.02
"""Less, relative to the sample time, changes no derivative that matters."""
LARGEST_OFFSET = 0.45
"""A stamp farther from its even place, in sample times, belongs to another one."""
LARGEST_IN_ORDER = 0.9
"""... where none was lost, and the order of the messages says which sample it is."""
CLEAR = 0.8
"""Even stamps are right where they leave less than this part of the roughness."""
FEWEST = 200


@dataclass(frozen=True, eq=False)
class Timing:
    """Stamps of an even sampling, beside those that were recorded."""

    stamp: NDArray[np.int64]  # even stamps, (n,) [ns]
    jitter: float  # standard deviation of the recorded stamps about them [s]
    # Roughness of the positions over the recorded and over the even stamps: rms error by which a
    # sample follows from its four neighbours, relative to the largest of the two.
    now: float
    even: float

    @property
    def clear(self) -> bool:
        """Say whether the positions were sampled evenly beyond doubt."""
        return self.even < CLEAR * self.now


def timing(recording: Recording) -> Timing | None:
    """
    Compare recorded stamps with even ones.

    The positions of an arm are smooth in time. Where each follows better from its neighbours by a
    cubic over even stamps than over the recorded ones, the sampling was even, and the stamps were
    late by varying times.

    Returns None where the stamps are even, or no even ones fit them.
    """
    stamp = recording.stamp.copy()
    squares, count = np.zeros((2, recording.q.shape[1])), 0
    offsets = []
    for part in recording.segments:
        if part.stop - part.start < FEWEST:
            continue
        t = (recording.stamp[part] - recording.stamp[part.start]) * 1e-9
        even = _even(t)
        if even is None:
            return None
        stamp[part] = recording.stamp[part.start] + np.round(even * 1e9).astype(np.int64)
        offsets.append(t - even)
        for i, times in enumerate((t, even)):
            squares[i] += np.sum(_unexpected(times, recording.q[part]) ** 2, axis=0)
        count += len(t) - 4
    if not count:
        return None
    jitter = float(np.std(np.concatenate(offsets)))
    if jitter < LEAST_JITTER * recording.dt or np.any(np.diff(stamp) <= 0):
        return None
    rough = np.sqrt(squares / count)
    # the joint that tells most: one that stands still says nothing
    joint = int(np.argmax(np.abs(rough[0] - rough[1])))
    largest = max(float(rough[:, joint].max()), 1e-300)
    return Timing(stamp, jitter, float(rough[0, joint]) / largest,
                  float(rough[1, joint]) / largest)


def retimed(recording: Recording) -> tuple[Recording, Timing | None]:
    """
    Give a recording even stamps where its positions were sampled evenly beyond doubt.

    Returns found, None where nothing was done.
    """
    found = timing(recording)
    if found is None or not found.clear:
        return recording, None
    note = (f'stamps jitter by {found.jitter * 1e3:.2g} ms on an even sampling of '
            f'{1.0 / recording.dt:.4g} Hz; even stamps took their place')
    return replace(recording, stamp=found.stamp, warnings=(*recording.warnings, note)), found


def _even(t: FloatArray) -> FloatArray | None:
    """Give the even times nearest to stamps; lost samples leave their places free."""
    whole = _fitted(t, np.arange(len(t), dtype=float), LARGEST_IN_ORDER)
    step = float(np.median(np.diff(t)))
    # step by step: over a whole record, the error of the median would come to many samples
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(np.diff(t) / step), 1.0))])
    slope, first = np.polyfit(index, t, 1)
    index = np.round((t - first) / slope)
    holed = None if np.any(np.diff(index) < 1.0) else _fitted(t, index, LARGEST_OFFSET)
    found = [even for even in (whole, holed) if even is not None]
    return min(found, key=lambda even: float(np.std(t - even)), default=None)


def _fitted(t: FloatArray, index: FloatArray, largest: float) -> FloatArray | None:
    """Give even times for places in a row; None where a stamp is too far from its own."""
    slope, first = np.polyfit(index, t, 1)
    even = np.asarray(first + slope * index)
    return None if np.max(np.abs(t - even)) > largest * slope else even


def _unexpected(t: FloatArray, x: FloatArray) -> FloatArray:
    """Give by how much each sample differs from the cubic through its four neighbours."""
    places = [t[:-4], t[1:-3], t[3:-1], t[4:]]
    values = [x[:-4], x[1:-3], x[3:-1], x[4:]]
    at = t[2:-2]
    expected = np.zeros_like(x[2:-2])
    for i, value in enumerate(values):
        weight = np.ones_like(at)
        for j, other in enumerate(places):
            if j != i:
                weight *= (at - other) / (places[i] - other)
        expected += weight[:, None] * value
    return np.asarray(x[2:-2] - expected)
