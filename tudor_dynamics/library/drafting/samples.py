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

"""Samples of a recording that are enough to judge by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.typing import FloatArray, IndexArray

MAX_SAMPLES = 400
"""Of each bag, evenly spread: gravity needs poses, not samples."""
WINDOW = 0.15
"""Over which positions are smoothed to differentiate them [s]."""
SLOW = 0.05
"""Speed over which the sign of the friction is smoothed [rad/s or m/s]."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Evenly spread samples of a recording."""

    rows: IndexArray  # which rows of the recording they are, (n,)
    # Motion of all joints of a model, of those that were not recorded zero, (n, model)
    # [rad or m, and per s and s^2].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray


def spread(recording: Recording, size: int, index: Sequence[int]) -> Samples:
    """Take samples, with speeds and accelerations of joints that are smooth over `WINDOW`."""
    keep = max(1, len(recording.q) // MAX_SAMPLES)
    parts = []
    for segment in recording.segments:
        width = 2 * max(2, round(WINDOW / recording.dt / 2)) + 1
        if segment.stop - segment.start <= width:
            continue
        moved = [savgol_filter(recording.q[segment], width, 3, deriv=order, delta=recording.dt,
                               axis=0)[::keep] for order in range(3)]
        whole = np.zeros((3, len(moved[0]), size))
        whole[:, :, list(index)] = moved
        parts.append((np.arange(segment.start, segment.stop)[::keep], *whole))
    if not parts:
        none = np.empty((0, size))
        return Samples(np.empty(0, dtype=np.intp), none, none, none)
    return Samples(*(np.concatenate(part) for part in zip(*parts, strict=True)))
