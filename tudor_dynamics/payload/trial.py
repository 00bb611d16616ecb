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
Is it a load or a touch? A mass in the hand moves with the arm's pose; a contact does not.

Over the last part of a second the load is sought that explains best what is left over. It is one
where it explains most of it, where each channel tells the same mass (a touch elsewhere, or in
another direction, has other levers), where both halves of the time do (a touch comes and goes, and
does not turn with the arm), and where the mass is possible.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

BLOCK = 0.1
"""Time over which samples are summed up [s]."""
LENGTHS = (6, 8)
"""Blocks of which a load has to be clear; each number is even, for two halves."""
EXPLAINED = 0.5
"""Share of the residual, each channel by its noise, that a load has to explain."""
AGREE = 0.4
"""Part of the mass by which channels may differ."""
HALVES = 0.5
"""Part of the mass by which the halves may differ."""
TELLING = 0.02
"""Share of all information below which a channel has no say."""
LIGHTEST, HEAVIEST = 0.12, 1.5
"""Loads that are told from touches, in payloads of the model."""
LOUD = 1.0
"""Size of what a load leaves over, in noise of the channels, below which it is not told."""


@compiled
def add_sample(left: FloatArray, worth: FloatArray, weight: FloatArray, sums: FloatArray) -> None:
    """Add a sample to the sums of a block."""
    for c in range(left.shape[0]):
        sums[c, 0] += weight[c] * left[c] * left[c]
        sums[c, 1] += weight[c] * left[c] * worth[c]
        sums[c, 2] += weight[c] * worth[c] * worth[c]
    sums[0, 3] += 1.0


@compiled
def explained_load(
    blocks: FloatArray, newest: int, length: int, reference: float, carried: float,
) -> float:
    """Give the mass that explains the last blocks; zero where none does."""
    channels = blocks.shape[1]
    sums = np.zeros((2, channels, 4))
    for i in range(length):
        block = blocks[(newest - i) % blocks.shape[0]]
        for c in range(channels):
            for k in range(4):
                sums[0 if i < length // 2 else 1, c, k] += block[c, k]
    square = both = size = 0.0
    parts = np.zeros(2)
    for half in range(2):
        own = extent = 0.0
        for c in range(channels):
            square += sums[half, c, 0]
            own += sums[half, c, 1]
            extent += sums[half, c, 2]
        if extent <= 0.0:
            return 0.0
        parts[half] = own / extent
        both += own
        size += extent
    mass = both / size
    count = sums[0, 0, 3] + sums[1, 0, 3]
    heavy = abs(mass)
    if not (LIGHTEST * reference < heavy < HEAVIEST * reference
            and carried + mass > -LIGHTEST * reference
            and both * both > EXPLAINED * size * square
            and square > LOUD * LOUD * count * channels
            and abs(parts[1] - parts[0]) < HALVES * heavy):
        return 0.0
    for c in range(channels):
        extent = sums[0, c, 2] + sums[1, c, 2]
        if extent > TELLING * size and (
                abs((sums[0, c, 1] + sums[1, c, 1]) / extent - mass) > AGREE * heavy):
            return 0.0
    return mass


class LoadTrial:
    """
    What has come within the last part of a second, as a load.

    Parameters
    ----------
    noise : ndarray of shape (n_channels,)
        What the model leaves over in free motion, in units of the output.
    reference : float
        Payloads of the model, or what weighs like the arm itself [kg].

    """

    def __init__(self, noise: FloatArray, reference: float) -> None:
        self._weight = 1.0 / noise ** 2
        self._reference = reference
        self._blocks = np.zeros((max(LENGTHS), len(noise), 4))
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._blocks[:] = 0.0
        self._newest = self._full = 0
        self._begun: int | None = None

    def step(
        self, stamp: int, left: FloatArray, worth: FloatArray, carried: float,
    ) -> float:
        """
        Take a sample into account.

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns].
        left : ndarray of shape (n_channels,)
            What is left over with the load from before.
        worth : ndarray of shape (n_channels,)
            What a kilogram adds.
        carried : float
            Load from before [kg].

        Returns
        -------
        float
            Change of the load, where it has just become clear; zero otherwise [kg].

        """
        found = 0.0
        if self._begun is None or not 0 <= stamp - self._begun < 1e9:
            self.reset()
            self._begun = stamp
        elif (stamp - self._begun) * 1e-9 >= BLOCK - 1e-9:
            self._begun = stamp
            self._full += 1
            for length in LENGTHS:
                if self._full >= length and not found:
                    found = explained_load(self._blocks, self._newest, length, self._reference,
                                           carried)
            self._newest = (self._newest + 1) % len(self._blocks)
            self._blocks[self._newest] = 0.0
        add_sample(left, worth, self._weight, self._blocks[self._newest])
        if found:
            self.reset()
        return found
