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

"""Residuals: measured minus predicted, both behind the same filters."""

from __future__ import annotations

from dataclasses import dataclass

from tudor_dynamics.monitoring.pairing import PairedSample
from tudor_dynamics.monitoring.state_filter import LowPass, Motion
from tudor_dynamics.typing import FloatArray


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Residual:
    """What the model does not explain of one sample."""

    motion: Motion  # motion of the sample
    measured: FloatArray  # reading, behind the output filter, (channels,)
    predicted: FloatArray  # prediction for the sample, (channels,)
    value: FloatArray  # their difference, in the unit of the output, (channels,)


class ResidualStage:
    """Makes residuals of pairs: cutoff [Hz], settle [s]."""

    def __init__(self, cutoff: float | None, settle: float) -> None:
        self.settle = settle
        self._filter = LowPass(cutoff)
        self._last = 0

    def step(self, pair: PairedSample) -> Residual | None:
        """Take the difference; returns None while the filters settle."""
        stamp = pair.motion.stamp
        # since the pair before, which is not the sample before where messages were lost
        dt = 0.0 if pair.motion.dt == 0.0 else (stamp - self._last) * 1e-9
        self._last = stamp
        measured = self._filter.step(dt, pair.measured)
        if pair.predicted is None or not pair.motion.settled(self.settle):
            return None
        return Residual(pair.motion, measured, pair.predicted, measured - pair.predicted)
