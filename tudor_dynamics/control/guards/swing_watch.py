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

"""A damper that excites instead of damping: seen by a swing that does not decay."""

from __future__ import annotations

from collections import deque

import numpy as np

from tudor_dynamics.typing import FloatArray

WINDOW = 0.4
"""Time over which the size of a swing is taken: most of a period at 2 Hz [s]."""
SETTLING = 0.6
"""After the reference has come to rest [s]."""
LOUD = 0.04
"""Part of the speed limit below which a swing is of no concern: 4.5 deg/s at 120 deg/s."""
LASTING = 4
"""Windows in a row without decay."""
DECAY = 0.85
"""A swing decays if it is smaller than this part of itself two windows before."""
GROWTH = 1.3
"""A swing that is so much larger than a window before, twice in a row, grows."""
WILD = 0.5
"""Part of the speed limit that nothing but a swing adds to a reference for long."""
SHARE = 0.3
"""Part of a window in which commands are cut, or wild, that no damping needs."""
WINDOWS = 2
"""Such windows in a row."""


class SwingWatch:
    """
    Judges what the position loop and the damper add to the reference.

    While the reference rests, what they add must decay: a swing that goes on at the same size, or
    grows, is fed by them. Whether it rests or not, commands beyond the speed limit again and
    again, or far from the reference, are no damping either.

    speed (joints,) [rad/s].
    """

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)
        self._peaks: deque[float] = deque(maxlen=LASTING + 2)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._peaks.clear()
        self._rest = self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = 0

    def step(self, dt: float, added: FloatArray, moving: bool, cut: bool) -> str:
        """
        Judge one command.

        dt [s], added (joints,) [rad/s]; returns an empty string for nothing.
        """
        self._rest = 0.0 if moving else self._rest + dt
        self._elapsed += dt
        size = float(np.max(np.abs(added) / self._scale, initial=0.0))
        self._wild += dt if cut or size > WILD else 0.0
        self._peak = max(self._peak, size)
        if self._elapsed < WINDOW:
            return ''
        share, peak = self._wild / self._elapsed, self._peak
        self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = self._wild_windows + 1 if share > SHARE else 0
        if self._rest < SETTLING:
            self._peaks.clear()
        else:
            self._peaks.append(peak)
        if self._wild_windows >= WINDOWS:
            self.reset()
            return 'its commands are at the limits, or far from the reference, again and again'
        peaks = list(self._peaks)
        grown = [now > GROWTH * before for before, now in zip(peaks, peaks[1:], strict=False)]
        if len(grown) > 1 and min(peaks[-2:]) > LOUD and all(grown[-2:]):
            self.reset()
            return 'the swing grows while the reference rests'
        if len(peaks) == LASTING + 2 and all(
                now > LOUD and now > DECAY * before
                for before, now in zip(peaks[:-2], peaks[2:], strict=True)):
            self.reset()
            return 'the swing does not decay while the reference rests'
        return ''
