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

"""From ratios to events: debounce, two levels, release, pushes upon pushes, the link blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import math

import numpy as np

from tudor_dynamics.monitoring.thresholds.excess import Excess
from tudor_dynamics.monitoring.thresholds.features import NEVER
from tudor_dynamics.small_arrays import largest, largest_size
from tudor_dynamics.typing import FloatArray

HIGHEST = 10.0
"""To which a threshold is raised at most: a model that loses the arm for a moment has residuals
without bound, and would make it blind for as long as that takes to fade."""
SHARE = 0.15
"""Part of an excess that comes back behind it and is no contact: the arm swings, teeth meet."""
AFTERMATH = 1.0
"""Time constant with which it is forgotten [s]."""


class Level(IntEnum):
    """How sure the detector is."""

    FREE = 0
    CONTACT = 1
    COLLISION = 2


LEVELS = Level.CONTACT, Level.COLLISION
"""Those that have a threshold."""


@dataclass(frozen=True)
class DetectorSettings:
    """Times of the detector."""

    debounce: float = 0.01  # time for which a threshold must be exceeded [s]
    rearm: float = 0.3  # time below a threshold after which its level is left [s]


@dataclass(frozen=True)
class CollisionEvent:
    """A collision that has been found."""

    onset: int  # stamp of the first sample above the threshold [ns]
    stamp: int  # stamp of the sample at which it was sure [ns]
    method: str  # `strain`, `effort` or `momentum`
    link: str  # link that the pattern of residuals blames
    # Residual of each channel at `stamp`, in its unit.
    residuals: dict[str, float] = field(default_factory=dict)
    # Ratio of each channel to its collision threshold.
    ratios: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class _Track:
    """Since when a threshold has been exceeded, when it was last, and how far it is raised."""

    since: int | None = None
    last: int = NEVER
    raised: float = 1.0
    stamp: int = 0

    def follow(self, stamp: int, ratio: float, debounce: float) -> bool:
        """Say whether the threshold has been exceeded long enough; NaN holds, and is no excess."""
        if self.raised == 1.0 and ratio < 1.0:  # nearly always; what follows comes to the same
            self.stamp, self.since = stamp, None
            return False
        faded = math.exp((self.stamp - stamp) * 1e-9 / AFTERMATH)
        bar = max(1.0, self.raised * faded)
        self.stamp = stamp
        self.raised = max(bar, min(SHARE * ratio, HIGHEST))
        if not ratio < bar:
            self.last = stamp
        if not ratio > bar:
            self.since = None
            return False
        if self.since is None:
            self.since = stamp
        return (stamp - self.since) * 1e-9 >= debounce - 1e-9

    def holds(self, stamp: int, rearm: float) -> bool:
        """Say whether it was exceeded within a time [s]."""
        return (stamp - self.last) * 1e-9 < rearm


@dataclass(slots=True)
class _Onset:
    """Since when a force has been changing suddenly, and when one was last told of, or passed."""

    since: int | None = None
    told: int = NEVER

    def grows(self, stamp: int, sudden: FloatArray, settings: DetectorSettings) -> bool:
        """
        Say whether a change has just become certain that adds to the residual.

        One that takes from it is a force that goes. A change counts behind a time without any:
        the arm rings behind each.
        """
        if not largest_size(sudden, 0, len(sudden)) > 1.0:
            self.since = None
            return False
        if (stamp - self.told) * 1e-9 < settings.rearm:
            self.since, self.told = None, stamp
            return False
        if self.since is None:
            self.since = stamp
        if (stamp - self.since) * 1e-9 < settings.debounce - 1e-9:
            return False
        self.told = stamp
        return bool(sudden[np.argmax(np.abs(sudden))] > 0.0)


class CollisionDetector:
    """State of the arm as all methods see it together."""

    def __init__(
        self,
        settings: DetectorSettings,
        channels: dict[str, Sequence[str]],
        links: dict[str, tuple[int, str]],
    ) -> None:
        self.settings = settings
        self.channels = channels
        self.links = links
        self.reset()

    def reset(self) -> None:
        """Forget the past and be armed."""
        self.level = Level.FREE
        self._tracks = {method: (_Track(), _Track()) for method in self.channels}
        self._onsets = {method: _Onset() for method in self.channels}
        self._stamps: dict[str, int] = {}

    def step(self, method: str, excess: Excess) -> CollisionEvent | None:
        """Take one sample of one method into account."""
        stamp = excess.residual.motion.stamp
        if stamp < self._stamps.get(method, stamp):  # the clock was set back
            self.reset()
        self._stamps[method] = stamp
        event, settings = None, self.settings
        onset = self._onsets[method]
        if onset.grows(stamp, excess.sudden, settings) and self.level is Level.COLLISION:
            event = self._event(method, excess, onset.since)
        for level, track, ratios in zip(LEVELS, self._tracks[method],
                                        (excess.contact, excess.collision), strict=True):
            sure = track.follow(stamp, largest(ratios), settings.debounce)
            if sure and self.level < level:
                if level is Level.COLLISION:
                    event = self._event(method, excess, track.since)
                self.level = level
        if event is not None:  # what other methods see of it later is not another one
            for onset in self._onsets.values():
                onset.told = stamp
        while self.level and not self._holds(self.level, stamp):
            self.level = Level(self.level - 1)
        return event

    def _holds(self, level: Level, stamp: int) -> bool:
        return any(track.holds(stamp, self.settings.rearm) for tracks in self._tracks.values()
                   for of, track in zip(LEVELS, tracks, strict=True) if of >= level)

    def _event(self, method: str, excess: Excess, since: int | None) -> CollisionEvent:
        stamp = excess.residual.motion.stamp
        names = self.channels[method]
        ratios = dict(zip(names, excess.collision.tolist(), strict=True))
        return CollisionEvent(
            stamp if since is None else since, stamp, method,
            blame([self.links[name] for name in names], excess.contact),
            dict(zip(names, excess.residual.value.tolist(), strict=True)), ratios)


def blame(links: Sequence[tuple[int, str]], contact: FloatArray) -> str:
    """
    Find the link that was touched.

    A load on a link is felt by all gauges and joints between it and the base, and by none beyond
    it: the outermost link that feels something is the one.

    contact (channels,).
    """
    felt = np.flatnonzero(contact > 1.0).tolist() or [int(np.argmax(contact))]
    return max(links[i] for i in felt)[1]
