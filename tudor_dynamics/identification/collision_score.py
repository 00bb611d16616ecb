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
Truth and figures of collisions: the pushes of a bag, and how an alarm is judged by them.

A push counts as found if an event falls between its start and shortly after its end. Its latency
runs from the start of the force to the sample at which the detector is sure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags import read_wrenches
from tudor_dynamics.monitoring.detector import CollisionEvent
from tudor_dynamics.typing import FloatArray

FORCE = 0.01
"""Less is no push [N]."""
LATE = 0.3
"""Behind the end of a push an event still counts as found [s]."""
AFTERMATH = 2.0
"""Behind the end of a push an event is no false alarm: the arm still rings [s]."""
MERGE = 0.1
"""Pauses of the force that do not end a push [s]."""


@dataclass(frozen=True)
class Push:
    """
    A push that was applied on purpose.

    Attributes
    ----------
    begin, end : int
        Stamps of its first and last sample [ns].
    force : float
        Largest force [N].

    """

    begin: int
    end: int
    force: float


@dataclass(frozen=True)
class CollisionScore:
    """
    Figures of one method.

    Attributes
    ----------
    pushes, found : int
        Pushes in the bags, and those found.
    detection_rate : float or None
        Their ratio; None without pushes.
    latency_median, latency_p95 : float or None
        From the start of the push to certainty, over those found [s].
    false_alarms : int
        Events without a push.
    hours : float
        Time without a push [h].
    false_alarms_per_hour : float
        False alarms over hours watched [1/h].

    """

    pushes: int
    found: int
    detection_rate: float | None
    latency_median: float | None
    latency_p95: float | None
    false_alarms: int
    hours: float
    false_alarms_per_hour: float

    def as_dict(self) -> dict[str, Any]:
        """Give the figures as JSON-ready dictionary."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Watched:
    """
    One bag as one method saw it.

    Attributes
    ----------
    bag : str
        Path of the bag.
    stamp : ndarray of int64, shape (n_samples,)
        Samples with a residual [ns].
    ratio : ndarray of shape (n_samples,)
        Largest ratio to the collision threshold that held for the debounce time.
    pushes : tuple of Push
        Pushes that there were.
    events : tuple of CollisionEvent
        What was found.

    """

    bag: str
    stamp: NDArray[np.int64]
    ratio: FloatArray
    pushes: tuple[Push, ...]
    events: tuple[CollisionEvent, ...]


def find_pushes(path: str) -> tuple[Push, ...]:
    """
    Read the pushes of a bag from its ``/applied_wrench``.

    Parameters
    ----------
    path : str
        Bag that may have pushes.

    Returns
    -------
    tuple of Push
        In order; none where the bag has no such topic.

    """
    wrenches = read_wrenches(path)
    if wrenches is None:
        return ()
    size = np.linalg.norm(wrenches.force, axis=1)
    where = np.flatnonzero(size > FORCE)
    if not len(where):
        return ()
    stamp = wrenches.stamp[where]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(stamp) > MERGE * 1e9) + 1])
    ends = np.concatenate([starts[1:], [len(where)]])
    return tuple(Push(int(stamp[a]), int(stamp[b - 1]), float(size[where[a:b]].max()))
                 for a, b in zip(starts.tolist(), ends.tolist(), strict=True))


def score(watched: Sequence[Watched], alarms: Sequence[NDArray[np.int64]]) -> CollisionScore:
    """
    Judge alarms by the pushes.

    Parameters
    ----------
    watched : sequence of Watched
        Bags that were replayed.
    alarms : sequence of ndarray of int64
        For each bag the stamps at which something was found [ns].

    Returns
    -------
    CollisionScore
        Figures.

    """
    latencies, pushes, false, free = [], 0, 0, 0.0
    for item, times in zip(watched, alarms, strict=True):
        near = np.zeros(len(times), dtype=bool)
        span = float(item.stamp[-1] - item.stamp[0]) * 1e-9 if len(item.stamp) else 0.0
        for push in item.pushes:
            pushes += 1
            span -= (push.end - push.begin) * 1e-9 + AFTERMATH
            hits = times[(times >= push.begin) & (times <= push.end + round(LATE * 1e9))]
            if len(hits):
                latencies.append(float(hits[0] - push.begin) * 1e-9)
            near |= (times >= push.begin) & (times <= push.end + round(AFTERMATH * 1e9))
        false += int(np.sum(~near))
        free += max(span, 0.0)
    hours = free / 3600.0
    return CollisionScore(
        pushes, len(latencies), len(latencies) / pushes if pushes else None,
        float(np.median(latencies)) if latencies else None,
        float(np.percentile(latencies, 95)) if latencies else None,
        false, hours, false / hours if hours > 0 else 0.0)


def alarms_at(item: Watched, factor: float, rearm: float) -> NDArray[np.int64]:
    """
    Give the times at which a threshold that much higher would have given an event.

    Parameters
    ----------
    item : Watched
        Bag with the ratios to its thresholds.
    factor : float
        Factor on the threshold.
    rearm : float
        Time without an excess before the next event [s].

    """
    times = item.stamp[item.ratio > factor]
    if not len(times):
        return times
    return times[np.concatenate([[True], np.diff(times) > round(rearm * 1e9)])]
