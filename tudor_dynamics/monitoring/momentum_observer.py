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

"""
Momentum observer: the external effort without any acceleration.

See Haddadin, De Luca and Albu-Schaeffer, IEEE T-RO 33(6), 2017, Section IV. With the generalised
momentum p = M(q) dq the observer integrates what the model expects of dp/dt and takes the
difference for the external effort, behind a first-order lag of 1/gain.

Nothing but predictions of the fitted effort model is needed: rows of M(q) dq come from the model
at zero velocity with dq in place of the acceleration, dM/dt dq from a central difference along dq.
Each row may carry a scale of its own, so the observer also works on currents of unknown torque
constant: its result is then in amperes, joint by joint.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.models.base import Model
from tudor_dynamics.monitoring.pairing import PairedSample
from tudor_dynamics.monitoring.payload_stage import CarriedLoad
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.typing import FloatArray

STEP = 1e-5
"""Change of position for the central difference [rad or m]."""
LAGS = 5.0
"""Lags of the observer until its beginning is forgotten."""


class MomentumObserver:
    """Observer of external efforts: gain [1/s], settle [s]."""

    def __init__(self, model: Model, gain: float = 30.0, settle: float = 0.5) -> None:
        self.model = model
        self.gain = gain
        self.settle = max(settle, LAGS / gain)
        self._observed: FloatArray | None = None
        self._last = 0
        self._carried = 0.0
        self._trail = model.trail()

    def step(self, pair: PairedSample, load: CarriedLoad | None = None) -> Residual | None:
        """Observe one sample; returns None while the observer settles."""
        motion = pair.motion
        row = motion.row if self._trail is None else self._trail.step(motion.dt, motion.row)
        n = len(self.model.channels)
        momentum, expected = self._expect(row[None], n, self.model.predict)
        own = None if load is None else load.worth.get('effort')
        if load is not None and own is not None:
            more = load.mass - load.known
            swing, change = self._expect(motion.row[None], n, own.along)
            if self._observed is not None:  # what has just come moves as the arm does already
                self._observed = self._observed + (more - self._carried) * swing[0]
            self._carried = more
            momentum, expected = momentum + more * swing, expected + more * change
        external = self._advance(motion.stamp, motion.dt == 0.0, momentum[0],
                                 expected[0] + pair.measured)
        if external is None or not motion.settled(self.settle):
            return None
        return Residual(motion, pair.measured, pair.measured + external, -external)

    def process(
        self, stamp: NDArray[np.int64], motion: FloatArray, measured: FloatArray,
    ) -> FloatArray:
        """
        Observe a gapless record at once.

        stamp (samples,) [ns], measured (samples, joints) [its unit]; motion (samples, inputs):
        ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s, m/s^2],
        and what else the model takes; returns (samples, joints).
        """
        momentum, expected = self._expect(motion, len(self.model.channels), self.model.predict)
        out = np.zeros_like(measured)
        for k, (time, p, u) in enumerate(zip(stamp.tolist(), momentum, expected + measured,
                                             strict=True)):
            external = self._advance(time, k == 0, p, u)
            if external is not None:
                out[k] = -external
        return out

    def _advance(
        self, stamp: int, first: bool, momentum: FloatArray, expected: FloatArray,
    ) -> FloatArray | None:
        if first or self._observed is None:
            self._observed, self._last = momentum, stamp
            return None
        dt = (stamp - self._last) * 1e-9
        self._last = stamp
        # backward Euler: stable for any sample time
        before = self._observed + dt * expected
        external = self.gain / (1.0 + self.gain * dt) * (momentum - before)
        self._observed = before + dt * external
        return np.asarray(external)

    @staticmethod
    def _expect(
        motion: FloatArray, n: int, efforts: Callable[[FloatArray], FloatArray],
    ) -> tuple[FloatArray, FloatArray]:
        """Give M dq, and dM/dt dq - n(q, dq): what the momentum does without effort."""
        count = len(motion)
        q, dq = motion[:, :n], motion[:, n:2 * n]
        batch = np.zeros((7, count, motion.shape[1]))
        batch[:, :, 3 * n:] = motion[:, 3 * n:]
        batch[0, :, :2 * n] = motion[:, :2 * n]
        step = STEP / np.maximum(1.0, np.abs(dq).max(axis=1, keepdims=True))
        for k, place in enumerate((q, q + step * dq, q - step * dq)):
            batch[1 + 2 * k:3 + 2 * k, :, :n] = place
            batch[1 + 2 * k, :, 2 * n:3 * n] = dq
        y = efforts(batch.reshape(7 * count, -1)).reshape(7, count, -1)
        change = ((y[3] - y[4]) - (y[5] - y[6])) / (2.0 * step)
        return y[1] - y[2], change - y[0]
