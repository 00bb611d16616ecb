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

"""References that may be followed: newest one, its age, and why others are refused."""

from __future__ import annotations

from collections import Counter
import math

import numpy as np

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.typing import FloatArray


class ReferenceGate:
    """
    Lets references pass that keep to the limits, and says what is wrong with others.

    q, dq (joints,) [rad, rad/s]; refusal: empty if it was taken.
    """

    def __init__(self, joints: tuple[str, ...], limits: Limits) -> None:
        self._joints, self._limits = joints, limits
        self.refused: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Forget the newest reference."""
        self.q, self.dq = np.zeros(len(self._joints)), np.zeros(len(self._joints))
        self._at: float | None = None
        self.refusal = ''

    @property
    def known(self) -> bool:
        """Whether any reference was taken."""
        return self._at is not None

    def age(self, now: float) -> float:
        """Give the age of the newest reference; infinite without one [s]."""
        return math.inf if self._at is None else now - self._at

    def place(self, now: float, longest: float) -> FloatArray:
        """
        Give where the newest reference is by now, carried on for a time at most [rad; s].

        now, longest [s].
        """
        return np.asarray(self.q + min(self.age(now), longest) * self.dq)

    def add(self, now: float, q: FloatArray, dq: FloatArray) -> None:
        """Take a reference, if it can be one: now [s], q, dq (joints,) [rad, rad/s]."""
        self.refusal = self._impossible(q, dq)
        if self.refusal:
            self.refused[self.refusal.partition(':')[0]] += 1
        else:
            self._at, self.q, self.dq = now, q.copy(), dq.copy()

    def _impossible(self, q: FloatArray, dq: FloatArray) -> str:
        if not (np.isfinite(q).all() and np.isfinite(dq).all()):
            return 'reference not finite: its values are no numbers'
        limits = self._limits
        for j in np.flatnonzero(limits.outside(q)):
            degrees = '' if abs(q[j]) < 2.0 * math.pi else '; are these degrees?'
            return (f'reference outside limits: {self._joints[j]} {q[j]:.4g} is not within '
                    f'{limits.lower[j]:.4g} .. {limits.upper[j]:.4g}{degrees}')
        for j in np.flatnonzero(np.abs(dq) > limits.velocity):
            return (f'reference too fast: {self._joints[j]} {dq[j]:.4g} is beyond the speed limit '
                    f'{limits.velocity[j]:.4g}')
        return ''
