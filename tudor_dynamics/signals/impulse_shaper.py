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
Input shapers: a motion as the sum of itself and of itself somewhat later.

A swing that the first part leaves is met by that of the next ones. The sum is a mean with positive
weights: position, speed and acceleration stay within what the motion itself keeps to. ZV and ZVD:
Singer and Seering, "Preshaping command inputs to reduce system vibration", ASME Journal of Dynamic
Systems, Measurement, and Control 112(1), 1990; ZV goes back to O. J. M. Smith's posicast, 1957.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.errors import SignalError
from tudor_dynamics.typing import FloatArray

KINDS = ('zv', 'zvd')


@dataclass(frozen=True, eq=False)
class Impulses:
    """Impulses of a shaper."""

    time: FloatArray  # how late each is, ascending from 0, (n,) [s]
    weight: FloatArray  # positive, 1 in sum, (n,)


def impulses(kind: str, frequency: float, damping: float) -> Impulses:
    """Give the impulses after which a mode does not swing: frequency [Hz]."""
    if kind not in KINDS or not (math.isfinite(frequency) and frequency > 0.0
                                 and 0.0 <= damping < 1.0):
        msg = (f'shaper {kind!r} for {frequency} Hz with a damping ratio of {damping}: expected '
               f'one of {", ".join(KINDS)}, a frequency above 0 and a ratio of 0 to 1')
        raise SignalError(msg)
    root = math.sqrt(1.0 - damping**2)
    k = math.exp(-damping * math.pi / root)
    half = 0.5 / (frequency * root)
    weight = np.array([1.0, k] if kind == 'zv' else [1.0, 2.0 * k, k**2])
    return Impulses(half * np.arange(len(weight), dtype=float),
                    np.asarray(weight / weight.sum(), dtype=float))


class ImpulseShaper:
    """Shapes a motion sample by sample: q (joints,) [rad]."""

    def __init__(self, shaper: Impulses, q: FloatArray) -> None:
        self.shaper = shaper
        self._t = 0.0
        self._past: deque[tuple[float, FloatArray]] = deque(
            [(0.0, np.stack([q, np.zeros_like(q), np.zeros_like(q)]))])

    @property
    def length(self) -> float:
        """How much longer a motion gets [s]."""
        return float(self.shaper.time[-1])

    def step(self, dt: float, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
        """
        Shape one sample.

        dt [s], q, dq, ddq (joints,) [rad, rad/s, rad/s^2]; returns (3, joints).
        """
        self._t += dt
        self._past.append((self._t, np.stack([q, dq, ddq])))
        while len(self._past) > 2 and self._past[1][0] <= self._t - self.length:
            self._past.popleft()
        shaped = np.zeros((3, len(q)))
        for late, weight in zip(self.shaper.time, self.shaper.weight, strict=True):
            shaped += weight * self._at(self._t - float(late))
        return shaped

    def _at(self, t: float) -> FloatArray:
        after = self._past[-1]
        for before in reversed(self._past):
            if before[0] <= t:
                span = after[0] - before[0]
                share = min((t - before[0]) / span, 1.0) if span > 0.0 else 0.0
                return before[1] + share * (after[1] - before[1])
            after = before
        return self._past[0][1]
