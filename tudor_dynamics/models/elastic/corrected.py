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
from tudor_dynamics.typing import FloatArray


class CorrectedArm(DrivenArm):
    """A driven arm, and what draws it towards measured moments; see ``DrivenArm``."""

    def gains_along(
        self, q: FloatArray, dt: FloatArray, measured: FloatArray, deviation: FloatArray,
        bandwidth: float, before: FloatArray | None = None,
    ) -> FloatArray:
        """
        Observe a motion, and keep the gains of the observer.

        Parameters
        ----------
        q : ndarray of shape (n_samples, n_joints)
            Measured positions of the active joints [rad or m].
        dt : ndarray of shape (n_samples,)
            Time since the sample before [s]; 0 to begin anew, at rest.
        measured : ndarray of shape (n_samples, n_gauges)
            Moments that the gauges show [N m].
        deviation : ndarray of shape (n_gauges,)
            Of what a sample measures [N m].
        bandwidth : float
            Rate at which an error dies out [1/s].
        before : ndarray of shape (n_earlier, 1 + n_joints), optional
            ``[dt, q]`` of the motion just before, which nothing corrects.

        Returns
        -------
        ndarray of shape (n_samples, 3, n_moving, n_gauges)
            For ``follow_towards``.

        Raises
        ------
        SimulationError
            If it diverges.

        """
        measured, lag, self._physics.lag = self._ahead(dt, measured), self._physics.lag, 0.0
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
        m, count = self.size, len(q)
        gains = np.zeros((count, 3, m, measured.shape[1]))
        for k in range(count):
            if dt[k] <= 0.0:
                self.forget()
            moment = self.follow(q[k:k + 1], dt[k:k + 1]).moment[0]
            step = float(dt[k]) if dt[k] > 0.0 else SAMPLE
            if not self.correct(measured[k] - moment, step):
                msg = f'{self.arm.name}: the elastic model cannot be linearised along this motion'
                raise SimulationError(msg)
            mass, damping, stiffness = self._small
            gain = self._covariance[:2 * m, :m] @ self._shown.T / (
                self._deviation**2 * (SAMPLE / step))
            gains[k, 0], gains[k, 1] = gain[:m], gain[m:]
            gains[k, 2] = -np.linalg.solve(mass, stiffness @ gain[:m] + damping @ gain[m:])
        self.forget()
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

        Parameters
        ----------
        q : ndarray of shape (n_samples, n_joints)
            Measured positions of the active joints [rad or m].
        dt : ndarray of shape (n_samples,)
            Time since the sample before [s]; 0 to begin anew, at rest.
        measured : ndarray of shape (n_samples, n_gauges)
            Moments that the gauges show [N m].
        gains : ndarray of shape (n_samples, 3, n_moving, n_gauges)
            Gains that ``gains_along`` gave.

        Returns
        -------
        Response
            As predicted at each sample from what was before it.

        Raises
        ------
        SimulationError
            If it diverges.

        """
        return self._follow(q, dt, self._ahead(dt, measured), gains)

    def _ahead(self, dt: FloatArray, measured: FloatArray) -> FloatArray:
        """Give what will be read a lag later: what draws the arm was there before it is read."""
        lag = self._physics.lag
        if lag <= 0.0:
            return measured
        t = np.cumsum(dt)
        return np.column_stack([np.interp(t + lag, t, column) for column in measured.T])
