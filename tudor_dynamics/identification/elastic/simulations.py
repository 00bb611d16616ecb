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

"""Simulations of an elastic arm along recordings, for several choices of parameters at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.identification.elastic.record import Record
from tudor_dynamics.lanes import LANES
from tudor_dynamics.models.elastic.arm import NO_GAINS
from tudor_dynamics.models.elastic.corrected import CorrectedArm
from tudor_dynamics.models.elastic.several import follow_together
from tudor_dynamics.parallel import in_threads
from tudor_dynamics.typing import FloatArray


class Simulations:
    """Arms that follow recordings, in threads and side by side: inner [s]."""

    def __init__(
        self, arm: Arm, records: Sequence[Record], names: tuple[str, ...],
        fixed: dict[str, float], inner: float,
    ) -> None:
        self.inner, self.runs = inner, 0
        self._arm, self._records, self._names, self._fixed = arm, records, names, fixed
        self._threads = max(1, min(8, len(os.sched_getaffinity(0))))
        self._idle: list[list[CorrectedArm]] = []
        self._towards: list[tuple[FloatArray, FloatArray]] | None = None

    def several(self, vectors: Sequence[FloatArray]) -> list[FloatArray | None]:
        """
        Simulate the moments that bend the gauges, as many at once as there are lanes.

        vectors (unknowns,); returns (samples, gauges) [N m], None where they cannot be simulated.
        """
        self.runs += len(vectors)
        together = in_threads(self._together, [
            vectors[first:first + LANES] for first in range(0, len(vectors), LANES)],
            self._threads)
        return [one for some in together for one in some]

    def draw(
        self, x: FloatArray, strain: FloatArray, gauges: FloatArray, deviation: FloatArray,
        bandwidth: float,
    ) -> bool:
        """
        Draw what is simulated from now on towards the measured strain.

        x (unknowns,), strain (samples, gauges), deviation (gauges,) [N m], bandwidth [1/s]; gauges
        (gauges, 2): gain [unit of the gauge per N m] and offset [unit of the gauge].
        """
        self.release()
        found, begin = [], 0
        with self._borrowed(1) as (driven,):
            for record in self._records:
                driven.set_parameters(record.with_payload(self._values(x)))
                end = begin + len(record.q) - record.skip
                shown = np.vstack([record.strain[:record.skip], strain[begin:end]])
                begin, measured = end, (shown - gauges[:, 1]) / gauges[:, 0]
                try:
                    found.append((measured, driven.gains_along(
                        record.q, record.times, measured, deviation, bandwidth, record.before)))
                except SimulationError:
                    return False
        self._towards = found
        return True

    def release(self) -> None:
        """Let arms follow positions alone."""
        self._towards = None

    @contextmanager
    def _borrowed(self, count: int) -> Iterator[list[CorrectedArm]]:
        """Lend arms that nobody else has; what there is not yet is built."""
        try:
            arms = self._idle.pop()
        except IndexError:
            arms = []
        arms += [CorrectedArm(self._arm) for _ in range(count - len(arms))]
        for arm in arms:
            arm.inner = self.inner
        try:
            yield arms[:count]
        finally:
            self._idle.append(arms)

    def _together(self, vectors: Sequence[FloatArray]) -> list[FloatArray | None]:
        with self._borrowed(len(vectors)) as arms:
            parts = [self._follow(k, arms, vectors) for k in range(len(self._records))]
        return [None if any(one is None for one in part)
                else np.vstack([one for one in part if one is not None])
                for part in zip(*parts, strict=True)]

    def _follow(
        self, k: int, arms: Sequence[CorrectedArm], vectors: Sequence[FloatArray],
    ) -> list[FloatArray | None]:
        """Simulate one record, with an arm for each vector."""
        record, n = self._records[k], len(self._names)
        moments: list[FloatArray | None] = [None] * len(arms)
        ready = []
        for i, x in enumerate(vectors):
            try:
                arms[i].set_parameters(record.with_payload(self._values(x)))
                arms[i].begin(record.before)
            except SimulationError:
                continue
            ready.append(i)
        if not ready:
            return moments
        measured, gains = None, NO_GAINS
        if self._towards is not None:
            shown, gains = self._towards[k]
            measured = [shown / np.exp(vectors[i][n:]) for i in ready]
        found = follow_together(
            [arms[i] for i in ready], record.q, record.times, measured, gains)
        for i, moment in zip(ready, found, strict=True):
            moments[i] = None if moment is None else moment[record.skip:]
        return moments

    def _values(self, x: FloatArray) -> dict[str, float]:
        return {**self._fixed, **dict(zip(self._names, np.exp(x).tolist(), strict=False))}
