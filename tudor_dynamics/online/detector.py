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

"""From residuals over thresholds to events: ratios, debounce, levels, the link blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.compiled import (
    array_at, compiled, largest, largest_size, places_of, REAL, WHOLE)
from tudor_dynamics.online.prediction import Residual
from tudor_dynamics.online.thresholds import (
    advance, advance_held, evaluate_features, held_friction, MethodThresholds, MotionFeatures,
    NEVER, OnsetFilter, UNSURE, weigh)
from tudor_dynamics.typing import FloatArray


# -- Which link a joint or a gauge tells of

def channel_links(arm: Arm) -> dict[str, tuple[int, str]]:
    """Say which link each joint and gauge belongs to."""
    model = arm.full_model
    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type.name == 'BODY':
            bodies.setdefault(int(frame.parentJoint), frame.name)

    def link(joint: str) -> tuple[int, str]:
        index = int(model.getJointId(joint))
        depth, place = 0, index
        while place:
            depth, place = depth + 1, int(model.parents[place])
        named = joint.replace('joint', 'link') if 'joint' in joint else f'{joint}_link'
        return depth, bodies.get(index, named)

    links = {joint: link(joint) for joint in arm.active_joints}
    links.update({gauge.name: link(gauge.joint) for gauge in arm.gauges})
    return links


# -- How far the arm is from what thresholds were learned on, and how much wider they have to be.
#
# Two distances are known. Speeds beyond those of the recordings show at once. Whatever else
# differs, damper, sample rate, drives or friction, shows in the onset statistic, which is small
# between collisions and blind to forces that last: a quantile of its ratio to the profile is
# followed, so slowly that a push hardly moves it, and compared with what was usual in free motion.

QUANTILE = 0.8
"""Share of the samples that stay below the level that is followed."""
SPEED = 0.5
"""How fast the level follows, in its logarithm [1/s]."""
WIDEST = 4.0
"""Thresholds are not widened more than so many times: the detector would be blind."""
USUAL = 0.9
"""Share of the time in free motion for which the level was lower than what counts as usual."""
UNLIKE = 1.5
"""Widening that the user should know of."""
OUTLIER = 6.0
"""Ratios that are so many times the level are collisions, and do not move it."""
LOWEST = 0.5
"""The level does not fall further below that of free motion: an arm at rest would forget it."""


class Familiarity:
    """
    Follows how large onsets are at present, beside how large they were in free motion.

    widening (channels,); usual (channels,): infinite where it is not known; reach (joints,)
    [rad/s or m/s]: infinite where they are not known.
    """

    def __init__(self, usual: FloatArray, reach: FloatArray) -> None:
        self.usual, self.reach = usual, reach
        self.level = np.where(np.isfinite(usual), usual, 0.0)
        self.widening = np.ones(len(usual))

    def step(self, dt: float, speeds: FloatArray, ratio: FloatArray) -> None:
        """
        Take one sample into account; its widening holds for the next.

        dt [s], speeds (joints,) [rad/s or m/s], ratio (channels,).
        """
        follow(dt, speeds, ratio, self.usual, self.reach, self.level, self.widening)


@compiled
def _track(dt: float, ratio: FloatArray, level: FloatArray) -> None:
    """Follow a quantile of each ratio, in steps of its logarithm."""
    up, down = math.exp(SPEED * QUANTILE * dt), math.exp(-SPEED * (1.0 - QUANTILE) * dt)
    for i in range(len(ratio)):
        if ratio[i] <= level[i]:
            level[i] *= down
        elif ratio[i] <= OUTLIER * level[i]:
            level[i] *= up


@compiled
def follow(
    dt: float, speeds: FloatArray, ratio: FloatArray, usual: FloatArray, reach: FloatArray,
    level: FloatArray, widening: FloatArray,
) -> None:
    """Compare levels and speeds with what was learned."""
    faster = 1.0
    for j in range(len(speeds)):
        faster = max(faster, speeds[j] / reach[j])
    _track(dt, ratio, level)
    for i in range(len(ratio)):
        if math.isfinite(usual[i]):
            level[i] = min(max(level[i], LOWEST * usual[i]), WIDEST * usual[i])
            widening[i] = min(max(level[i] / usual[i], faster), WIDEST)
        else:
            widening[i] = min(faster, WIDEST)


def levels(dt: FloatArray, ratio: FloatArray) -> FloatArray:
    """
    Follow the level along a record.

    dt (samples,) [s], ratio (samples, channels); returns (samples, channels).
    """
    out = np.empty_like(ratio)
    _record(dt, ratio, np.quantile(ratio, QUANTILE, axis=0), out)
    return out


@compiled
def _record(dt: FloatArray, ratio: FloatArray, level: FloatArray, out: FloatArray) -> None:
    """Follow a record, and keep the levels."""
    for k in range(len(dt)):
        _track(dt[k], ratio[k], level)
        out[k] = level


# -- How far the residuals of one method stand above or below their thresholds

@dataclass(frozen=True)
class Rates:
    """False alarms that the user allows, per hour of free motion."""

    collision: float = 1.0  # of the level that acts [1/h]
    contact: float = 60.0  # of the level that only tells [1/h]


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Excess:
    """One sample of one method against its thresholds."""

    residual: Residual  # residual of the sample
    onset: FloatArray  # onset statistic, in the unit of the residual, (channels,)
    # (channels,): ratio to the threshold of each level, the largest of residual, onset and
    # accumulated onset; above 1 exceeds.
    contact: FloatArray
    collision: FloatArray
    # (channels,): ratio of the onset to its collision threshold; negative where it takes from the
    # residual.
    sudden: FloatArray
    threshold: FloatArray  # collision threshold of the residual in force, in its unit, (channels,)


class ExcessStage:
    """Compares residuals with thresholds."""

    def __init__(self, thresholds: MethodThresholds, rates: Rates) -> None:
        self.thresholds = thresholds
        self._features = MotionFeatures(thresholds.n_joints)
        self._onset = OnsetFilter(thresholds.taps, thresholds.step)
        self._familiarity = Familiarity(thresholds.usual, thresholds.reach)
        n = len(thresholds.channels)
        self._sums, self._friction, self._held = np.zeros((2, n)), np.zeros(n), np.zeros(n)
        self._columns = np.empty(self._features.size)
        self._sticks = bool(thresholds.stiction.any())
        self._last: int | None = None
        self.rates = rates

    @property
    def widening(self) -> FloatArray:
        """Factor on the thresholds of each channel, for motion that they were not learned on."""
        return self._familiarity.widening

    @property
    def rates(self) -> Rates:
        """Give the false alarms allowed; may be changed at any time."""
        return self._rates

    @rates.setter
    def rates(self, rates: Rates) -> None:
        self._rates = rates
        self._collision = self.thresholds.ratios(rates.collision)
        self._contact = np.minimum(self.thresholds.ratios(rates.contact), self._collision)
        self._arrange()

    def _arrange(self) -> None:
        """Write down where all lies that a sample is judged by, in the order of `_judge`."""
        features, onset, known = self._features, self._onset, self._familiarity
        self._past = onset.x
        self._tables = [np.ascontiguousarray(table) for table in (
            self._columns, features.direction, features.lately, self.thresholds.stiction,
            self._held, self._friction, onset.t, onset.ages, self._contact, self._collision,
            known.widening, known.usual, known.reach, known.level,
            onset.x, onset.weights, self.thresholds.profile, self._sums, features.reversed_at)]
        self._places = places_of(self._tables)

    def step(self, residual: Residual, first: bool = False) -> Excess:
        """Compare one sample."""
        stamp = residual.motion.stamp
        first = first or self._last is None or stamp <= self._last
        dt = 0.0 if first or self._last is None else (stamp - self._last) * 1e-9
        last = NEVER if first or self._last is None else self._last
        if first:
            self._features.reset()
            self._sums[:] = 0.0
        self._last = stamp
        onset = self._onset
        known = onset.take_place(stamp, first)
        if onset.x is not self._past:
            self._arrange()
        out = np.empty((6, len(self._friction)))
        onset.begin = _judge(stamp, last, dt, self._sticks, onset.begin, onset.count, known,
                             residual.motion.row, residual.value, self._places, out)
        return Excess(residual, out[5], out[0], out[1], out[2], out[3])


@compiled
def _judge(
    stamp: int, last: int, dt: float, sticks: bool, begin: int, count: int, known: bool,
    row: FloatArray, value: FloatArray, places: NDArray[np.int64], out: FloatArray,
) -> int:
    """Fill ratios and threshold as `_compare`, and the onset behind; gives its new beginning."""
    # in one call: to hand all over one after the other takes longer than all that is computed
    columns, direction = array_at(places, 0, REAL, 1), array_at(places, 1, REAL, 1)
    lately, stiction = array_at(places, 2, REAL, 1), array_at(places, 3, REAL, 1)
    held, friction = array_at(places, 4, REAL, 1), array_at(places, 5, REAL, 1)
    t, ages = array_at(places, 6, REAL, 1), array_at(places, 7, REAL, 1)
    contact, collision = array_at(places, 8, REAL, 1), array_at(places, 9, REAL, 1)
    widening, usual = array_at(places, 10, REAL, 1), array_at(places, 11, REAL, 1)
    reach, level = array_at(places, 12, REAL, 1), array_at(places, 13, REAL, 1)
    x, weights = array_at(places, 14, REAL, 2), array_at(places, 15, REAL, 2)
    profile, sums = array_at(places, 16, REAL, 2), array_at(places, 17, REAL, 2)
    reversed_at, onset = array_at(places, 18, WHOLE, 1), out[5]
    evaluate_features(stamp, last, row, direction, reversed_at, lately, columns)
    if sticks:  # only joints do, and each its own speed
        for i in range(len(held)):
            held[i] = held_friction(stiction[i], columns[1 + i])
    advance_held(dt, value, held, friction, x[count - 1])
    if known:
        begin = weigh(t, x, begin, count, ages, weights, onset)
    else:
        onset[:] = 0.0
    _compare(profile, columns, value, onset, contact, collision, widening, held, dt, sums, out)
    follow(dt, columns[1:1 + len(direction)], out[4], usual, reach, level, widening)
    return begin


@compiled
def _compare(
    profile: FloatArray, columns: FloatArray, value: FloatArray, onset: FloatArray,
    contact: FloatArray, collision: FloatArray, widening: FloatArray, held: FloatArray,
    dt: float, sums: FloatArray, out: FloatArray,
) -> None:
    """Fill ratios to contact and collision, onset's, residual's threshold, onset by profile."""
    n = len(value)
    signed = np.empty(n)
    for i in range(n):
        usual = soon = 0.0
        for k in range(len(columns)):
            usual += profile[i, k] * columns[k]
            soon += profile[n + i, k] * columns[k]
        out[4, i] = abs(onset[i]) / soon
        plain = abs(value[i]) - held[i]
        plain = 0.0 if plain < 0.0 else plain / usual / widening[i]  # NaN stays
        sudden = out[4, i] / widening[i]
        signed[i] = math.copysign(plain * usual / (usual + UNSURE * held[i]), value[i])
        for level, ratio in enumerate((contact, collision)):
            a, b = plain / ratio[i], sudden / ratio[n + i]
            # NaN must win, as numpy has it
            out[level, i] = a if a > b or a != a else b
        out[2, i] = math.copysign(sudden / collision[n + i], onset[i] * value[i])
        out[3, i] = usual * collision[i] * widening[i] + held[i]
    advance(dt, signed, collision[2 * n:], sums)
    for i in range(n):
        most = max(sums[0, i], sums[1, i])
        out[0, i] = max(out[0, i], most / contact[2 * n + i])
        out[1, i] = max(out[1, i], most / collision[2 * n + i])


# -- From ratios to events: debounce, two levels, release, pushes upon pushes, the link blamed

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
