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
The load sample by sample: a Kalman filter with the mass and the zero of each channel.

All channels come in units of their noise, which over a second is white: its density is 1. What is
old is forgotten as the mass and the zeros may wander. What comes suddenly is another load from an
instant on, which is looked for in the recent past: at once where it was announced, and where it
was not, once it is clear that it is no touch.
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.payload.change import BLOCK, Change, RecentPast
from tudor_dynamics.typing import FloatArray

WANDERS = 0.005
"""Of the mass, in payloads of the model over a second."""
ZERO, ZERO_WANDERS = 1.0, 0.03
"""Of a channel in its noise: as it is not known at first, and over a second."""
BEGUN = 2.0
"""Time for which the load that is there at the beginning is learned, touched or not [s]."""
RECENT, ANNOUNCED = 1.2, 4.0
"""Past in which a change is looked for, and the same while one is announced [s]."""
SEEN, SOONEST = 0.2, 0.6
"""Time since a change until it is looked for, and until it is told if not announced [s]."""
EXPECTED_GAIN = 6.0
"""What an announced change explains at least; by chance it is 1."""
LOUD = 40.0
"""What any other explains at least."""
TOUCH = 1.3
"""A load explains it as well as a moment that stays, but for this."""
PRESSED = 0.9
"""Part of what its weight without inertia leaves over that a load leaves at most, until it has
stayed: on an arm that does not move the two are the same."""
LIGHTEST, HEAVIEST = 0.12, 1.5
"""Loads that are told from touches, in payloads of the model."""
LASTING, LIGHTER = 3.0, 0.02
"""What has stayed for so long [s] is a load from so little on, and be it as its weight alone."""
ODD = 60.0
"""What a moment that stays explains at least of what came, if something touches the arm."""
UNSURE = 0.05
"""Part of a load that has just come by which it may be wrong, beside its own noise."""
LARGEST_STEP = 0.1
"""A sample stands for no more time than this [s]."""


@compiled
def observe_load(x: FloatArray, p: FloatArray, left: FloatArray, worth: FloatArray, dt: float,
                 wander: float, zero: float) -> None:
    """Advance the filter by one sample; channels have noise of the density 1."""
    size, channels = x.shape[0], left.shape[0]
    p[0, 0] += wander * dt
    gain = np.empty(size)
    for c in range(channels):
        p[1 + c, 1 + c] += zero * dt
        for i in range(size):
            gain[i] = p[i, 0] * worth[c] + p[i, 1 + c]
        spread = worth[c] * gain[0] + gain[1 + c] + 1.0 / dt
        new = left[c] - worth[c] * x[0] - x[1 + c]
        for i in range(size):
            x[i] += gain[i] / spread * new
        for i in range(size):
            for j in range(size):
                p[i, j] -= gain[i] * gain[j] / spread


class LoadObserver:
    """
    The load that an arm carries, and whether what came suddenly is one.

    reference [kg], lag [s].
    """

    def __init__(
        self, channels: int, reference: float, lag: float = 0.0, explained: float = 0.15,
    ) -> None:
        self._channels, self._reference, self._explained = channels, reference, explained
        seen = ramp(lag, round(ANNOUNCED / BLOCK))
        self._recent = RecentPast(channels, RECENT, seen)
        self._announced = RecentPast(channels, ANNOUNCED, seen)
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        count = 1 + self._channels
        self._x, self._p = np.zeros(count), np.diag(np.full(count, ZERO ** 2))
        self._p[0, 0] = self._reference ** 2
        self._seconds = 0.0
        self._announcing = False
        self._keep()

    def _keep(self) -> None:
        """Let the past begin now."""
        self._odd, self._waited = False, 0.0
        self._recent.clear()
        self._announced.clear()
        # as many as there are blocks, and the one before them
        self._kept = deque([(self._x.copy(), self._p.copy())], maxlen=round(RECENT / BLOCK) + 1)

    @property
    def mass(self) -> float:
        """Load beside what the model knows [kg]."""
        return float(self._x[0])

    @property
    def std(self) -> float:
        """Its standard deviation [kg]."""
        return math.sqrt(max(float(self._p[0, 0]), 0.0))

    def step(
        self, dt: float, left: FloatArray, worth: FloatArray, weight: FloatArray, *, held: bool,
        expected: bool = False,
    ) -> float:
        """
        Take a sample into account.

        left, worth, weight (channels,); dt [s]: 0 at a beginning; returns [kg], zero otherwise.
        """
        dt = min(dt, LARGEST_STEP)
        if dt <= 0.0:
            self._keep()
            return 0.0
        self._seconds = min(self._seconds + dt, BEGUN)
        if expected != self._announcing or (expected and self._announced.full):
            self._announcing = expected
            self._keep()
        if expected and self._seconds >= BEGUN:
            if self._announced.add(dt, left, worth, weight):
                self._follow()
            return 0.0
        self._waited = self._waited + dt if held or self._odd else 0.0
        if self._recent.add(dt, left, worth, weight):
            found = self._recent.changed(self._kept[0][0], SEEN)
            if found is not None and self._told(found):
                self._take(found, *self._kept[0])
                self._keep()
                return found.mass
            self._odd = found is not None and found.came - found.touched > ODD
            self._kept.append((self._x.copy(), self._p.copy()))
        if self._seconds < BEGUN or not (held or self._odd):
            observe_load(self._x, self._p, left, worth, dt, (WANDERS * self._reference) ** 2,
                         ZERO_WANDERS ** 2)
        return 0.0

    def _follow(self) -> None:
        """Look for the announced change, from the load of before."""
        before, spread = self._kept[0]
        found = self._announced.changed(before, BLOCK)
        if found is None:
            return
        if found.gain > EXPECTED_GAIN and self._possible(float(before[0]), found):
            self._take(found, before, spread)
            return
        self._x[:], self._p[:] = before, spread
        # it may have come without having shown: no better known than it would be
        self._p[0, 0] += 1.0 / max(found.information, self._reference ** -2)

    def _take(self, found: Change, before: FloatArray, spread: FloatArray) -> None:
        self._x[:], self._p[:] = before, spread
        self._x[0] += found.mass
        self._p[0, :] = self._p[:, 0] = 0.0
        self._p[0, 0] = 1.0 / found.information + (UNSURE * found.mass) ** 2

    def _possible(self, carried: float, found: Change) -> bool:
        return (abs(found.mass) < HEAVIEST * self._reference
                and carried + found.mass > -LIGHTEST * self._reference)

    def _told(self, found: Change) -> bool:
        """Say whether a change that nobody has announced is clearly one of the load."""
        stayed = self._waited >= LASTING
        lightest, pressed = (LIGHTER, TOUCH) if stayed else (LIGHTEST, PRESSED)
        return (self._seconds >= BEGUN and found.since > SOONEST - 0.5 * BLOCK
                and found.gain > LOUD
                and abs(found.mass) > lightest * self._reference
                and self._possible(float(self._kept[0][0][0]), found)
                and found.left < self._explained * found.came
                and found.left < TOUCH * found.touched
                and found.left < pressed * found.pressed)


def ramp(lag: float, count: int) -> FloatArray:
    """
    Give how much of a step is seen behind three equal low-passes.

    lag [s]; returns (blocks,).
    """
    if lag <= 0.0:
        return np.ones(count)
    t = (np.arange(count) + 0.5) * (BLOCK / lag)
    return np.asarray(1.0 - np.exp(-t) * (1.0 + t + 0.5 * t ** 2))
