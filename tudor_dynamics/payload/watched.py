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

"""Recordings of arms that bend: positions and strains behind the same filter."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.signals.smooth_states import SmoothStates
from tudor_dynamics.typing import FloatArray

CUTOFF = 5.0
"""Of the filter: first modes pass, second ones, in which links bend otherwise, do not [Hz]."""
FINE = 0.02
"""Time between samples that are kept [s]: aliases of noise would add to it."""


@dataclass(frozen=True, eq=False)
class Watched:
    """A gapless stretch of a recording."""

    dt: FloatArray  # time since the sample before, (samples,) [s]
    q: FloatArray  # positions of the active joints, (samples, joints) [rad or m]
    strain: FloatArray  # readings in their units, (samples, gauges)
    payload: float  # what is carried [kg]
    begin: float = 0.0  # time of the first sample since the beginning of the recording [s]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A stretch behind the filter, thinned out."""

    # (3, samples, joints + gauges): positions and strains with their first and second derivatives.
    states: FloatArray
    strain: FloatArray  # readings behind the filter, in their units, (samples, gauges)
    payload: float  # what is carried [kg]
    step: float  # time between samples [s]
    t: FloatArray  # since the beginning of the recording, (samples,) [s]


def smoothed(items: Iterable[Watched], cutoff: float, step: float = FINE) -> list[Smoothed]:
    """Filter stretches from where the filter has settled on: cutoff [Hz], step [s]."""
    found = []
    for item in items:
        dt = float(np.median(item.dt))
        every = max(1, round(step / dt))
        smooth = SmoothStates(cutoff)
        elapsed = np.cumsum(item.dt) - item.dt[0]
        begin = int(np.searchsorted(elapsed, smooth.settle))
        states = smooth.process(item.dt, np.hstack([item.q, item.strain]))[:, begin::every]
        if states.shape[1] > 1:
            found.append(Smoothed(states, states[0, :, item.q.shape[1]:], item.payload,
                                  every * dt, item.begin + elapsed[begin::every]))
    return found
