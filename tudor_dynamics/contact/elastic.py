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

"""What gauges show beyond an elastic model, and how its links answer to what presses on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.contact.layout import PRESSING
from tudor_dynamics.contact.modal import carry, slow_modes, turn_basis
from tudor_dynamics.contact.pressing import Pressing, pressing_columns
from tudor_dynamics.contact.span import link_axes, Span
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.models.elastic.fitted import FittedElastic
from tudor_dynamics.models.elastic.gear import STIFF
from tudor_dynamics.models.elastic.observer import FORCES, linearise, white_force
from tudor_dynamics.models.elastic.setup import moment_rows
from tudor_dynamics.models.elastic.small_motion import Linearised
from tudor_dynamics.models.elastic.statics import DZ, STIFFNESS, Z
from tudor_dynamics.typing import FloatArray

SAMPLE = 0.01
"""Sample time that deviations of measurements belong to [s]."""
SLOW = 40.0
"""Vibrations above follow a force at once [Hz]."""
RINGING = 3.0
"""Rate at which the followed arm is drawn to the measured one [1/s]."""
BANDWIDTH = 2.0
"""Rate at which a vibration that nobody explains is forgotten [1/s]."""


class ElasticFront:
    """
    An elastic arm that follows positions, uncorrected, and is linearised as it goes.

    moment_deviation (gauges,) [N m], noise [N^2 s].
    """

    def __init__(
        self, model: FittedElastic, spans: Sequence[Span], moment_deviation: FloatArray,
    ) -> None:
        self._driven = driven = driven_arm(model.arm, model.values)
        m = driven.size
        tables = driven.tables
        self._shown = moment_rows(driven.mechanism, driven.gauges, tables.equations.free)
        self._pressing = []
        for span in spans:
            axes = link_axes(model.arm, span.joint)
            self._pressing.append(Pressing(
                span, axes.along, axes.across, driven.mechanism, driven.gauges))
        places = tables.gears.place
        self._geared = np.searchsorted(tables.equations.free, places)
        self._engaged = (tables.equations.matrices[STIFFNESS, places, places]
                         + tables.gears.springs[:, STIFF])
        driven.start_observer(moment_deviation, RINGING)
        self._small: FloatArray = np.zeros((3, m, m))
        self._white: FloatArray = np.zeros((m, FORCES))
        self._acting = [np.zeros((m, PRESSING)) for _ in spans]
        driven.follow(np.tile(tables.equations.vectors[Z, places], (2, 1)),
                      np.array([0.0, 1e-3]))
        self._linearise()
        squares = np.linalg.eigvals(np.linalg.solve(self._small[0], self._small[2])).real
        count = max(1, int(np.sum(squares < (2.0 * np.pi * SLOW) ** 2)))
        self._basis: FloatArray = np.zeros((m, count))
        self._squares: FloatArray = np.zeros(count)
        self._rates: FloatArray = np.zeros(count)
        slow_modes(self._small, self._basis, self._squares, self._rates)
        self._first = self._basis.copy()
        self.noise = SAMPLE * white_force(
            Linearised(*self._small), self._white, self._shown / moment_deviation[:, None],
            BANDWIDTH)

    @property
    def modes(self) -> int:
        """Give the number of vibrations that are carried along."""
        return len(self._squares)

    def follow(self, dt: float, row: FloatArray) -> FloatArray:
        """
        Go to the next sample.

        dt [s]: 0 to begin anew, at rest; row (3 joints,): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (gauges,) [N m].
        """
        if dt <= 0.0:
            self._driven.forget()
            self._basis[:] = self._first  # what went before may have been no arm any more
        moment = self._driven.follow(row[None, :len(row) // 3], np.array([dt])).moment[0]
        if dt <= 0.0:
            return moment  # matrices come with the next sample, which moves it
        self._before = self._basis.copy()
        try:
            self._linearise()
            slow_modes(self._small, self._basis, self._squares, self._rates)
            self._flexible = np.linalg.inv(self._small[2]) - (
                self._basis / self._squares) @ self._basis.T
        except np.linalg.LinAlgError as err:
            raise SimulationError(f'the arm has no vibrations where it is now ({err}): its links '
                                  'bend farther than they can') from None
        return moment

    def settle(self, left: FloatArray, dt: float, states: FloatArray) -> None:
        """
        Draw the arm to what was measured, and hypotheses the other way.

        An arm in its play, or far from where it is linearised, is no linear one. The followed arm
        takes over what the true one does, and the states, which are the difference of both,
        know of it.

        left (gauges,) [N m], dt [s], states (spans, 2 c + PRESSING).
        """
        equations, c = self._driven.tables.equations, self.modes
        before = equations.vectors[[Z, DZ]][:, equations.free]
        if not self._driven.correct(left, dt):
            return
        change = equations.vectors[[Z, DZ]][:, equations.free] - before
        states[:, :2 * c] -= (change @ self._small[0] @ self._basis).ravel()

    def carry(
        self, number: int, state: FloatArray, covariance: FloatArray, dt: float, fade: float,
        rise: FloatArray, calm: float,
    ) -> FloatArray:
        """
        Carry a hypothesis to the newest sample.

        dt [s], rise (PRESSING, PRESSING); writes state, covariance (2 c + PRESSING,); returns
        (gauges, 2 c + PRESSING).
        """
        acting = self._acting[number]
        turn_basis(self._before, self._small[0], self._basis, state, covariance)
        carry(state, covariance, self._squares, self._rates, self._basis.T @ self._white,
              self._basis.T @ acting, dt, calm * self.noise, fade, rise)
        shown = self._shown @ self._basis
        return np.hstack([shown, np.zeros_like(shown), self._pressing[number].through
                          + self._shown @ self._flexible @ acting])

    def _linearise(self) -> None:
        driven = self._driven
        linearise(False, driven.mechanism.tip, *self._small, self._white, *driven.arrays)
        # teeth that bear: in its play a gear takes no force, where a contact ends it does
        self._small[2, self._geared, self._geared] = self._engaged
        for item, columns in zip(self._pressing, self._acting, strict=True):
            pressing_columns(*item.numbers, columns, *driven.arrays)
