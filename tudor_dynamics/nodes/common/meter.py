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

"""What diagnostics tell: rate, latency, drops and the age of the input; free of ROS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
import time

import numpy as np

MEMORY = 4096
"""Latencies of which percentiles are taken."""


class Meter:
    """
    Counts messages and takes their time; `report` gives the figures since the last one.

    steady: clock of ages and rates, which never stops nor is set [s].
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self.count = 0
        self.last_arrival: float | None = None
        self._latencies = np.zeros(MEMORY)
        self._reported = 0
        self._since = steady()

    def begin(self) -> float:
        """Take the time at which a message arrives, and give what `end` needs."""
        self.last_arrival = self._steady()
        return time.perf_counter()

    def end(self, begun: float) -> None:
        """Take the time at which its results are published."""
        self._latencies[self.count % MEMORY] = time.perf_counter() - begun
        self.count += 1

    def stale(self, timeout: float) -> bool:
        """Say whether nothing has come for a while, or ever [s]."""
        return (self.last_arrival is None
                or self._steady() - self.last_arrival > timeout)

    def report(self, drops: Iterable[Counter[str]] = ()) -> dict[str, str]:
        """Give rate, latency and drops as texts."""
        now = self._steady()
        seconds = max(now - self._since, 1e-9)
        values = {'rate [Hz]': f'{(self.count - self._reported) / seconds:.1f}',
                  'messages': str(self.count)}
        self._reported, self._since = self.count, now
        known = min(self.count, MEMORY)
        if known:
            places = [min(known - 1, int(share * known)) for share in (0.5, 0.99)]
            # sorting all of them would take half a millisecond, in which samples wait
            ordered = np.partition(self._latencies[:known], places)
            for name, place in zip(('p50', 'p99'), places, strict=True):
                values[f'latency {name} [ms]'] = f'{1e3 * ordered[place]:.3f}'
        total: Counter[str] = Counter()
        for item in drops:
            total.update(item)
        values['dropped'] = str(sum(total.values()))
        values.update({f'dropped: {cause}': str(n) for cause, n in sorted(total.items()) if n})
        return values
