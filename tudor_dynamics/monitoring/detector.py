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

"""From ratios to events: debounce, two levels, hysteresis, re-arming, and the link blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.monitoring.excess import Excess
from tudor_dynamics.small_arrays import largest

FloatArray = NDArray[np.float64]


class Level(IntEnum):
    """How sure the detector is."""

    FREE = 0
    CONTACT = 1
    COLLISION = 2


@dataclass(frozen=True)
class DetectorSettings:
    """
    Times and hysteresis.

    Attributes
    ----------
    debounce : float
        Time for which a threshold must be exceeded [s].
    release : float
        Fraction of the threshold below which a level is left.
    rearm : float
        Time below it before that [s].

    """

    debounce: float = 0.01
    release: float = 0.5
    rearm: float = 0.5


@dataclass(frozen=True)
class CollisionEvent:
    """
    A collision that has been found.

    Attributes
    ----------
    onset : int
        Stamp of the first sample above the threshold [ns].
    stamp : int
        Stamp of the sample at which it was sure [ns].
    method : str
        ``strain``, ``effort`` or ``momentum``.
    link : str
        Link that the pattern of residuals blames.
    residuals : dict of str to float
        Residual of each channel at ``stamp``, in its unit.
    ratios : dict of str to float
        Ratio of each channel to its collision threshold.

    """

    onset: int
    stamp: int
    method: str
    link: str
    residuals: dict[str, float] = field(default_factory=dict)
    ratios: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class _Track:
    """Since when a method has been above, and whether it has been quiet since."""

    since: int | None = None
    quiet: bool = True
    begin: int | None = None
    total: float = 0.0
    count: int = 0

    def listen(self, stamp: int, ratio: float, settings: DetectorSettings) -> None:
        """
        Judge whether it is quiet.

        By the mean over a window, because the peaks of a good model's residual, which is noise,
        come near the threshold all the time.
        """
        if not ratio < 1.0:
            self.quiet, self.begin = False, None
            return
        if self.begin is None:
            self.begin, self.total, self.count = stamp, 0.0, 0
        self.total += ratio
        self.count += 1
        if (stamp - self.begin) * 1e-9 >= settings.rearm:
            self.quiet = self.quiet or self.total < settings.release * self.count
            self.begin = None


class CollisionDetector:
    """
    State of the arm as all methods see it together.

    Parameters
    ----------
    settings : DetectorSettings
        Times and hysteresis.
    channels : dict of str to sequence of str
        Method to its channels.
    links : dict of str to (int, str)
        Channel to the link that it belongs to: distance from the base in joints, and name.

    Attributes
    ----------
    level : Level
        State of the arm now.

    """

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
        self._tracks = {(method, level): _Track() for method in self.channels
                        for level in (Level.CONTACT, Level.COLLISION)}
        self._stamps: dict[str, int] = {}

    def step(self, method: str, excess: Excess) -> CollisionEvent | None:
        """
        Take one sample of one method into account.

        Parameters
        ----------
        method : str
            Method that the sample is of.
        excess : Excess
            Ratios of the sample to its thresholds.

        Returns
        -------
        CollisionEvent or None
            An event when the level rises to collision.

        """
        stamp = excess.residual.motion.stamp
        if stamp < self._stamps.get(method, stamp):  # the clock was set back
            self.reset()
        self._stamps[method] = stamp
        event = None
        for level, ratios in ((Level.CONTACT, excess.contact),
                              (Level.COLLISION, excess.collision)):
            sure = self._follow(self._tracks[method, level], stamp, largest(ratios))
            if sure and self.level < level:
                if level is Level.COLLISION:
                    event = self._event(method, excess)
                self.level = level
        if self.level and not self._holds(self.level):
            self.level = (Level.CONTACT if self.level is Level.COLLISION
                          and self._holds(Level.CONTACT) else Level.FREE)
        return event

    def _follow(self, track: _Track, stamp: int, ratio: float) -> bool:
        """Say whether the threshold has been exceeded long enough."""
        track.listen(stamp, ratio, self.settings)
        if not ratio > 1.0:
            track.since = None
            return False
        if track.since is None:
            track.since = stamp
        return (stamp - track.since) * 1e-9 >= self.settings.debounce - 1e-9

    def _holds(self, level: Level) -> bool:
        return any(not track.quiet for (_, of), track in self._tracks.items() if of is level)

    def _event(self, method: str, excess: Excess) -> CollisionEvent:
        stamp = excess.residual.motion.stamp
        since = self._tracks[method, Level.COLLISION].since
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

    Parameters
    ----------
    links : sequence of (int, str)
        Link of each channel: distance from the base in joints, and name.
    contact : ndarray of shape (n_channels,)
        Ratio to the contact threshold.

    Returns
    -------
    str
        Link.

    """
    felt = np.flatnonzero(contact > 1.0).tolist() or [int(np.argmax(contact))]
    return max(links[i] for i in felt)[1]
