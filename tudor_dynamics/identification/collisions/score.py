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
Figures of collisions: how alarms are judged by the pushes that are known.

A push counts as found if an event falls between its start and shortly after its end. Its latency
runs from the start of the force to the sample at which the detector is sure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.identification.collisions.truth import KnownPush, Truth
from tudor_dynamics.monitoring.detector import CollisionEvent
from tudor_dynamics.typing import FloatArray

LATE = 0.3
"""Behind the end of a push an event still counts as found [s]."""
EARLY = 0.1
"""Before the begin of a push an event already belongs to it: pushes by hand are marked by eye, and
clocks of sensors differ [s]."""
AFTERMATH = 2.0
"""Behind the end of a push an event is no false alarm: the arm still rings [s]."""
_EARLY = round(EARLY * 1e9)


@dataclass(frozen=True)
class CollisionScore:
    """Figures of one method."""

    events: int  # events in all bags
    # Pushes in the bags, and those found.
    pushes: int
    found: int
    detection_rate: float | None  # their ratio; None without pushes
    # From the start of the push to certainty, over those found, 0 where that was `EARLY` [s].
    latency_median: float | None
    latency_p95: float | None
    # Events without a push, in bags whose pushes are known; None without such bags.
    false_alarms: int | None
    hours: float  # time without a push in those bags [h]
    false_alarms_per_hour: float | None  # false alarms over those hours [1/h]

    def as_dict(self) -> dict[str, Any]:
        """Give the figures as JSON-ready dictionary."""
        return asdict(self)


@dataclass(frozen=True)
class Sighting:
    """One event of a bag, as a person wants to know of it."""

    event: CollisionEvent  # what was found
    time: float  # from the first sample of the bag to certainty [s]
    channel: str  # joint or gauge that stood furthest above its threshold
    ratio: float  # largest ratio to the collision threshold while it lasted
    seconds: float  # from the first sample above the threshold to the last
    # Place of the push that it belongs to; None where there is none, or none is known.
    push: int | None = None
    # What touched the arm meanwhile, see `ContactRecord.summary`; None where that is unknown.
    contact: dict[str, Any] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Give it as JSON-ready dictionary."""
        return {'time': self.time, 'stamp': self.event.stamp, 'onset': self.event.onset,
                'link': self.event.link, 'channel': self.channel, 'ratio': self.ratio,
                'seconds': self.seconds, 'push': self.push, 'contact': self.contact}


@dataclass(frozen=True, eq=False)
class Watched:
    """One bag as one method saw it."""

    bag: str  # path of the bag
    stamp: NDArray[np.int64]  # samples with a residual, (samples,) [ns]
    # (samples,): largest ratio to the collision threshold that held for the debounce time.
    ratio: FloatArray
    truth: Truth  # pushes that there were
    sightings: tuple[Sighting, ...]  # what was found

    @property
    def alarms(self) -> NDArray[np.int64]:
        """Stamps at which the detector was sure [ns]."""
        return np.array([item.event.stamp for item in self.sightings], dtype=np.int64)


def push_of(stamp: int, pushes: Sequence[KnownPush], late: float = AFTERMATH) -> int | None:
    """
    Find the push that an event belongs to.

    stamp [ns], late [s]; returns None where it is over for longer.
    """
    begun = [i for i, push in enumerate(pushes) if push.begin - _EARLY <= stamp]
    if not begun or stamp > pushes[begun[-1]].end + round(late * 1e9):
        return None
    return begun[-1]


def score(watched: Sequence[Watched], alarms: Sequence[NDArray[np.int64]]) -> CollisionScore:
    """Judge alarms by the pushes: alarms [ns]."""
    latencies, pushes, false, free = [], 0, 0, 0.0
    for item, times in zip(watched, alarms, strict=True):
        if not item.truth.known:
            continue
        near = np.zeros(len(times), dtype=bool)
        span = float(item.stamp[-1] - item.stamp[0]) * 1e-9 if len(item.stamp) else 0.0
        for push in item.truth.pushes:
            pushes += 1
            span -= (push.end - push.begin) * 1e-9 + AFTERMATH
            begun = times >= push.begin - _EARLY
            hits = times[begun & (times <= push.end + round(LATE * 1e9))]
            if len(hits):
                latencies.append(max(0.0, float(hits[0] - push.begin) * 1e-9))
            near |= begun & (times <= push.end + round(AFTERMATH * 1e9))
        false += int(np.sum(~near))
        free += max(span, 0.0)
    hours = free / 3600.0
    told = any(item.truth.known for item in watched)
    return CollisionScore(
        sum(len(times) for times in alarms),
        pushes, len(latencies), len(latencies) / pushes if pushes else None,
        float(np.median(latencies)) if latencies else None,
        float(np.percentile(latencies, 95)) if latencies else None,
        false if told else None, hours, false / hours if told and hours > 0 else None)


def alarms_at(item: Watched, factor: float, rearm: float) -> NDArray[np.int64]:
    """
    Give the times at which a threshold that much higher would have given an event.

    rearm [s].
    """
    times = item.stamp[item.ratio > factor]
    if not len(times):
        return times
    return times[np.concatenate([[True], np.diff(times) > round(rearm * 1e9)])]
