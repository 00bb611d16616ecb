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

"""Brings what is measured onto the stamps of the motion, as the readers of bags do."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from tudor_dynamics.monitoring.stamps import StampGate
from tudor_dynamics.monitoring.state_filter import Motion
from tudor_dynamics.small_arrays import all_finite
from tudor_dynamics.typing import FloatArray

WAITING = 400
"""Samples that may wait for their partner; more are dropped, oldest first."""


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class PairedSample:
    """A motion with its prediction and the measurement at the same time."""

    motion: Motion
    # (channels,): what the model expects; None while the filters settle.
    predicted: FloatArray | None
    # (channels,): what the sensors say, interpolated between their neighbours where stamps differ.
    measured: FloatArray


class Pairing:
    """
    Waits for the measurements that belong to motions.

    Equal stamps go together as they are. A motion between two measurements gets their
    interpolation once the second one is there; one without neighbours is dropped and counted.
    """

    def __init__(self) -> None:
        self.gate = StampGate()
        self.drops: Counter[str] = self.gate.drops
        self._motions: deque[tuple[Motion, FloatArray | None]] = deque()
        self._measured: deque[tuple[int, FloatArray]] = deque()

    @property
    def waiting(self) -> int:
        """Give the number of motions that wait for a measurement."""
        return len(self._motions)

    def reset(self) -> None:
        """Forget all that waits."""
        self.gate.reset()
        self._motions.clear()
        self._measured.clear()

    def add_motion(self, motion: Motion, predicted: FloatArray | None) -> list[PairedSample]:
        """Add a motion, later than those before it: predicted (channels,)."""
        if self._motions and motion.stamp <= self._motions[-1][0].stamp:
            self.drops['no_measurement'] += len(self._motions)
            self._motions.clear()  # the clock was set back
            self._measured.clear()
            self.drops['clock_set_back'] += 1
        if len(self._motions) >= WAITING:
            self._motions.popleft()
            self.drops['no_measurement'] += 1
        self._motions.append((motion, predicted))
        return self._complete()

    def add_measured(self, stamp: int, values: FloatArray) -> list[PairedSample]:
        """Add a measurement: stamp [ns], values (channels,) [its unit]."""
        if not all_finite(values):
            self.drops['not_finite'] += 1
            self.gate.unusable()
            return []
        tick = self.gate.step(stamp)
        if tick is None:
            return []
        if tick.first:
            while self._measured and self._measured[-1][0] > stamp:  # the clock was set back
                self._measured.pop()
        if len(self._measured) >= WAITING:
            self._measured.popleft()
        self._measured.append((stamp, values))
        return self._complete()

    def _complete(self) -> list[PairedSample]:
        pairs: list[PairedSample] = []
        motions, measured = self._motions, self._measured
        while motions and measured:
            motion, predicted = motions[0]
            while len(measured) > 1 and measured[1][0] <= motion.stamp:
                measured.popleft()
            stamp, values = measured[0]
            if stamp == motion.stamp:
                pairs.append(PairedSample(motion, predicted, values))
            elif stamp > motion.stamp:
                self.drops['no_neighbour'] += 1
            elif len(measured) == 1:
                break
            else:
                after, later = measured[1]
                if (after - stamp) * 1e-9 > self.gate.limit():
                    self.drops['no_neighbour'] += 1
                else:
                    weight = (motion.stamp - stamp) / (after - stamp)
                    pairs.append(PairedSample(motion, predicted,
                                              (1 - weight) * values + weight * later))
            motions.popleft()
        return pairs
