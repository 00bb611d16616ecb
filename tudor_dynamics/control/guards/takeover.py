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

"""Taking over an arm that somebody else has moved: not while its drives brake by themselves."""

from __future__ import annotations

from collections import deque

import numpy as np

from tudor_dynamics.typing import FloatArray

LOOK = 0.1
"""Time for which an arm is looked at first, beside the delay of the loop [s]: drives that hear
nothing brake after as long."""
BRAKES = 0.1
"""Part of the planned acceleration from which on an arm brakes."""


class Takeover:
    """
    Says when an arm of unknown motion can be commanded, and at which speed.

    A command at the speed that was measured is a step up for an arm that has begun to brake
    meanwhile; so one that brakes is left to stop.

    acceleration (joints,) [rad/s^2].
    """

    def __init__(self, acceleration: FloatArray) -> None:
        self._acceleration = acceleration
        self._seen: deque[tuple[float, FloatArray]] = deque()

    def reset(self) -> None:
        """Begin to look."""
        self._seen.clear()

    def step(self, now: float, dq: FloatArray, delay: float) -> bool:
        """Look at a sample: now, delay [s], dq (joints,) [rad/s]."""
        self._seen.append((now, dq))
        while len(self._seen) > 2 and now - self._seen[1][0] >= LOOK + delay:
            self._seen.popleft()
        begin, before = self._seen[0]
        if now - begin < LOOK + delay:
            return False
        slower = np.abs(before) - np.abs(dq)
        return not bool(np.any(slower > BRAKES * self._acceleration * (now - begin)))
