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
    """
    A gapless stretch of a recording.

    Attributes
    ----------
    dt : ndarray of shape (n_samples,)
        Time since the sample before [s].
    q : ndarray of shape (n_samples, n_joints)
        Positions of the active joints [rad or m].
    strain : ndarray of shape (n_samples, n_gauges)
        Readings in their units.
    payload : float
        What is carried [kg].
    begin : float
        Time of the first sample since the beginning of the recording [s].

    """

    dt: FloatArray
    q: FloatArray
    strain: FloatArray
    payload: float
    begin: float = 0.0


@dataclass(frozen=True, eq=False)
class Smoothed:
    """
    A stretch behind the filter, thinned out.

    Attributes
    ----------
    states : ndarray of shape (3, n_samples, n_joints + n_gauges)
        Positions and strains with their first and second derivatives.
    strain : ndarray of shape (n_samples, n_gauges)
        Readings behind the filter, in their units.
    payload : float
        What is carried [kg].
    step : float
        Time between samples [s].
    t : ndarray of shape (n_samples,)
        Since the beginning of the recording [s].

    """

    states: FloatArray
    strain: FloatArray
    payload: float
    step: float
    t: FloatArray


def smoothed(items: Iterable[Watched], cutoff: float, step: float = FINE) -> list[Smoothed]:
    """
    Filter stretches from where the filter has settled on.

    Parameters
    ----------
    items : iterable of Watched
        Gapless stretches; those that end before are left out.
    cutoff : float
        Of the filter [Hz].
    step : float, default=0.02
        Time between samples that are kept, to the next whole sample [s].

    Returns
    -------
    list of Smoothed
        Those with two samples or more.

    """
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
