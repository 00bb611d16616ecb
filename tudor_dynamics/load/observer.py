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

"""The load sample by sample: a Kalman filter, and when the load changed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.load.settings import (
    ANNOUNCED, BEGUN, BENT_EXPLAINED, BLOCK, EXPECTED_GAIN, HEAVIEST, LARGEST_STEP, LASTING,
    LIGHTER, LIGHTEST, LOUD, ODD, PRESSED, RECENT, SEEN, SOONEST, TOUCH, UNSURE, WANDERS, ZERO,
    ZERO_WANDERS)
from tudor_dynamics.typing import FloatArray


# -- When the load changed, and whether it was a load at all.
#
# Over the last part of the past every instant is tried: before it the load was what it had been,
# after it another one. The best of them leaves the smallest residual in least squares (the
# generalised likelihood ratio of Willsky and Jones, IEEE TAC 21(1), 1976). It is a load where that
# explains nearly all of what came, since a mass in the hand has one number for all channels, poses
# and accelerations; a touch elsewhere, or in another direction, has other levers and does not turn
# with the arm. A force that is held downwards at the tip has its levers, but no inertia: links
# ring with a load as they do with its mass, and with that force as they do without.

SCALARS = 7
"""Sums before those by channel: squares of residuals, their products with what a kilogram adds,
squares of that, time; products of its weight with residuals, and with what it adds, squares."""


@dataclass(frozen=True)
class Change:
    """The best instant for a change of the load, and what speaks for it."""

    mass: float  # by how much the load has changed [kg]
    information: float  # of that: one by the variance [1/kg^2]
    # Residual from that instant on with the load of before: squares in units of the noise.
    came: float
    left: float  # the same with the change
    touched: float  # the same with a moment that stays as it is, of any size in each channel
    # The same with a force downwards at the tip, which weighs without having inertia.
    pressed: float
    since: float  # time since then [s]

    @property
    def gain(self) -> float:
        """Give what the change explains, as squares in units of the noise."""
        return self.mass ** 2 * self.information


@compiled
def add_sample(
    left: FloatArray, added: FloatArray, weight: FloatArray, dt: float, sums: FloatArray,
) -> None:
    """Add a sample to the sums of a block."""
    channels = left.shape[0]
    for c in range(channels):
        sums[0] += left[c] * left[c] * dt
        sums[1] += left[c] * added[c] * dt
        sums[2] += added[c] * added[c] * dt
        sums[4] += left[c] * weight[c] * dt
        sums[5] += added[c] * weight[c] * dt
        sums[6] += weight[c] * weight[c] * dt
        sums[SCALARS + c] += left[c] * dt
        sums[SCALARS + channels + c] += added[c] * dt
        sums[SCALARS + 2 * channels + c] += weight[c] * dt
    sums[3] += dt


class RecentPast:
    """Sums of the last samples, by blocks: longest [s]; lag [s] of each of three low-passes."""

    def __init__(self, channels: int, longest: float, lag: float) -> None:
        self._most = round(longest / BLOCK)
        # row: what is seen of a change that begins with that block
        steps = ramp(lag, self._most)
        self._seen = np.array([np.append(np.zeros(first), steps[:self._most - first])
                               for first in range(self._most)])
        self._blocks = np.zeros((self._most + 1, SCALARS + 3 * channels))
        self.clear()

    def clear(self) -> None:
        """Forget the past."""
        self._blocks[:] = 0.0
        self._full = 0

    @property
    def full(self) -> bool:
        """Say whether there is no place for another block."""
        return self._full == self._most

    def add(
        self, dt: float, left: FloatArray, added: FloatArray, weight: FloatArray,
    ) -> bool:
        """Add a sample (channels,) in units of its noise; say whether a block is full with it."""
        newest = self._blocks[self._full]
        add_sample(left, added, weight, dt, newest)
        if newest[3] < BLOCK - 1e-9:
            return False
        if self.full:
            self._blocks[:-1] = self._blocks[1:]
        else:
            self._full += 1
        self._blocks[self._full] = 0.0
        return True

    def changed(self, x: FloatArray, least: float) -> Change | None:
        """Find the best instant for a change of the load: x (1 + channels,) [kg], least [s]."""
        count, blocks = self._full, max(1, round(least / BLOCK))
        if count < blocks:
            return None
        square, cross, extent, time, pressing, both, pressed = self._blocks[:count, :SCALARS].T
        there, added, weight = np.split(self._blocks[:count, SCALARS:], 3, axis=1)
        carried, zeros = x[0], x[1:]
        # residuals with the load of before: squares, and products with what a change would add
        came = square - 2.0 * carried * cross + carried ** 2 * extent + (
            zeros ** 2 * time[:, None] - 2.0 * zeros * (there - carried * added)).sum(axis=1)
        along = cross - carried * extent - added @ zeros
        pressing = pressing - carried * both - weight @ zeros
        moments = there - carried * added - zeros * time[:, None]
        seen = self._seen[:count - blocks + 1, :count]
        products, information = seen @ along, seen ** 2 @ extent
        explained = np.divide(products ** 2, information, where=information > 0.0,
                              out=np.zeros(len(seen)))
        first = int(np.argmax(explained))
        if explained[first] <= 0.0:
            return None
        step, total = seen[first], float(came[first:].sum())
        weighs = float(step ** 2 @ pressed)
        return Change(
            float(products[first] / information[first]), float(information[first]), total,
            total - float(explained[first]),
            total - float(np.sum((step @ moments) ** 2) / (step ** 2 @ time)),
            total - (float(step @ pressing) ** 2 / weighs if weighs > 0.0 else 0.0),
            (count - first) * BLOCK)


def ramp(lag: float, count: int) -> FloatArray:
    """Give how much of a step is seen after three equal low-passes of a lag [s] (blocks,)."""
    if lag <= 0.0:
        return np.ones(count)
    t = (np.arange(count) + 0.5) * (BLOCK / lag)
    return np.asarray(1.0 - np.exp(-t) * (1.0 + t + 0.5 * t ** 2))


# -- The load sample by sample: a Kalman filter with the mass and the zero of each channel.
#
# All channels come in units of their noise, which over a second is white: its density is 1. What
# is old is forgotten as the mass and the zeros may wander. What comes suddenly is another load
# from an instant on, which is looked for in the recent past: at once where it was announced, and
# where it was not, once it is clear that it is no touch.

@compiled
def observe_load(x: FloatArray, p: FloatArray, left: FloatArray, added: FloatArray, dt: float,
                 wander: float, zero: float) -> None:
    """Advance the filter by one sample; channels have noise of the density 1."""
    size, channels = x.shape[0], left.shape[0]
    p[0, 0] += wander * dt
    gain = np.empty(size)
    for c in range(channels):
        p[1 + c, 1 + c] += zero * dt
        for i in range(size):
            gain[i] = p[i, 0] * added[c] + p[i, 1 + c]
        spread = added[c] * gain[0] + gain[1 + c] + 1.0 / dt
        new = left[c] - added[c] * x[0] - x[1 + c]
        for i in range(size):
            x[i] += gain[i] / spread * new
        for i in range(size):
            for j in range(size):
                p[i, j] -= gain[i] * gain[j] / spread


class LoadObserver:
    """The load that an arm carries [kg], and whether what came suddenly is one."""

    def __init__(
        self, channels: int, reference: float, lag: float = 0.0, explained: float = BENT_EXPLAINED,
    ) -> None:
        self._channels, self._reference, self._explained = channels, reference, explained
        self._recent = RecentPast(channels, RECENT, lag)
        self._announced = RecentPast(channels, ANNOUNCED, lag)
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
        """Load in addition to what the model knows [kg]."""
        return float(self._x[0])

    @property
    def std(self) -> float:
        """Its standard deviation [kg]."""
        return math.sqrt(max(float(self._p[0, 0]), 0.0))

    def step(
        self, dt: float, left: FloatArray, added: FloatArray, weight: FloatArray, *, held: bool,
        expected: bool = False,
    ) -> float:
        """Take a sample (channels,) into account, dt 0 at a beginning; returns [kg], else zero."""
        dt = min(dt, LARGEST_STEP)
        if dt <= 0.0:
            self._keep()
            return 0.0
        self._seconds = min(self._seconds + dt, BEGUN)
        if expected != self._announcing or (expected and self._announced.full):
            self._announcing = expected
            self._keep()
        if expected and self._seconds >= BEGUN:
            if self._announced.add(dt, left, added, weight):
                self._follow()
            return 0.0
        self._waited = self._waited + dt if held or self._odd else 0.0
        if self._recent.add(dt, left, added, weight):
            found = self._recent.changed(self._kept[0][0], SEEN)
            if found is not None and self._is_load(found):
                self._take(found, *self._kept[0])
                self._keep()
                return found.mass
            self._odd = found is not None and found.came - found.touched > ODD
            self._kept.append((self._x.copy(), self._p.copy()))
        if self._seconds < BEGUN or not (held or self._odd):
            observe_load(self._x, self._p, left, added, dt, (WANDERS * self._reference) ** 2,
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

    def _is_load(self, found: Change) -> bool:
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
