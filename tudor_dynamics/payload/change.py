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
When the load changed, and whether it was a load at all.

Over the last part of the past every instant is tried: before it the load was what it had been,
behind it another one. The best of them is what least squares leave the least over with (the
generalised likelihood ratio of Willsky and Jones, IEEE TAC 21(1), 1976). It is a load where that
explains nearly all of what came, since a mass in the hand has one number for all channels, poses
and accelerations; a touch elsewhere, or in another direction, has other levers and does not turn
with the arm. A force that is held downwards at the tip has its levers, but no inertia: links ring
with a load as they do with its mass, and with that force as they do without.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

BLOCK = 0.05
"""Time over which samples are summed up [s]."""
SCALARS = 7
"""Sums before those by channel: squares of what is left, its products with what a kilogram adds,
squares of that, time; products of its weight with what is left, and with what it adds, squares."""


@dataclass(frozen=True)
class Change:
    """The best instant for a change of the load, and what speaks for it."""

    mass: float  # by how much the load has changed [kg]
    information: float  # of that: one by the variance [1/kg^2]
    # What was left over from that instant on with the load of before: squares in units of the
    # noise.
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
    left: FloatArray, worth: FloatArray, weight: FloatArray, dt: float, sums: FloatArray,
) -> None:
    """Add a sample to the sums of a block."""
    channels = left.shape[0]
    for c in range(channels):
        sums[0] += left[c] * left[c] * dt
        sums[1] += left[c] * worth[c] * dt
        sums[2] += worth[c] * worth[c] * dt
        sums[4] += left[c] * weight[c] * dt
        sums[5] += worth[c] * weight[c] * dt
        sums[6] += weight[c] * weight[c] * dt
        sums[SCALARS + c] += left[c] * dt
        sums[SCALARS + channels + c] += worth[c] * dt
        sums[SCALARS + 2 * channels + c] += weight[c] * dt
    sums[3] += dt


@compiled
def best_change(
    blocks: FloatArray, x: FloatArray, ramp: FloatArray, least: int, out: FloatArray,
) -> None:
    """
    Try each block as the first of another load.

    ``x`` are load and zeros of before; ``ramp`` is how much of a change is seen so many blocks
    behind it. ``out`` takes mass, information, what came, what is left, what a touch leaves, what
    a force at the tip leaves, and the number of blocks; nothing where all information is zero.
    """
    count = blocks.shape[0]
    channels = x.shape[0] - 1
    own = np.empty((count, 4 + channels))
    for i in range(count):
        block = blocks[i]
        square, cross, extent = block[0], block[1], block[2]
        own[i, 0] = square - 2.0 * x[0] * cross + x[0] * x[0] * extent
        own[i, 1] = cross - x[0] * extent
        own[i, 2] = extent
        own[i, 3] = block[4] - x[0] * block[5]
        for c in range(channels):
            zero = x[1 + c]
            there, worth = block[SCALARS + c], block[SCALARS + channels + c]
            own[i, 0] += zero * (zero * block[3] - 2.0 * there + 2.0 * x[0] * worth)
            own[i, 1] -= zero * worth
            own[i, 3] -= zero * block[SCALARS + 2 * channels + c]
            own[i, 4 + c] = there - x[0] * worth - zero * block[3]
    most = 0.0
    for first in range(count - least + 1):
        along = extent = 0.0
        for i in range(first, count):
            seen = ramp[i - first]
            along += seen * own[i, 1]
            extent += seen * seen * own[i, 2]
        if extent <= 0.0 or along * along <= most * extent:
            continue
        most = along * along / extent
        out[0], out[1], out[6] = along / extent, extent, count - first
    if most <= 0.0:
        return
    first = count - int(out[6])
    moments = np.zeros(channels)
    extent = pressing = pressed = 0.0
    for i in range(first, count):
        seen = ramp[i - first]
        out[2] += own[i, 0]
        extent += seen * seen * blocks[i, 3]
        pressing += seen * own[i, 3]
        pressed += seen * seen * blocks[i, 6]
        for c in range(channels):
            moments[c] += seen * own[i, 4 + c]
    out[3] = out[2] - most
    out[4] = out[5] = out[2]
    if pressed > 0.0:
        out[5] -= pressing * pressing / pressed
    for c in range(channels):
        out[4] -= moments[c] * moments[c] / extent


class RecentPast:
    """Sums of the last samples, by blocks: longest [s], ramp (blocks,)."""

    def __init__(self, channels: int, longest: float, ramp: FloatArray) -> None:
        self._most = round(longest / BLOCK)
        self._ramp = ramp
        self._blocks = np.zeros((self._most + 1, SCALARS + 3 * channels))
        self._out = np.zeros(7)
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
        self, dt: float, left: FloatArray, worth: FloatArray, weight: FloatArray,
    ) -> bool:
        """
        Add a sample, in units of its noise; say whether a block is full with it.

        dt [s], left, worth, weight (channels,).
        """
        newest = self._blocks[self._full]
        add_sample(left, worth, weight, dt, newest)
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
        blocks = max(1, round(least / BLOCK))
        if self._full < blocks:
            return None
        out = self._out
        out[:] = 0.0
        best_change(self._blocks[:self._full], x, self._ramp, blocks, out)
        mass, information, came, left, touched, pressed, count = out.tolist()
        if not count:
            return None
        return Change(mass, information, came, left, touched, pressed, count * BLOCK)
