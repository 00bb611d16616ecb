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
from datetime import datetime, timezone
from enum import IntEnum
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.compiled import compiled, largest_size
from tudor_dynamics.online.memory import Memory
from tudor_dynamics.online.settings import (
    FRICTION_UNCERTAIN, HIGHEST_RAISE, LEVEL_QUANTILE, LEVEL_SPEED, LOWEST_LEVEL,
    OUTLIER, RINGING_FADE, RINGING_SHARE, WIDEST)
from tudor_dynamics.online.streams import Residual
from tudor_dynamics.online.thresholds import (
    advance, advance_held, evaluate_features, held_friction, MethodThresholds, NEVER, onset_now)
from tudor_dynamics.typing import FloatArray


def time_of_day(stamp: int) -> str:
    """Write a stamp [ns] as UTC: readers are in any zone."""
    return f'{datetime.fromtimestamp(stamp * 1e-9, timezone.utc):%F %T.%f}'[:-3] + ' UTC'


def channel_links(arm: Arm) -> dict[str, tuple[int, str]]:
    """Say which link each joint and gauge belongs to, and how many joints carry it."""
    model = arm.full_model
    bodies: dict[int, str] = {}
    for frame in model.frames:
        if frame.type.name == 'BODY':
            bodies.setdefault(int(frame.parentJoint), frame.name)

    def link(joint: str) -> tuple[int, str]:
        index = int(model.getJointId(joint))
        named = joint.replace('joint', 'link') if 'joint' in joint else f'{joint}_link'
        return len(model.supports[index]) - 1, bodies.get(index, named)

    return {**{joint: link(joint) for joint in arm.active_joints},
            **{gauge.name: link(gauge.joint) for gauge in arm.gauges}}


# How far the arm is from what thresholds were learned on, and how much wider they have to be.
#
# Two distances are known. Speeds beyond those of the recordings show at once. Whatever else
# differs, damper, sample rate, drives or friction, shows in the onset statistic, which is small
# between collisions and blind to forces that last: a quantile of its ratio to the profile is
# followed, so slowly that a push hardly moves it, and compared with what was usual in free motion.


@compiled
def _track(dt: float, ratio: FloatArray, level: FloatArray) -> None:
    """Follow a quantile of each ratio, in steps of its logarithm."""
    up = math.exp(LEVEL_SPEED * LEVEL_QUANTILE * dt)
    down = math.exp(-LEVEL_SPEED * (1.0 - LEVEL_QUANTILE) * dt)
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
    """Compare levels and speeds with those learned; widens what follows."""
    faster = 1.0
    for j in range(len(speeds)):
        faster = max(faster, speeds[j] / reach[j])
    _track(dt, ratio, level)
    for i in range(len(ratio)):
        level[i] = min(max(level[i], LOWEST_LEVEL * usual[i]), WIDEST * usual[i])
        widening[i] = min(max(level[i] / usual[i], faster), WIDEST)


@compiled
def levels(dt: FloatArray, ratio: FloatArray, level: FloatArray) -> FloatArray:
    """Follow the level along a record, (samples, channels), from ``level``, which is written."""
    out = np.empty_like(ratio)
    for k in range(len(dt)):
        _track(dt[k], ratio[k], level)
        out[k] = level
    return out


@dataclass(frozen=True)
class Rates:
    """False alarms that the user allows, per hour of free motion."""

    collision: float = 1.0  # of the level that acts [1/h]
    contact: float = 60.0  # of the level that only warns [1/h]


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


USUAL, STICTION, LEVEL, WIDENING, FRICTION, HELD, RISING, FALLING, CONTACT = range(9)
"""Rows of what is known of each channel: as learned; followed; in force at present."""
COLLISION = CONTACT + 3  # ratios of a level: residual, onset, accumulated onset
CHANNEL_ROWS = COLLISION + 3
REACH, DIRECTION, LATELY = range(3)  # rows of what is known of each joint
LAST, ORIGIN, BEGIN, COUNT, REVERSED = range(5)
"""Places in what is counted: stamps [ns] of the last sample, of the first one of the past and of
the last reversal of each joint; rows of the past."""
TO_CONTACT, TO_COLLISION, SUDDEN, THRESHOLD, ONSET, ONSET_RATIO = range(6)
"""Rows of what is found at a sample."""
GROWTH = 1024


