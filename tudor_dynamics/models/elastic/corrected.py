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
A driven arm that measured strain draws back to the measured motion, with given gains.

An arm that follows positions alone forgets an error only as fast as its vibrations die out, and
one with play in its gears never forgets where small differences grow. Corrected a little, it
forgets them within a time one can choose. The gains are those of the observer along a reference;
kept as they are, errors remain a smooth function of the parameters.
"""

from __future__ import annotations

import numpy as np

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.arm import DrivenArm, Response, SAMPLE
from tudor_dynamics.models.elastic.gains import observe
from tudor_dynamics.typing import FloatArray


class CorrectedArm(DrivenArm):
    """A driven arm, and what draws it towards measured moments; see ``DrivenArm``."""

    def gains_along(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, deviation: FloatArray,
        bandwidth: float, before: FloatArray | None = None,
    ) -> FloatArray:
        """
        Observe a motion, and keep the gains of the observer.

        q (samples, joints) [rad or m], measured (samples, gauges) [N m], deviation (gauges,)
        [N m], bandwidth [1/s], dt (samples,) [s]; before (earlier, 1 + joints): ``[dt, q]`` of the
        motion just before, which nothing corrects; returns (samples, 3, moving, gauges).
        """
        measured, lag, self._physics.lag = self.ahead(dt, measured), self._physics.lag, 0.0
        try:
            return self._gains_along(q, dt, measured, deviation, bandwidth, before)
        finally:
            self._physics.lag = lag

    def _gains_along(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, deviation: FloatArray,
        bandwidth: float, before: FloatArray | None,
    ) -> FloatArray:
        self.follow(q[:1], np.zeros(1))
        self.start_observer(deviation, bandwidth)
        self.begin(before)
        gains = np.zeros((len(q), 3, self.size, measured.shape[1]))
        done = observe(
            np.ascontiguousarray(q), np.ascontiguousarray(dt), self.inner, self.loaded,
            np.ascontiguousarray(measured), self._deviation**2 * SAMPLE, self._noise, SAMPLE,
            self.mechanism.tip, self._seen, gains, *self.arrays)
        if done < len(q):
            msg = (f'{self.arm.name}: the elastic model diverges after {done} of {len(q)} '
                   'samples, or cannot be linearised there')
            raise SimulationError(msg)
        return gains

    def begin(self, before: FloatArray | None) -> None:
        """Follow the motion before what counts, if there was any."""
        if before is not None and len(before):
            earlier = before[:, 0].copy()
            earlier[0] = 0.0
            self.follow(before[:, 1:], earlier)

    def follow_towards(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, gains: FloatArray,
    ) -> Response:
        """
        Follow motion, drawn towards measured moments.

        q (samples, joints) [rad or m], measured (samples, gauges) [N m], gains
        (samples, 3, moving, gauges); dt (samples,) [s]: 0 to begin anew, at rest.
        """
        found = self.prompt(q, dt, self.ahead(dt, measured), gains)
        return Response(self.late(found.moment, dt), found.torque)

    def ahead(self, dt: FloatArray, measured: FloatArray) -> FloatArray:
        """
        Give what will be read a lag later: what draws the arm was there before it is read.

        dt (samples,) [s], measured (samples, gauges) [N m].
        """
        lag = self._physics.lag
        if lag <= 0.0:
            return measured
        t = np.cumsum(dt)
        return np.column_stack([np.interp(t + lag, t, column) for column in measured.T])
