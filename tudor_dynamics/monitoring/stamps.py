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
RENEWAL = 16
"""Intervals between two looks at the period, which would take a microsecond each."""
LONG = 1.6
"""Steps that are longer may hide a sample that was lost [periods]."""
EARLY = 0.9
"""Steps that are shorter make up for a sample that was late before them [periods]."""


class Losses:
    """
    Counts samples that never came, by the period that it learns.

    A sample that is only late is followed by steps that are shorter for it, and is not counted.
    """

    def __init__(self) -> None:
        self.recent: deque[int] = deque(maxlen=31)
        self._period = 0.0
        self._long = -1.0
        self._renewal = LEARNING
        self._late = 0.0

    @property
    def learned(self) -> bool:
        """Whether the period is known."""
        return self._period > 0.0

    def reset(self) -> int:
        """Forget the period, and give the samples lost that were still in doubt."""
        late = max(0, round(self._late))
        self.recent.clear()
        self._period, self._long, self._renewal, self._late = 0.0, -1.0, LEARNING, 0.0
        return late

    def unusable(self) -> None:
        """Take a sample into account that came, but whose stamp is not stepped to."""
        self._late -= 1.0

    def step(self, step: int) -> int:
        """Take the time between two samples: step [ns]."""
        self.recent.append(step)
        self._renewal -= 1
        if not self._renewal:
            self._renewal = RENEWAL
            self._period = float(median(self.recent))
            if self._period > self._long > 0.0:
                self._late = 0.0  # the source has slowed down, which is no loss
            self._long = LONG * self._period
        if 0.0 < step <= self._long and not self._late:
            return 0  # nearly always
        return self._settle(step / self._period) if self._period else 0

    def _settle(self, step: float) -> int:
        """Add what a long step [periods] lacks, take off what early ones give back."""
        if step > LONG:
            self._late += step - 1.0
            return 0
        late = max(0.0, self._late - max(0.0, 1.0 - step))
        self._late = late if step < EARLY else 0.0
        return 0 if step < EARLY else round(late)


@dataclass(slots=True)  # frozen would be three times as slow to make, twice a sample
class Tick:
    """An accepted stamp."""

    dt: float  # time since the sample before; 0 for a first one [s]
    # Whether nothing before it counts: at the start, behind a gap, after a jump of the clock.
    first: bool


class StampGate:
    """
    Lets increasing stamps pass and counts the others; a gap is what it is in recordings.

    gap [s]: 0 for five periods, at least 20 ms.
    """

    def __init__(self, gap: float = 0.0) -> None:
        self.gap = gap
        self.drops: Counter[str] = Counter()
        self._losses = Losses()
        self.last: int | None = None

    def reset(self) -> None:
        """Take the next stamp for a first one."""
        self.last = None
        lost = self._losses.reset()
        if lost:
            self.drops['gap'] += lost

    def unusable(self) -> None:
        """Take a sample into account that came and is left out for its values: it is not lost."""
        self._losses.unusable()

    def limit(self) -> float:
        """Give the longest time between samples that is not a gap now [s]."""
        if self.gap > 0:
            return self.gap
        recent = self._losses.recent
        if len(recent) < LEARNING:
            return JUMP
        return max(GAP_PERIODS * median(recent) * 1e-9, GAP_FLOOR)

    def step(self, stamp: int) -> Tick | None:
        """
        Judge the next stamp.

        stamp [ns]; returns None for a stamp that is repeated or older than the newest.
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
        first = dt > GAP_FLOOR and dt > self.limit()
        # also behind a gap: a source that has slowed down is not one gap after another
        lost = self._losses.step(step)
        if first and not self._losses.learned:
            lost = 1  # nobody can tell how many
        if lost:
            self.drops['gap'] += lost
        return Tick(0.0, True) if first else Tick(dt, False)
