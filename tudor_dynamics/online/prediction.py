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

"""Predictions of a bundle for live motion, and residuals."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass

from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.online.settings import STRAIN_APART, STRAIN_QUEUE
from tudor_dynamics.online.streams import LowPass, Motion, PairedSample
from tudor_dynamics.typing import FloatArray


OUTPUTS = ('effort', 'strain')


class Predictor:
    """Predicts every output of a bundle with one kind of model."""

    def __init__(
        self, bundle: ModelBundle, kind: str = 'analytical', observer: str = 'off',
    ) -> None:
        self.bundle = bundle
        self.kind = kind
        self.settle = bundle.preprocessing.settle
        self.models: dict[str, Model] = {
            output: bundle.models[output][kind] for output in OUTPUTS
            if kind in bundle.models.get(output, {})}
        if not self.models:
            have = sorted({k for kinds in bundle.models.values() for k in kinds})
            msg = f'the bundle has no model of the kind {kind!r}, it has {have}: choose one'
            raise ModelError(msg)
        self._live = type(next(iter(self.models.values()))).live(self.models, observer)
        self.observing = self._live.observing
        self._stamp = 0
        self._strains: deque[tuple[int, FloatArray]] = deque(maxlen=STRAIN_QUEUE)

    def add_strain(self, stamp: int, values: FloatArray) -> None:
        """
        Give a measured strain to the observer; of no effect without one.

        It counts for the motion of the same stamp, whichever of the two comes first, if it comes
        before the next motion. Between two readings their interpolation counts.
        """
        if self.observing:
            if self._strains and stamp <= self._strains[-1][0]:
                self._strains.clear()  # the clock was set back
            self._strains.append((stamp, values))

    def _measured(self, dt: float) -> FloatArray | None:
        """Give the strain at the newest motion, which took a step of ``dt`` [s]; None without."""
        strains = self._strains
        while len(strains) > 1 and strains[1][0] <= self._stamp:
            strains.popleft()
        if not strains or strains[0][0] > self._stamp:
            return None
        before, values = strains[0]
        if before == self._stamp:
            return values
        if len(strains) == 1:
            return None
        after, later = strains[1]
        if (after - before) * 1e-9 > STRAIN_APART * dt:
            return None
        share = (self._stamp - before) / (after - before)
        return (1.0 - share) * values + share * later

    def step(
        self, motion: Motion, wanted: Collection[str] = OUTPUTS,
    ) -> dict[str, FloatArray] | None:
        """Predict one sample; returns (channels,) [its unit], None while the filters settle."""
        if self.observing:
            measured = self._measured(motion.dt)
            if measured is not None:
                self._live.measure(measured)
        self._stamp = motion.stamp
        # a model with a memory follows every sample: what it predicts depends on all that was
        settled = motion.settled(self.settle)
        predicted = self._live.step(motion.dt, motion.row, wanted if settled else ())
        return predicted if settled else None


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Residual:
    """What the model does not explain of one sample."""

    motion: Motion  # motion of the sample
    measured: FloatArray  # reading, after the output filter, (channels,)
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
