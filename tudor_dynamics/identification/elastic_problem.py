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

"""The least-squares problem of the elastic model: simulated against measured strain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
import os

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.compiled import LANES
from tudor_dynamics.errors import FitError, SimulationError
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.elastic.arm import DrivenArm, follow_together, NO_GAINS
from tudor_dynamics.models.elastic.model import PhysicalParameter
from tudor_dynamics.models.elastic.parameters import kind_of, physical_unit
from tudor_dynamics.models.settings import INNER_STEP
from tudor_dynamics.parallel import in_threads
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- How well simulated strain explains what was measured

def fit_percent(errors: FloatArray, strain: FloatArray) -> float:
    """Give the fit of all channels together, ``100 (1 - |e| / |y - mean|)`` [%]."""
    spread = float(np.linalg.norm(strain - strain.mean(axis=0)))
    return 100.0 * (1.0 - float(np.linalg.norm(errors)) / max(spread, 1e-300))


def robust_scale(errors: FloatArray, strain: FloatArray) -> FloatArray:
    """Give robust standard deviations: half of the errors lie within 0.6745 of them."""
    return np.asarray(np.maximum(np.median(np.abs(errors), axis=0) / 0.6745,
                                 1e-3 * strain.std(axis=0) + 1e-12))


# -- Coordinates in which the search for elastic parameters runs straight.
#
# What strain shows sharply are sums: of the compliances of a gear and the link after it, of
# masses. What it shows weakly is how a sum is shared. Along such a valley, logarithms of
# stiffnesses and masses bend away from constant sums; compliances and masses themselves do not.

class Straight:
    """Logarithms to coordinates and back: center (names,); those of gains, which follow, stay."""

    def __init__(self, names: Sequence[str], center: FloatArray, gains: int) -> None:
        self.center = np.append(center, np.zeros(gains))
        self._sign = np.array([*(float(kind_of(name).adds) for name in names), *[0.0] * gains])
        self._plain = self._sign == 0.0

    def of(self, x: FloatArray) -> FloatArray:
        """Give compliances and masses relative to the centre, other logarithms as they are."""
        return np.where(self._plain, x, np.exp(self._sign * (x - self.center)))

    def back(self, u: FloatArray) -> FloatArray:
        """Give the logarithms: u (names + gains,)."""
        positive = np.where(self._plain, 1.0, np.maximum(u, 1e-300))
        return np.where(self._plain, u, self.center + self._sign * np.log(positive))

    def slope(self, u: FloatArray) -> FloatArray:
        """Differentiate ``back``: u (names + gains,)."""
        return np.where(self._plain, 1.0, self._sign / np.where(self._plain, 1.0, u))


# -- What the search for elastic parameters is given: stretches of recordings, and what is known

RUN_IN = 6.0  # left out where a stretch begins in motion whose past is unknown [s]
SETTLE = 0.5  # left out at the beginning of each stretch [s]
LEAST_SECONDS = 8.0  # strain below which nothing can be said of oscillations [s]


@dataclass(frozen=True, eq=False)
class Record:
    """A gapless stretch to compare with."""

    q: FloatArray  # measured positions, (samples, joints) [rad or m]
    dt: FloatArray  # time since the sample before, (samples,) [s]; 0 where nothing was before
    strain: FloatArray  # readings in their units, (samples, gauges)
    skip: int = 0  # samples at the beginning that do not count
    payload: float | None = None  # mass at the tip [kg]; None where it is among the parameters
    before: FloatArray | None = None  # `[dt, q]` of the motion just before, (earlier, 1 + joints)

    def head(self, seconds: float) -> Record:
        """Take the first seconds of the record."""
        n = int(np.searchsorted(np.cumsum(self.dt[1:]), seconds)) + 1
        return replace(self, q=self.q[:n], dt=self.dt[:n], strain=self.strain[:n],
                       skip=min(self.skip, n // 2))

    def decimated(self, dt: float) -> Record:
        """Leave out samples, for coarse steps: dt [s]."""
        stride = int(dt / float(np.median(self.dt[1:])) + 0.5) if len(self.dt) > 1 else 1
        if stride < 2:
            return self
        passed = np.cumsum(self.dt)[::stride]
        return replace(self, q=self.q[::stride], strain=self.strain[::stride],
                       dt=np.diff(passed, prepend=passed[0] - self.dt[0]),
                       skip=-(-self.skip // stride))


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known of the parameters before any recording."""

    start: dict[str, float] = field(default_factory=dict)  # starting values by parameter
    width: dict[str, float] = field(default_factory=dict)  # standard deviation of their logarithms
    held: dict[str, float] = field(default_factory=dict)  # values of those that are not searched

    @property
    def names(self) -> tuple[str, ...]:
        """Name the parameters to be searched."""
        return tuple(self.start)

    @property
    def center(self) -> FloatArray:
        """Give the logarithms of the starting values, shape (n_names,)."""
        return np.log([self.start[name] for name in self.names])

    @property
    def width_of(self) -> FloatArray:
        """Give the standard deviations of the logarithms, shape (n_names,)."""
        return np.array([self.width[name] for name in self.names])

    def without(self, *kinds: str) -> Knowledge:
        """Leave parameters out of the search."""
        return replace(self, start={k: v for k, v in self.start.items() if k not in kinds},
                       width={k: v for k, v in self.width.items() if k not in kinds})

    def holding(self, values: dict[str, float]) -> Knowledge:
        """Hold parameters at values instead of searching for them."""
        return replace(self.without(*values), held={**self.held, **values})


