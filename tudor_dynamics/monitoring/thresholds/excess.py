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

"""How far the residuals of one method stand above or below their thresholds."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.monitoring.familiarity import Familiarity
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.monitoring.thresholds.accumulation import advance, UNSURE
from tudor_dynamics.monitoring.thresholds.features import MotionFeatures
from tudor_dynamics.monitoring.thresholds.onset import OnsetFilter
from tudor_dynamics.monitoring.thresholds.stiction import advance_held, held_friction
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class Rates:
    """
    False alarms that the user allows, per hour of free motion.

    Attributes
    ----------
    collision : float
        Of the level that acts [1/h].
    contact : float
        Of the level that only tells [1/h].

    """

    collision: float = 1.0
    contact: float = 60.0


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Excess:
    """
    One sample of one method against its thresholds.

    Attributes
    ----------
    residual : Residual
        Residual of the sample.
    onset : ndarray of shape (n_channels,)
        Onset statistic, in the unit of the residual.
    contact, collision : ndarray of shape (n_channels,)
        Ratio to the threshold of each level, the largest of residual, onset and accumulated
        onset; above 1 exceeds.
    sudden : ndarray of shape (n_channels,)
        Ratio of the onset to its collision threshold; negative where it takes from the residual.
    threshold : ndarray of shape (n_channels,)
        Collision threshold of the residual in force, in its unit.

    """

    residual: Residual
    onset: FloatArray
    contact: FloatArray
    collision: FloatArray
    sudden: FloatArray
    threshold: FloatArray


class ExcessStage:
    """
    Compares residuals with thresholds.

    Parameters
    ----------
    thresholds : MethodThresholds
        Thresholds that were learned.
    rates : Rates
        False alarms allowed for this method.

    """

    def __init__(self, thresholds: MethodThresholds, rates: Rates) -> None:
        self.thresholds = thresholds
        self._features = MotionFeatures(thresholds.n_joints)
        self._onset = OnsetFilter(thresholds.taps, thresholds.step)
        self._familiarity = Familiarity(thresholds.usual, thresholds.reach)
        n = len(thresholds.channels)
        self._sums, self._friction = np.zeros((2, n)), np.zeros(n)
        self._none, self._free = np.zeros(n), np.empty(n)
        self._last: int | None = None
        self.rates = rates

    @property
    def widening(self) -> FloatArray:
        """Factor on the thresholds of each channel, for motion that they were not learned on."""
        return self._familiarity.widening

    @property
    def rates(self) -> Rates:
        """Give the false alarms allowed; may be changed at any time."""
        return self._rates

    @rates.setter
    def rates(self, rates: Rates) -> None:
        self._rates = rates
        self._collision = self.thresholds.ratios(rates.collision)
        self._contact = np.minimum(self.thresholds.ratios(rates.contact), self._collision)

    def step(self, residual: Residual, first: bool = False) -> Excess:
        """
        Compare one sample.

        Parameters
        ----------
        residual : Residual
            Sample, later than those before it.
        first : bool, default=False
            Whether the past does not count.

        Returns
        -------
        Excess
            Ratios to the thresholds.

        """
        stamp = residual.motion.stamp
        first = first or self._last is None or stamp <= self._last
        dt = 0.0 if first or self._last is None else (stamp - self._last) * 1e-9
        if first:
            self._features = MotionFeatures(self.thresholds.n_joints)
            self._sums[:] = 0.0
        self._last = stamp
        columns = self._features.step(stamp, residual.motion.row)
        n, stiction = len(self._friction), self.thresholds.stiction
        # only joints have some, and each its own speed
        held = held_friction(stiction, columns[1:1 + n]) if stiction.any() else self._none
        advance_held(dt, residual.value, held, self._friction, self._free)
        onset = self._onset.step(stamp, self._free, first)
        levels = np.empty((5, len(onset)))
        _compare(self.thresholds.profile, columns, residual.value, onset, self._contact,
                 self._collision, self.widening, held, dt,
                 self._sums, levels)
        self._familiarity.step(dt, columns[1:1 + self.thresholds.n_joints], levels[4])
        return Excess(residual, onset, levels[0], levels[1], levels[2], levels[3])


@compiled
def _compare(
    profile: FloatArray, columns: FloatArray, value: FloatArray, onset: FloatArray,
    contact: FloatArray, collision: FloatArray, widening: FloatArray, held: FloatArray,
    dt: float, sums: FloatArray, out: FloatArray,
) -> None:
    """Fill ratios to contact and collision, onset's, residual's threshold, onset by profile."""
    n = len(value)
    signed = np.empty(n)
    for i in range(n):
        usual = soon = 0.0
        for k in range(len(columns)):
            usual += profile[i, k] * columns[k]
            soon += profile[n + i, k] * columns[k]
        out[4, i] = abs(onset[i]) / soon
        plain = abs(value[i]) - held[i]
        plain = 0.0 if plain < 0.0 else plain / usual / widening[i]  # NaN stays
        sudden = out[4, i] / widening[i]
        signed[i] = math.copysign(plain * usual / (usual + UNSURE * held[i]), value[i])
        for level, ratio in enumerate((contact, collision)):
            a, b = plain / ratio[i], sudden / ratio[n + i]
            # NaN must win, as numpy has it
            out[level, i] = a if a > b or a != a else b
        out[2, i] = math.copysign(sudden / collision[n + i], onset[i] * value[i])
        out[3, i] = usual * collision[i] * widening[i] + held[i]
    advance(dt, signed, collision[2 * n:], sums)
    for i in range(n):
        most = max(sums[0, i], sums[1, i])
        out[0, i] = max(out[0, i], most / contact[2 * n + i])
        out[1, i] = max(out[1, i], most / collision[2 * n + i])
