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
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.monitoring.familiarity import Familiarity, follow
from tudor_dynamics.monitoring.residuals import Residual
from tudor_dynamics.monitoring.thresholds.accumulation import advance, UNSURE
from tudor_dynamics.monitoring.thresholds.features import (
    evaluate_features, MotionFeatures, NEVER)
from tudor_dynamics.monitoring.thresholds.onset import OnsetFilter, weigh
from tudor_dynamics.monitoring.thresholds.stiction import advance_held, held_friction
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.small_arrays import array_at, places_of, REAL, WHOLE
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class Rates:
    """False alarms that the user allows, per hour of free motion."""

    collision: float = 1.0  # of the level that acts [1/h]
    contact: float = 60.0  # of the level that only tells [1/h]


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Excess:
    """One sample of one method against its thresholds."""

    residual: Residual  # residual of the sample
    onset: FloatArray  # onset statistic, in the unit of the residual, (channels,)
    # (channels,): ratio to the threshold of each level, the largest of residual, onset and
    # accumulated onset; above 1 exceeds.
    contact: FloatArray
    collision: FloatArray
    # (channels,): ratio of the onset to its collision threshold; negative where it takes from the
    # residual.
    sudden: FloatArray
    threshold: FloatArray  # collision threshold of the residual in force, in its unit, (channels,)


class ExcessStage:
    """Compares residuals with thresholds."""

    def __init__(self, thresholds: MethodThresholds, rates: Rates) -> None:
        self.thresholds = thresholds
        self._features = MotionFeatures(thresholds.n_joints)
        self._onset = OnsetFilter(thresholds.taps, thresholds.step)
        self._familiarity = Familiarity(thresholds.usual, thresholds.reach)
        n = len(thresholds.channels)
        self._sums, self._friction, self._held = np.zeros((2, n)), np.zeros(n), np.zeros(n)
        self._columns = np.empty(self._features.size)
        self._sticks = bool(thresholds.stiction.any())
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
        self._arrange()

    def _arrange(self) -> None:
        """Write down where all lies that a sample is judged by, in the order of `_judge`."""
        features, onset, known = self._features, self._onset, self._familiarity
        self._past = onset.x
        self._tables = [np.ascontiguousarray(table) for table in (
            self._columns, features.direction, features.lately, self.thresholds.stiction,
            self._held, self._friction, onset.t, onset.ages, self._contact, self._collision,
            known.widening, known.usual, known.reach, known.level,
            onset.x, onset.weights, self.thresholds.profile, self._sums, features.reversed_at)]
        self._places = places_of(self._tables)

    def step(self, residual: Residual, first: bool = False) -> Excess:
        """Compare one sample."""
        stamp = residual.motion.stamp
        first = first or self._last is None or stamp <= self._last
        dt = 0.0 if first or self._last is None else (stamp - self._last) * 1e-9
        last = NEVER if first or self._last is None else self._last
        if first:
            self._features.reset()
            self._sums[:] = 0.0
        self._last = stamp
        onset = self._onset
        known = onset.take_place(stamp, first)
        if onset.x is not self._past:
            self._arrange()
        out = np.empty((6, len(self._friction)))
        onset.begin = _judge(stamp, last, dt, self._sticks, onset.begin, onset.count, known,
                             residual.motion.row, residual.value, self._places, out)
        return Excess(residual, out[5], out[0], out[1], out[2], out[3])


@compiled
def _judge(
    stamp: int, last: int, dt: float, sticks: bool, begin: int, count: int, known: bool,
    row: FloatArray, value: FloatArray, places: NDArray[np.int64], out: FloatArray,
) -> int:
    """Fill ratios and threshold as `_compare`, and the onset behind; gives its new beginning."""
    # in one call: to hand all over one after the other takes longer than all that is computed
    columns, direction = array_at(places, 0, REAL, 1), array_at(places, 1, REAL, 1)
    lately, stiction = array_at(places, 2, REAL, 1), array_at(places, 3, REAL, 1)
    held, friction = array_at(places, 4, REAL, 1), array_at(places, 5, REAL, 1)
    t, ages = array_at(places, 6, REAL, 1), array_at(places, 7, REAL, 1)
    contact, collision = array_at(places, 8, REAL, 1), array_at(places, 9, REAL, 1)
    widening, usual = array_at(places, 10, REAL, 1), array_at(places, 11, REAL, 1)
    reach, level = array_at(places, 12, REAL, 1), array_at(places, 13, REAL, 1)
    x, weights = array_at(places, 14, REAL, 2), array_at(places, 15, REAL, 2)
    profile, sums = array_at(places, 16, REAL, 2), array_at(places, 17, REAL, 2)
    reversed_at, onset = array_at(places, 18, WHOLE, 1), out[5]
    evaluate_features(stamp, last, row, direction, reversed_at, lately, columns)
    if sticks:  # only joints do, and each its own speed
        for i in range(len(held)):
            held[i] = held_friction(stiction[i], columns[1 + i])
    advance_held(dt, value, held, friction, x[count - 1])
    if known:
        begin = weigh(t, x, begin, count, ages, weights, onset)
    else:
        onset[:] = 0.0
    _compare(profile, columns, value, onset, contact, collision, widening, held, dt, sums, out)
    follow(dt, columns[1:1 + len(direction)], out[4], usual, reach, level, widening)
    return begin


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