def record_of(stretch: Stretch, payload: float | None) -> Record | None:
    """Take from a stretch what the search compares with; None where it is too short."""
    if stretch.strain is None:
        return None
    t = stretch.t - stretch.t[0]
    # standstill before the motion shows how the links hang, and is left out of figures alone
    skip = min(int(stretch.decimation.keep[0]), int(np.searchsorted(t, SETTLE)))
    if stretch.past_unknown:
        skip = max(skip, int(np.searchsorted(t, RUN_IN)))
    if skip >= len(t) or t[-1] - t[skip] < LEAST_SECONDS:
        return None
    return Record(stretch.states.q, stretch.dt, stretch.strain, skip, payload, stretch.before)


def records_of(bags: Sequence[BagData]) -> list[Record]:
    """Take from bags what the search compares with."""
    records = [record for bag in bags for stretch in bag.stretches
               if (record := record_of(stretch, bag.payload)) is not None]
    if not records:
        names = ', '.join(str(bag.choice) for bag in bags)
        msg = (f'{names}: no stretch has {LEAST_SECONDS:g} s of strain without a gap, which the '
               'elastic model needs; record longer, or leave elastic out of models=')
        if not any(bag.has('strain') for bag in bags):
            msg = (f'{names}: no strain, which the elastic model needs; record the gauges too, or '
                   'leave elastic out of models=')
        raise FitError(msg)
    return records


# -- Simulations of an elastic arm along recordings, for several choices of parameters at once

class Simulations:
    """Arms that follow recordings, in threads and side by side."""

    def __init__(
        self, arm: Arm, records: Sequence[Record], names: tuple[str, ...],
        fixed: dict[str, float], inner: float,
    ) -> None:
        self.inner = inner  # longest inner step, which may be changed [s]
        self._arm, self._records, self._names, self._fixed = arm, records, names, fixed
        self._threads = max(1, min(8, len(os.sched_getaffinity(0))))
        self._idle: list[list[DrivenArm]] = []
        self.towards: list[tuple[FloatArray, FloatArray]] | None = None

    def several(self, vectors: Sequence[FloatArray]) -> list[FloatArray | None]:
        """Simulate moments at gauges (samples, gauges) [N m], or None, for vectors in lanes."""
        together = in_threads(self._together, [
            vectors[first:first + LANES] for first in range(0, len(vectors), LANES)],
            self._threads)
        return [one for some in together for one in some]

    def draw(
        self, x: FloatArray, strain: FloatArray, gauges: FloatArray, deviation: FloatArray,
        bandwidth: float,
    ) -> bool:
        """Draw what is simulated from now on, by a bandwidth [1/s], towards measured strain."""
        found, begin = [], 0
        with self._borrowed(1) as (driven,):
            for record in self._records:
                driven.set_parameters(self._values(x, record))
                end = begin + len(record.q) - record.skip
                shown = np.vstack([record.strain[:record.skip], strain[begin:end]])
                begin, measured = end, (shown - gauges[:, 1]) / gauges[:, 0]
                try:
                    found.append((measured, driven.gains_along(
                        record.q, record.dt, measured, deviation, bandwidth, record.before)))
                except SimulationError:
                    return False
        self.towards = found
        return True

    @contextmanager
    def _borrowed(self, count: int) -> Iterator[list[DrivenArm]]:
        """Lend arms that nobody else has; what there is not yet is built."""
        try:
            arms = self._idle.pop()
        except IndexError:
            arms = []
        arms += [DrivenArm(self._arm) for _ in range(count - len(arms))]
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
        self, k: int, arms: Sequence[DrivenArm], vectors: Sequence[FloatArray],
    ) -> list[FloatArray | None]:
        """Simulate one record, with an arm for each vector."""
        record, n = self._records[k], len(self._names)
        moments: list[FloatArray | None] = [None] * len(arms)
        ready = []
        for i, x in enumerate(vectors):
            try:
                arms[i].set_parameters(self._values(x, record))
                arms[i].begin(record.before)
            except SimulationError:
                continue
            ready.append(i)
        if not ready:
            return moments
        measured, gains = None, NO_GAINS
        if self.towards is not None:
            shown, gains = self.towards[k]
            measured = [shown / np.exp(vectors[i][n:]) for i in ready]
        found = follow_together([arms[i] for i in ready], record.q, record.dt, measured, gains)
        for i, moment in zip(ready, found, strict=True):
            moments[i] = None if moment is None else moment[record.skip:]
        return moments

    def _values(self, x: FloatArray, record: Record) -> dict[str, float]:
        known = {} if record.payload is None else {'payload': record.payload}
        searched = dict(zip(self._names, np.exp(x).tolist(), strict=False))
        return {**self._fixed, **searched, **known}