class ExcessStage:
    """Compares residuals with thresholds."""

    def __init__(self, thresholds: MethodThresholds, rates: Rates) -> None:
        self.thresholds = thresholds
        n, joints = len(thresholds.channels), thresholds.n_joints
        self._channels: FloatArray = np.zeros((CHANNEL_ROWS, n))
        self._channels[[USUAL, LEVEL]] = thresholds.usual
        self._channels[STICTION] = thresholds.stiction
        # factor on the thresholds of each channel, for motion that they were not learned on
        self.widening = self._channels[WIDENING]
        self.widening[:] = 1.0
        self._joints: FloatArray = np.zeros((3, joints))
        self._joints[REACH] = thresholds.reach
        self._counts = np.zeros(REVERSED + joints, dtype=np.int64)
        self._profile = np.ascontiguousarray(thresholds.profile)
        self._weights = np.ascontiguousarray(thresholds.taps[::-1]).reshape(-1, n)
        self._past: FloatArray = np.empty((2 * GROWTH, 1 + n))
        self._lasting = self._channels[LEVEL:CONTACT], self._joints, self._counts[REVERSED:]
        self.memory = Memory(self._lasting, np.concatenate(
            [thresholds.usual, thresholds.stiction, thresholds.reach]).tolist())
        self.allow(rates)

    def allow(self, rates: Rates) -> None:
        """Allow so many false alarms from now on."""
        self.rates = rates
        collision = self.thresholds.ratios(rates.collision)
        contact = np.minimum(self.thresholds.ratios(rates.contact), collision)
        self._channels[CONTACT:] = np.concatenate([contact, collision]).reshape(6, -1)

    def step(self, residual: Residual, first: bool = False) -> Excess:
        """Compare one sample."""
        if self._counts[COUNT] == len(self._past):
            begin, count = self._counts[BEGIN], self._counts[COUNT]
            kept = self._past[begin:].copy()
            if len(kept) > len(self._past) // 2:
                self._past = np.empty((2 * len(self._past), self._past.shape[1]))
            self._past[:len(kept)] = kept
            self._counts[[BEGIN, COUNT]] = 0, count - begin
        out = np.empty((6, self._channels.shape[1]))
        judge(residual.motion.stamp, first, self.thresholds.step, residual.motion.row,
              residual.value, self._counts, self._joints, self._channels, self._profile,
              self._weights, self._past, out)
        self.memory.step(residual.motion.stamp)
        return Excess(residual, out[ONSET], out[TO_CONTACT], out[TO_COLLISION], out[SUDDEN],
                      out[THRESHOLD])


