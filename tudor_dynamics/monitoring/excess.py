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

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.monitoring.features import MotionFeatures
from tudor_dynamics.monitoring.onset import OnsetFilter
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.monitoring.thresholds import MethodThresholds

FloatArray = NDArray[np.float64]


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


@dataclass(frozen=True, eq=False)
class Excess:
    """
    One sample of one method against its thresholds.

    Attributes
    ----------
    residual : Residual
        Sample.
    onset : ndarray of shape (n_channels,)
        Onset statistic, in the unit of the residual.
    contact, collision : ndarray of shape (n_channels,)
        Ratio to the threshold of each level, the larger of residual and onset; above 1 exceeds.
    threshold : ndarray of shape (n_channels,)
        Collision threshold of the residual in force, in its unit.

    """

    residual: Residual
    onset: FloatArray
    contact: FloatArray
    collision: FloatArray
    threshold: FloatArray


class ExcessStage:
    """
    Compares residuals with thresholds.

    Parameters
    ----------
    thresholds : MethodThresholds
        Learned thresholds.
    rates : Rates
        False alarms allowed for this method.

    """

    def __init__(self, thresholds: MethodThresholds, rates: Rates) -> None:
        self.thresholds = thresholds
        self._features = MotionFeatures(thresholds.n_joints)
        self._onset = OnsetFilter(thresholds.taps, thresholds.step)
        self._last: int | None = None
        self._used: set[int] = set(range(len(thresholds.channels)))
        self.rates = rates

    @property
    def rates(self) -> Rates:
        """False alarms allowed; may be changed at any time."""
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
        if first:
            self._features = MotionFeatures(self.thresholds.n_joints)
        self._last = stamp
        columns = self._features.step(stamp, residual.motion.row)
        onset = self._onset.step(stamp, residual.value, first)
        n = len(onset)
        profile = self.thresholds.profile @ columns
        ratio = np.abs(np.concatenate([residual.value, onset])) / profile
        contact, collision = ratio / self._contact, ratio / self._collision
        return Excess(residual, onset, np.maximum(contact[:n], contact[n:]),
                      np.maximum(collision[:n], collision[n:]),
                      profile[:n] * self._collision[:n])