# -- The least-squares problem of the elastic model: simulated against measured strain.
#
# Output error: the arm is driven by measured positions and never corrected, so the whole
# oscillation has to come out of the parameters. These are searched as logarithms, each with a
# prior as wide as one can know it from drawings. Gain and offset of a gauge are linear and are
# eliminated (variable projection, Golub and Pereyra 1973, with Kaufman's Jacobian), so that only
# physics is searched.

STEP = 1e-4
"""Of the differences, in the logarithm: the simulation is smooth to 1e-9, and its phase curved."""
TRUSTED = 6.0
"""Errors beyond this many standard deviations are a corrupted reading's, and draw no farther."""
HOPELESS = 1e3
"""Residual of a sample for parameters that cannot be simulated, in standard deviations."""


class Problem:
    """Residuals and derivatives for a choice of parameters and records."""

    def __init__(
        self, arm: Arm, records: Sequence[Record], names: tuple[str, ...], fixed: dict[str, float],
        center: FloatArray, width: FloatArray, *, inner: float = INNER_STEP,
    ) -> None:
        self.arm, self.records, self.names, self.fixed = arm, tuple(records), names, fixed
        self.center, self.width = center, width
        self.strain = np.vstack([r.strain[r.skip:] for r in records])
        spread = np.maximum(self.strain.std(axis=0), 1e-12)
        self.weights = np.tile(1.0 / spread, (len(self.strain), 1))
        self.simulations = Simulations(arm, self.records, names, fixed, inner)
        self._last: list[tuple[FloatArray, FloatArray | None]] = []
        self._gains: FloatArray | None = None

    def extended(self, x: FloatArray) -> FloatArray:
        """Give these parameters, and where gains draw their logarithms: (unknowns,)."""
        gains = 0 if self._gains is None else self.strain.shape[1]
        return np.concatenate([x[:len(self.names)], np.zeros(gains)])

    def moments(self, x: FloatArray) -> FloatArray | None:
        """Simulate the moments at the gauges (samples, gauges) [N m]; None where impossible."""
        for known, result in self._last:
            if np.array_equal(known, x):
                return result
        return self._kept([x])[0]

    def compared(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Simulate what can be: moments, errors of the strain, and gains with offsets."""
        moments = self.moments(x)
        if moments is None:
            raise FitError(f'arm {self.arm.name!r}: the elastic model cannot be simulated on '
                           'these bags; check `links` and `motors` of the arm description')
        return moments, self.errors(moments, x), self.gauges(moments, x)

    def _kept(self, several: Sequence[FloatArray]) -> list[FloatArray | None]:
        """Simulate, and remember it: one of them is asked for again."""
        found = self.simulations.several(several)
        self._last = [(x.copy(), one) for x, one in zip(several, found, strict=True)]
        return found

    def draw(self, x: FloatArray, bandwidth: float) -> FloatArray:
        """Draw the simulations towards the measured strain, by a bandwidth [1/s] above 0."""
        # an error of phase grows along a recording, and small differences where a gear crosses its
        # play grow by themselves; so an arm that only follows positions is far off wherever its
        # parameters are a little wrong. Drawn towards the strain it forgets errors within
        # 1/bandwidth, and what is left are errors of prediction, smooth in the parameters. Gains
        # of gauges then act on the simulation too, and are searched like the parameters
        moments = self.moments(x)
        gains: FloatArray | None = None
        self.simulations.towards = None  # arms follow positions alone
        if moments is not None and bandwidth > 0.0:
            gauges, errors = self.gauges(moments, x), self.errors(moments, x)
            noise = robust_scale(errors, self.strain)
            trusted = self.strain + np.clip(errors, -TRUSTED * noise, TRUSTED * noise) - errors
            if self.simulations.draw(x, trusted, gauges, noise / np.abs(gauges[:, 0]), bandwidth):
                gains = gauges[:, 0]
        self._gains = gains
        self._last = []
        return self.extended(x)

    def gauges(self, moments: FloatArray, x: FloatArray) -> FloatArray:
        """Find gain [unit per N m] and offset of each gauge, (gauges, 2), for moments [N m]."""
        result = np.empty((moments.shape[1], 2))
        for g in range(moments.shape[1]):
            w = self.weights[:, g]
            if self._gains is None:
                columns = np.column_stack([moments[:, g] * w, w])
                result[g] = np.linalg.lstsq(columns, self.strain[:, g] * w, rcond=None)[0]
            else:
                gain = self._gains[g] * np.exp(x[len(self.names) + g])
                result[g] = gain, w**2 @ (self.strain[:, g] - gain * moments[:, g]) / (w @ w)
        return result

    def errors(self, moments: FloatArray, x: FloatArray) -> FloatArray:
        """Give measured less simulated strain of moments [N m], with the gains of ``gauges``."""
        gains = self.gauges(moments, x)
        return np.asarray(self.strain - moments * gains[:, 0] - gains[:, 1])

    def fits(self, several: Sequence[FloatArray]) -> list[float]:
        """Give the fit on all records [%] for several vectors; -inf where one is impossible."""
        return [-np.inf if moments is None else fit_percent(self.errors(moments, x), self.strain)
                for x, moments in zip(several, self.simulations.several(several), strict=True)]

    def residuals(self, several: Sequence[FloatArray]) -> list[FloatArray]:
        """Give weighted errors, and how far parameters are from their prior, in one vector."""
        result = []
        for x, moments in zip(several, self._kept(several), strict=True):
            errors = (np.full(self.strain.size, HOPELESS) if moments is None
                      else (self.errors(moments, x) * self.weights).ravel())
            result.append(np.concatenate([
                errors, (x[:len(self.names)] - self.center) / self.width]))
        return result

    def slopes(self, x: FloatArray, here: FloatArray) -> FloatArray:
        """Differentiate the moments, those here, by each unknown: (unknowns, samples, gauges)."""
        return np.array([
            np.zeros_like(here) if there is None else (there - here) / STEP
            for there in self.simulations.several(list(x + STEP * np.eye(len(x))))])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Differentiate ``residuals``; what a gain or an offset can take up is left out."""
        moments = self.moments(x)
        size, n = self.strain.size, len(self.names)
        result = np.zeros((size + n, len(x)))
        result[size:, :n] = np.diag(1.0 / self.width)
        if moments is None:
            return result
        slopes, gains = self.slopes(x, moments), self.gauges(moments, x)
        shape = self.strain.shape
        for g in range(shape[1]):
            w = self.weights[:, g]
            columns = -(slopes[:, :, g] * gains[g, 0] * w).T
            if self._gains is None:
                basis, _ = np.linalg.qr(np.column_stack([moments[:, g] * w, w]))
            else:
                columns[:, n + g] -= moments[:, g] * gains[g, 0] * w
                basis = (w / np.linalg.norm(w))[:, None]
            columns -= basis @ (basis.T @ columns)
            result[g:size:shape[1]] = columns
        return result


# -- What a search for elastic parameters amounts to: weights, values, honest standard errors

HUBER = 2.0  # errors beyond this many standard deviations count less
TOGETHER = 0.25  # errors nearer than this count as one in the search, against the prior [s]
SMOOTH = 1.0
"""How strongly simulations are drawn for standard errors [1/s]: slopes of an arm that follows
positions alone over its plays are rough, and rough slopes promise too much."""
CLUSTER = 2.0  # errors nearer than this belong together, for the standard errors [s]


@dataclass(frozen=True)
class Start:
    """A start that was tried."""

    factor: float  # on all stiffnesses
    share: float | None  # of the compliance that lies in the gears; None as described
    fit: float  # that it came to on the pieces compared, stiffness and damping improved [%]


@dataclass(frozen=True, eq=False)
class Identified:
    """What was found out about an elastic arm."""

    physical: tuple[PhysicalParameter, ...]  # with those known that were not searched
    # (gauges, 2): gain and offset of each gauge, and their standard deviations.
    gauges: FloatArray
    gauge_errors: FloatArray
    noise: FloatArray  # deviation of the rest without outliers, (gauges,) [its unit]
    fit: float  # of the strain on the records themselves, all channels together [%]
    starts: tuple[Start, ...]  # starts compared, with the fit each came to
    untold: tuple[str, ...] = ()  # stiffnesses that searches find different, as good


def reweight(problem: Problem, x: FloatArray) -> None:
    """Weigh each gauge by its own error, outliers less (Huber): x (unknowns,)."""
    moments = problem.moments(x)
    if moments is None:
        return
    errors = problem.errors(moments, x)
    scale = robust_scale(errors, problem.strain)
    size = np.abs(errors) / scale
    dt = float(np.median(np.concatenate([record.dt[1:] for record in problem.records])))
    weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-12)) * min(1.0, dt / TOGETHER)
    problem.weights = np.sqrt(weight) / scale