@compiled
def judge(
    stamp: int, first: bool, step: float, row: FloatArray, value: FloatArray,
    counts: NDArray[np.int64], joints: FloatArray, channels: FloatArray, profile: FloatArray,
    weights: FloatArray, past: FloatArray, out: FloatArray,  # past, weights: see `onset_now`
) -> None:
    """Compare one sample with thresholds, and remember in named rows what the next one needs."""
    first = first or counts[COUNT] == 0 or stamp <= counts[LAST]
    last, dt = counts[LAST], (stamp - counts[LAST]) * 1e-9
    if first:
        last, dt = NEVER, 0.0
        counts[ORIGIN], counts[BEGIN], counts[COUNT] = stamp, 0, 0
        counts[REVERSED:] = NEVER
        joints[DIRECTION:] = 0.0
        channels[RISING:FALLING + 1] = 0.0
    now = float(stamp - counts[ORIGIN])
    place, counts[LAST] = counts[COUNT], stamp
    counts[COUNT] += 1
    past[place, 0] = now
    columns = np.empty(profile.shape[1])
    evaluate_features(stamp, last, row, joints[DIRECTION], joints[LATELY], counts[REVERSED:],
                      columns)
    for i in range(len(value)):
        if channels[STICTION, i] > 0.0:  # only joints do, and each its own speed
            channels[HELD, i] = held_friction(channels[STICTION, i], columns[1 + i])
    advance_held(dt, value, channels[HELD], channels[FRICTION], past[place, 1:])
    oldest = 1e9 * step * (len(weights) // len(value) - 1)
    if place >= 1 and now >= oldest - 1e3 * step:
        counts[BEGIN] = onset_now(past, counts[BEGIN], place + 1, step, weights, out[ONSET])
    else:
        out[ONSET] = 0.0
    _compare(dt, profile, columns, value, channels, out)
    follow(dt, columns[1:1 + joints.shape[1]], out[ONSET_RATIO], channels[USUAL], joints[REACH],
           channels[LEVEL], channels[WIDENING])


@compiled
def _compare(
    dt: float, profile: FloatArray, columns: FloatArray, value: FloatArray, channels: FloatArray,
    out: FloatArray,
) -> None:
    """Fill all rows of ``out`` but that of the onset."""
    n = len(value)
    onset, held, widening = out[ONSET], channels[HELD], channels[WIDENING]
    signed = np.empty(n)
    for i in range(n):
        usual = soon = 0.0
        for k in range(len(columns)):
            usual += profile[i, k] * columns[k]
            soon += profile[n + i, k] * columns[k]
        out[ONSET_RATIO, i] = abs(onset[i]) / soon
        plain = abs(value[i]) - held[i]
        plain = 0.0 if plain < 0.0 else plain / usual / widening[i]  # NaN stays
        sudden = out[ONSET_RATIO, i] / widening[i]
        signed[i] = math.copysign(plain * usual / (usual + FRICTION_UNCERTAIN * held[i]), value[i])
        for row, level in ((TO_CONTACT, CONTACT), (TO_COLLISION, COLLISION)):
            a, b = plain / channels[level, i], sudden / channels[level + 1, i]
            # NaN must win, as numpy has it
            out[row, i] = a if a > b or a != a else b
        out[SUDDEN, i] = math.copysign(sudden / channels[COLLISION + 1, i], onset[i] * value[i])
        out[THRESHOLD, i] = usual * channels[COLLISION, i] * widening[i] + held[i]
    advance(dt, signed, channels[COLLISION + 2], channels[RISING:FALLING + 1])
    for i in range(n):
        most = max(channels[RISING, i], channels[FALLING, i])
        out[TO_CONTACT, i] = max(out[TO_CONTACT, i], most / channels[CONTACT + 2, i])
        out[TO_COLLISION, i] = max(out[TO_COLLISION, i], most / channels[COLLISION + 2, i])


class Level(IntEnum):
    """How sure the detector is."""

    FREE = 0
    CONTACT = 1
    COLLISION = 2


LEVELS = Level.CONTACT, Level.COLLISION  # those that have a threshold


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
    residuals: dict[str, float] = field(default_factory=dict)  # by channel, at `stamp`, its unit
    ratios: dict[str, float] = field(default_factory=dict)  # by channel, to collision thresholds

    @property
    def channel(self) -> str:
        """Channel of the largest ratio."""
        return max(self.ratios, key=self.ratios.__getitem__)


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
        faded = math.exp((self.stamp - stamp) * 1e-9 / RINGING_FADE)
        bar = max(1.0, self.raised * faded)
        self.stamp = stamp
        self.raised = max(bar, min(RINGING_SHARE * ratio, HIGHEST_RAISE))
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
    """Since when a force has been changing suddenly, and when one was last reported, or passed."""

    since: int | None = None
    last: int = NEVER

    def grows(self, stamp: int, sudden: FloatArray, settings: DetectorSettings) -> bool:
        """Say whether a change has just become certain that adds to the residual."""
        if not largest_size(sudden, 0, len(sudden)) > 1.0:
            self.since = None
            return False
        if (stamp - self.last) * 1e-9 < settings.rearm:  # the arm rings after each change
            self.since, self.last = None, stamp
            return False
        if self.since is None:
            self.since = stamp
        if (stamp - self.since) * 1e-9 < settings.debounce - 1e-9:
            return False
        self.last = stamp
        return bool(sudden[np.argmax(np.abs(sudden))] > 0.0)  # below, a force goes


class CollisionDetector:
    """State of the arm as all methods see it together."""

    def __init__(
        self, settings: DetectorSettings, channels: dict[str, Sequence[str]],
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
            most = largest_size(ratios, 0, len(ratios))
            sure = track.follow(stamp, most, settings.debounce)
            if sure and self.level < level:
                if level is Level.COLLISION:
                    event = self._event(method, excess, track.since)
                self.level = level
        if event is not None:  # what other methods see of it later is not another one
            for onset in self._onsets.values():
                onset.last = stamp
        if self.level:
            self.level = min(self.level, max(
                (level for tracks in self._tracks.values()
                 for level, track in zip(LEVELS, tracks, strict=True)
                 if track.holds(stamp, settings.rearm)), default=Level.FREE))
        return event

    def _event(self, method: str, excess: Excess, since: int | None) -> CollisionEvent:
        stamp = excess.residual.motion.stamp
        names = self.channels[method]
        ratios = dict(zip(names, excess.collision.tolist(), strict=True))
        return CollisionEvent(
            stamp if since is None else since, stamp, method,
            blame([self.links[name] for name in names], excess.contact),
            dict(zip(names, excess.residual.value.tolist(), strict=True)), ratios)


def blame(links: Sequence[tuple[int, str]], contact: FloatArray) -> str:
    """Find the link that was touched: the outermost that shows it, as none beyond a load does."""
    felt = np.flatnonzero(contact > 1.0).tolist() or [int(np.argmax(contact))]
    return max(links[i] for i in felt)[1]
