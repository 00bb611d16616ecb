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

"""How well collisions are found: recordings replayed past every method of detection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags import Recording
from tudor_dynamics.contact.estimate import ContactRecord
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.collisions.score import (
    alarms_at, CollisionScore, push_of, score, Sighting, Watched)
from tudor_dynamics.identification.collisions.truth import Truth
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.detector import CollisionEvent, Level
from tudor_dynamics.monitoring.predictor import Predictor
from tudor_dynamics.monitoring.settings import Found, METHODS, MonitorSettings, SOURCE
from tudor_dynamics.monitoring.state_filter import StateFilter
from tudor_dynamics.monitoring.watch import Watch
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class MethodResult:
    """Result of one method."""

    method: str  # `strain`, `effort` or `momentum`
    score: CollisionScore  # figures at the thresholds asked for
    watched: tuple[Watched, ...]  # bags that were replayed
    # Factor on the threshold, false alarms per hour, detection rate.
    roc: tuple[tuple[float, float, float], ...]
    # Why nothing is said of force and place; empty where something is, or was not asked for.
    no_contact: str = ''


@dataclass(slots=True)
class _Open:
    """An event that is not over."""

    event: CollisionEvent
    ratio: float
    channel: str
    last: int
    touched: ContactRecord | None = None


@dataclass(slots=True)
class _Log:
    """What one method makes of one bag, sample after sample."""

    stamps: list[int] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    under_way: list[_Open] = field(default_factory=list)
    closed: list[_Open] = field(default_factory=list)

    def add(self, found: Found, watch: Watch) -> None:
        """Take the samples that became known, and the level behind them."""
        level = watch.level
        for _, excess in found.excesses:
            stamp, ratio = excess.residual.motion.stamp, float(excess.collision.max())
            self.stamps.append(stamp)
            self.ratios.append(ratio)
            if self.under_way and ratio >= 1.0:
                self.under_way[-1].last = stamp
                if ratio > self.under_way[-1].ratio:
                    self.under_way[-1].ratio = ratio
                    self.under_way[-1].channel = self._channel(
                        self.under_way[-1].event, excess.collision)
        for event in found.events:
            self.close()
            channel = max(event.ratios, key=lambda name: event.ratios[name])
            self.under_way = [_Open(
                event, event.ratios[channel], channel, event.stamp,
                None if watch.contact is None else watch.contact.record())]
        if self.under_way and self.under_way[-1].touched is not None:
            for estimate in found.contacts:
                self.under_way[-1].touched.add(estimate)
        if level is not Level.COLLISION:
            self.close()

    @staticmethod
    def _channel(event: CollisionEvent, ratios: FloatArray) -> str:
        return list(event.ratios)[int(np.argmax(ratios))]

    def close(self) -> None:
        """End the event that is under way."""
        self.closed += self.under_way
        self.under_way = []

    def sightings(self, first: int, truth: Truth) -> tuple[Sighting, ...]:
        """Give what was found, by the time since a stamp."""
        self.close()
        return tuple(Sighting(
            item.event, (item.event.stamp - first) * 1e-9, item.channel, item.ratio,
            (item.last - item.event.onset) * 1e-9, push_of(item.event.stamp, truth.pushes),
            (item.touched.summary() or None) if item.touched is not None else None)
            for item in self.closed)


def watch_bag(
    bundle: ModelBundle, settings: dict[str, MonitorSettings], name: str, recording: Recording,
    truth: Truth,
) -> dict[str, Watched]:
    """Replay one bag past all methods: one filter and one predictor, a detector for each."""
    if not settings:
        return {}
    bundle = bundle.beside_robot()
    common = next(iter(settings.values()))
    front, predictor = StateFilter(bundle.preprocessing, common.gap), Predictor(
        bundle, common.kind, common.observer if recording.strain is not None else 'off')
    watches = {method: Watch(bundle, alone) for method, alone in settings.items()}
    outputs = {SOURCE[method] for method in settings}
    logs = {method: _Log() for method in settings}
    for k, stamp in enumerate(recording.stamp.tolist()):
        motion = front.step(stamp, recording.q[k],
                            None if recording.dq is None else recording.dq[k])
        predicted = None if motion is None else predictor.step(motion, outputs)
        if recording.strain is not None:
            predictor.add_strain(stamp, recording.strain[k])
        for method, watch in watches.items():
            values = getattr(recording, SOURCE[method])[k]
            for found in (Found() if motion is None else watch.add_motion(motion, predicted),
                          watch.add_measured(SOURCE[method], stamp, values)):
                logs[method].add(found, watch)
    first = int(recording.stamp[0])
    result = {}
    for method, alone in settings.items():
        log = logs[method]
        at, ratio = np.array(log.stamps, dtype=np.int64), np.array(log.ratios)
        result[method] = Watched(name, at, _held(at, ratio, alone.detector.debounce), truth,
                                 log.sightings(first, truth))
    return result


def _held(stamp: NDArray[np.int64], ratio: FloatArray, debounce: float) -> FloatArray:
    """Give the ratio that was held for the debounce time before each sample."""
    first = np.searchsorted(stamp, stamp - round(debounce * 1e9))
    return np.array([ratio[a:k + 1].min() for k, a in enumerate(first.tolist())])


def evaluate_collisions(
    bundle: ModelBundle,
    bags: Sequence[tuple[str, Recording]],
    settings: MonitorSettings,
    truths: Sequence[Truth],
) -> list[MethodResult]:
    """Evaluate every method for which there are models, thresholds and signals."""
    results = []
    chosen = _settings(bundle, settings, [recording for _, recording in bags])
    seen = [watch_bag(bundle, chosen, path, recording, _within(truth, recording))
            for (path, recording), truth in zip(bags, truths, strict=True)]
    for method, alone in chosen.items():
        watched = tuple(item[method] for item in seen)
        found = score(watched, [item.alarms for item in watched])
        roc = []
        for factor in np.geomspace(0.1, 10.0, 81).tolist():
            point = score(watched, [alarms_at(item, factor, alone.detector.rearm)
                                    for item in watched])
            roc.append((factor, point.false_alarms_per_hour or 0.0, point.detection_rate or 0.0))
        results.append(MethodResult(method, found, watched, tuple(roc),
                                    Watch(bundle.beside_robot(), alone).no_contact))
    if not results:
        msg = ('the model has no collision thresholds for signals that these bags have; fit it '
               'again with more free motion to be judged by')
        raise UsageError(msg)
    return results


def _within(truth: Truth, recording: Recording) -> Truth:
    """Leave out pushes outside a recording, which may be a part of a bag."""
    begin, end = recording.stamp[0], recording.stamp[-1]
    return replace(truth, pushes=tuple(push for push in truth.pushes
                                       if begin <= push.begin and push.end <= end))


def _settings(
    bundle: ModelBundle, settings: MonitorSettings, recordings: Sequence[Recording],
) -> dict[str, MonitorSettings]:
    """Give for each method that can be judged the settings with which it works alone."""
    found = {}
    for method in METHODS:
        alone = replace(settings, methods=(method,))
        if method in Watch(bundle, alone).stages and not any(
                getattr(recording, SOURCE[method]) is None for recording in recordings):
            found[method] = alone
    return found