def result_of(
    problem: Problem, x: FloatArray, starts: tuple[Start, ...], untold: tuple[str, ...] = (),
) -> Identified:
    """Collect what was found: x (names,)."""
    for _ in range(2):  # outliers that count less move gains, and these the errors
        reweight(problem, x)
    drawn = problem.draw(x, SMOOTH)
    reweight(problem, drawn)
    covariance = _covariance(problem, drawn)
    x = problem.draw(drawn, 0.0)
    _, errors, gains = problem.compared(x)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    physical = []
    for i, name in enumerate(problem.names):
        value = float(np.exp(x[i]))
        physical.append(PhysicalParameter(
            name, value, physical_unit(problem.arm, name), float(value * deviation[i]),
            bool(deviation[i] < 0.5 * problem.width[i] and deviation[i] < 0.5
                 and name not in untold)))
    physical += [PhysicalParameter(name, value, physical_unit(problem.arm, name))
                 for name, value in problem.fixed.items()]
    n = len(problem.names)
    gauge_errors = np.sqrt(np.maximum(np.diag(covariance)[n:], 0.0)).reshape(-1, 2)
    return Identified(tuple(physical), gains, gauge_errors, robust_scale(errors, problem.strain),
                      fit_percent(errors, problem.strain), starts, untold)


