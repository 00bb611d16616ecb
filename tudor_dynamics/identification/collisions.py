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
How well collisions are found: recordings replayed through the monitor, against the true forces.

A push counts as found if an event falls between its start and shortly after its end. Its latency
runs from the start of the force to the sample at which the detector is sure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags import read_wrenches, Recording
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.detector import CollisionEvent
from tudor_dynamics.monitoring.monitor import Monitor
from tudor_dynamics.monitoring.replay import replay
from tudor_dynamics.monitoring.watch import METHODS, MonitorSettings

FloatArray = NDArray[np.float64]

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
        Their ratio.

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
        Bag.
    stamp : ndarray of int64, shape (n_samples,)
        Samples with a residual [ns].
    ratio : ndarray of shape (n_samples,)
        Largest ratio to the collision threshold that held for the debounce time.
    pushes : tuple of Push
        Truth.
    events : tuple of CollisionEvent
        What was found.

    """

    bag: str
    stamp: NDArray[np.int64]
    ratio: FloatArray
    pushes: tuple[Push, ...]
    events: tuple[CollisionEvent, ...]


@dataclass(frozen=True, eq=False)
class MethodResult:
    """
    Result of one method.

    Attributes
    ----------
    method : str
        ``strain``, ``effort`` or ``momentum``.
    score : CollisionScore
        Figures at the thresholds asked for.
    watched : tuple of Watched
        Bags.
    roc : tuple of (float, float, float)
        Factor on the threshold, false alarms per hour, detection rate.

    """

    method: str
    score: CollisionScore
    watched: tuple[Watched, ...]
    roc: tuple[tuple[float, float, float], ...]


def find_pushes(path: str) -> tuple[Push, ...]:
    """
    Read the pushes of a bag from its ``/applied_wrench``.

    Parameters
    ----------
    path : str
        Bag.

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


def watch_bag(
    bundle: ModelBundle, settings: MonitorSettings, name: str, recording: Recording,
    pushes: tuple[Push, ...],
) -> Watched:
    """
    Replay one bag through a monitor.

    Parameters
    ----------
    bundle : ModelBundle
        Model with thresholds.
    settings : MonitorSettings
        Choices, one method.
    name : str
        Bag.
    recording : Recording
        Its signals.
    pushes : tuple of Push
        Truth.

    Returns
    -------
    Watched
        Ratios and events.

    """
    stamps: list[int] = []
    ratios: list[float] = []
    events: list[CollisionEvent] = []
    for _, found in replay(Monitor(bundle, settings), recording):
        events += found.events
        for _, excess in found.excesses:
            stamps.append(excess.residual.motion.stamp)
            ratios.append(float(excess.collision.max()))
    stamp, ratio = np.array(stamps, dtype=np.int64), np.array(ratios)
    return Watched(name, stamp, _held(stamp, ratio, settings.detector.debounce), pushes,
                   tuple(events))


def _held(stamp: NDArray[np.int64], ratio: FloatArray, debounce: float) -> FloatArray:
    """Give the ratio that was held for the debounce time before each sample."""
    first = np.searchsorted(stamp, stamp - round(debounce * 1e9))
    return np.array([ratio[a:k + 1].min() for k, a in enumerate(first.tolist())])


def _score(watched: Sequence[Watched], alarms: Sequence[NDArray[np.int64]]) -> CollisionScore:
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


def _alarms(item: Watched, factor: float, rearm: float) -> NDArray[np.int64]:
    """Give the times at which a threshold that much higher would have given an event."""
    times = item.stamp[item.ratio > factor]
    if not len(times):
        return times
    return times[np.concatenate([[True], np.diff(times) > round(rearm * 1e9)])]


def evaluate_collisions(
    bundle: ModelBundle,
    bags: Sequence[tuple[str, Recording]],
    settings: MonitorSettings,
) -> list[MethodResult]:
    """
    Evaluate every method for which there are models, thresholds and signals.

    Parameters
    ----------
    bundle : ModelBundle
        Model with thresholds.
    bags : sequence of (path, Recording)
        Bags, with or without pushes.
    settings : MonitorSettings
        Choices; each method is given the whole false-alarm rate.

    Returns
    -------
    list of MethodResult
        One for each method.

    Raises
    ------
    UsageError
        If the model has no thresholds.

    """
    results = []
    truth = [tuple(push for push in find_pushes(path)
                   if recording.stamp[0] <= push.begin and push.end <= recording.stamp[-1])
             for path, recording in bags]
    for method in METHODS:
        alone = replace(settings, methods=(method,))
        monitor = Monitor(bundle, alone)
        output = 'strain' if method == 'strain' else 'effort'
        if method not in monitor.watch.stages or any(
                getattr(recording, output) is None for _, recording in bags):
            continue
        watched = tuple(watch_bag(bundle, alone, path, recording, pushes)
                        for (path, recording), pushes in zip(bags, truth, strict=True))
        score = _score(watched, [np.array([e.stamp for e in item.events], dtype=np.int64)
                                 for item in watched])
        roc = []
        for factor in np.geomspace(0.1, 10.0, 81).tolist():
            point = _score(watched, [_alarms(item, factor, alone.detector.rearm)
                                     for item in watched])
            roc.append((factor, point.false_alarms_per_hour, point.detection_rate or 0.0))
        results.append(MethodResult(method, score, watched, tuple(roc)))
    if not results:
        msg = ('the model has no collision thresholds for signals that these bags have; fit it '
               'again with at least half a minute of free motion to be judged by')
        raise UsageError(msg)
    return results
