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

"""Age of stamps, and what it says about clocks; free of ROS."""

from __future__ import annotations

SHARE = 0.02
"""Weight of a new age in the mean."""
EARLY = 0.005
"""A stamp so far in the future comes from another clock [s]."""
OLD = 0.5
"""A stamp so old as well: no driver keeps its readings for so long [s]."""
ENOUGH = 20
"""Stamps before a fault is told."""


class ClockWatch:
    """Compares stamps with the clock of the node that reads them."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.age: float | None = None
        self._zeros = self._count = 0

    def step(self, stamp: int, now: int) -> None:
        """Take a stamp into account, and the time of the node at which it came [ns]."""
        self._count += 1
        self._zeros = self._zeros + 1 if stamp == 0 else 0
        age = 1e-9 * (now - stamp)
        self.age = age if self.age is None else self.age + SHARE * (age - self.age)

    def text(self) -> str:
        """Give the age of stamps [ms]."""
        return 'unknown' if self.age is None else f'{1e3 * self.age:.1f}'

    def fault(self) -> str:
        """Say what is wrong with stamps that make the arm stand; empty for nothing."""
        if self._zeros >= ENOUGH:
            return ('all stamps of the positions are zero: the driver has to set header.stamp, '
                    'without which no sample time is known')
        return ''

    def offset(self) -> str:
        """Say what is odd about the clocks, though sample times are right; empty for nothing."""
        if self._count < ENOUGH or self.age is None or -EARLY <= self.age <= OLD:
            return ''
        where = 'in the future' if self.age < 0.0 else 'in the past'
        return (f'stamps of the positions are {abs(self.age):.3g} s {where}: the clocks of driver '
                'and this machine differ, or one of the two uses simulated time')
