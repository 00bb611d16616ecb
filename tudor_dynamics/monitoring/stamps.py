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

"""Stamps of a live stream: order, gaps and jumps, judged as they arrive."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from statistics import median

from tudor_dynamics.bags.alignment import GAP_FLOOR, GAP_PERIODS

JUMP = 1.0
"""A stamp that is older by more than this is a clock that was set back, not a late message [s]."""
LEARNING = 5
"""Intervals needed before a period can be told."""


@dataclass(slots=True)  # frozen would be three times as slow to make, twice a sample
class Tick:
    """
    An accepted stamp.

    Attributes
    ----------
    dt : float
        Time since the sample before; 0 for a first one [s].
    first : bool
        Whether nothing before it counts: at the start, behind a gap, after a jump of the clock.

    """

    dt: float
    first: bool


class StampGate:
    """
    Lets increasing stamps pass and counts the others; a gap is what it is in recordings.

    Parameters
    ----------
    gap : float, default=0.0
        Longest time between samples that is not a gap [s]; 0 for five periods, at least 20 ms.

    Attributes
    ----------
    drops : collections.Counter
        Messages left out, and restarts, by cause.

    """

    def __init__(self, gap: float = 0.0) -> None:
        self.gap = gap
        self.drops: Counter[str] = Counter()
        self._recent: deque[int] = deque(maxlen=31)
        self.last: int | None = None

    def reset(self) -> None:
        """Take the next stamp for a first one."""
        self.last = None
        self._recent.clear()

    def limit(self) -> float:
        """Give the longest time between samples that is not a gap now [s]."""
        if self.gap > 0:
            return self.gap
        if len(self._recent) < LEARNING:
            return JUMP
        return max(GAP_PERIODS * median(self._recent) * 1e-9, GAP_FLOOR)

    def step(self, stamp: int) -> Tick | None:
        """
        Judge the next stamp.

        Parameters
        ----------
        stamp : int
            Header stamp [ns].

        Returns
        -------
        Tick or None
            None for a stamp that is repeated or older than the newest.

        """
        if self.last is None:
            self.last = stamp
            return Tick(0.0, True)
        step = stamp - self.last
        if step <= 0:
            if -step * 1e-9 <= JUMP:
                self.drops['duplicate_stamp' if step == 0 else 'backward_stamp'] += 1
                return None
            self.drops['clock_set_back'] += 1
            self.reset()
            self.last = stamp
            return Tick(0.0, True)
        dt = step * 1e-9
        self.last = stamp
        if dt > GAP_FLOOR and dt > self.limit():
            self.drops['gap'] += 1
            self._recent.append(step)  # a source that has slowed down is not one gap after another
            return Tick(0.0, True)
        self._recent.append(step)
        return Tick(dt, False)