def _covariance(problem: Problem, x: FloatArray) -> FloatArray:
    """Covariance of the logarithms, gains and offsets."""
    # The errors of neighbouring samples belong together, so each cluster of them counts as one
    # observation (Liang and Zeger 1986); plain least squares would promise ten times too much.
    moments, errors, gains = problem.compared(x)
    slopes = problem.slopes(x, moments)
    n, gauges = len(problem.names), gains.shape[0]
    p = n + 2 * gauges
    # gains act on the moments as well while these are drawn
    through = np.zeros((p, *moments.shape))
    through[:n] = slopes[:n]
    for h, slope in enumerate(slopes[n:]):
        through[n + 2 * h] = slope / gains[h, 0]
    information, meat = np.zeros((p, p)), np.zeros((p, p))
    information[:n, :n] = np.diag(1.0 / problem.width**2)
    begin = 0
    for record in problem.records:
        count = len(record.q) - record.skip
        dt = float(np.median(record.dt[1:]))
        size = max(1, int(round(CLUSTER / dt)))
        for first in range(begin, begin + count, size):
            part = slice(first, min(first + size, begin + count))
            score = np.zeros(p)
            for g in range(gauges):
                w = problem.weights[part, g]
                rows = (through[:, part, g] * gains[g, 0] * w).T
                rows[:, n + 2 * g] += moments[part, g] * w
                rows[:, n + 2 * g + 1] = w
                information += rows.T @ rows
                score += rows.T @ (errors[part, g] * w)
            meat += np.outer(score, score)
        begin += count
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    clustered = inverse @ meat @ inverse
    # Where the errors say too little to have a scatter, the prior's width is what remains.
    prior = inverse[:, :n] @ np.diag(1.0 / problem.width**2) @ inverse[:n]
    return np.asarray(clustered + prior)
