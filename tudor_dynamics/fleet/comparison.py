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

"""What arms are compared by, which arm is an outlier or drifts, and a page that shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import datetime
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.identification.dataset import all_stretches, BagData, SurveyedBag, Unused
from tudor_dynamics.identification.many_bags import FoldModels
from tudor_dynamics.identification.next_steps import change_of, ErrorChange
from tudor_dynamics.identification.ringdowns import clear_ring, standstills
from tudor_dynamics.identification.settings import LEAST_SPREAD, SIGMAS
from tudor_dynamics.identification.validation import part_errors
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.elastic.model import PhysicalParameter
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.show.figures import label, panel, Plot, trace
from tudor_dynamics.show.page import rendered
from tudor_dynamics.typing import FloatArray


# -- What arms are compared by: friction, gravity, ring-downs; numbers with honest standard errors.
#
# Single base parameters trade off against each other (Coulomb against viscous friction, a mass
# against another one), differently in every motion. So arms are compared by what parameters come
# to together: the friction at a usual speed, what weight makes of an output over usual poses. Both
# are linear in the parameters. Residuals are coloured, and the standard errors of least squares
# too small; those here are of the jackknife over parts of the recordings (Kuensch, 1989).

POSES = 500  # poses at which weight is looked at
SLOW = 0.1  # of its largest speed, below which a joint counts as at rest
FEWEST_PARTS = 4  # parts of the data for a standard error
FEWEST_RINGS = 3  # ring-downs for one
WEIGHTLESS = 0.02  # of what an output measures, below which weight is nothing to compare by


@dataclass(frozen=True, eq=False)
class Measure:
    """Something that is linear in the parameters of a model."""

    name: str
    channel: str
    unit: str  # unit of its values
    weights: FloatArray  # of each coefficient, (channels, columns)

    def of(self, model: AnalyticalModel) -> float:
        """Give its value for a model."""
        return float(np.sum(self.weights * model.coefficients()))


@dataclass(frozen=True)
class Quantity:
    """A number of one arm at one date."""

    name: str
    channel: str
    unit: str
    value: float
    error: float  # standard error


def measures(
    arm: Arm, output: str, model: AnalyticalModel, bags: Sequence[BagData],
) -> list[Measure]:
    """Say what is compared of an output."""
    units = output_units(arm, output)
    q, dq = (np.vstack([getattr(s.states, name)[s.decimation.keep] for s in all_stretches(bags)])
             for name in ('q', 'dq'))
    poses = q[::max(1, len(q) // POSES)]
    still = np.zeros_like(poses)
    rest = model.regressor.rows(np.hstack([poses, still, still]))
    rest = rest - rest.mean(axis=0)  # zeros of gauges and drives are no weight
    weight = np.einsum('kcp,cp->kc', rest, model.coefficients())
    size = np.sqrt(np.mean(weight**2, axis=0))
    measured = np.vstack([s.decimation(getattr(s, output)) for s in all_stretches(bags)])
    found = []
    if output == 'effort':
        found = [_friction(arm, model, j, q.mean(axis=0), dq[:, j], units) for j in range(
            len(arm.joints)) if np.any(dq[:, j])]
    for i, channel in enumerate(model.channels):
        if size[i] > WEIGHTLESS * measured[:, i].std():
            weights = np.zeros(rest.shape[1:])
            weights[i] = weight[:, i] @ rest[:, i] / (size[i] * len(poses))
            found.append(Measure('weight', channel, units[channel], weights))
    return found


def _friction(
    arm: Arm, model: AnalyticalModel, joint: int, q: FloatArray, speed: FloatArray,
    units: Mapping[str, str],
) -> Measure:
    """Take half of the difference between both ways: friction alone turns with the speed."""
    usual = float(np.median(np.abs(speed)[np.abs(speed) > SLOW * np.abs(speed).max()]))
    motion = np.zeros((2, 3 * len(arm.joints)))
    motion[:, :len(q)] = q
    motion[:, len(q) + joint] = usual, -usual
    rows = model.regressor.rows(motion)
    weights = np.zeros(rows.shape[1:])
    weights[joint] = 0.5 * (rows[0, joint] - rows[1, joint])
    name = model.channels[joint]
    unit = 'm/s' if arm.is_prismatic(name) else 'rad/s'
    return Measure(f'friction at {usual:.2g} {unit}', name, units[name], weights)


def quantities(
    some: Sequence[Measure], model: AnalyticalModel, others: Sequence[AnalyticalModel],
) -> list[Quantity]:
    """Give the numbers of an arm at a date; None without enough parts for standard errors."""
    n = len(others)
    if n < FEWEST_PARTS:
        return []
    found = []
    for item in some:
        values = np.array([item.of(other) for other in others])
        error = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
        found.append(Quantity(item.name, item.channel, item.unit, item.of(model), error))
    return found


def rings(arm: Arm, bag: BagData) -> list[tuple[str, float, float]]:
    """Find oscillations [Hz] of gauges that die out while the joints stand still."""
    return [(name, mode.frequency, mode.damping)
            for stretch in bag.stretches if stretch.strain is not None
            for part in standstills(stretch.t, stretch.states.dq)
            for name, column in zip(arm.gauge_names, stretch.strain[part].T, strict=True)
            if (mode := clear_ring(column, bag.recording.dt)[1]) is not None]


def ring_quantities(measured: Sequence[tuple[str, float, float]]) -> list[Quantity]:
    """Sum up the ring-downs of an arm at a date."""
    found = []
    for gauge in dict.fromkeys(name for name, _, _ in measured):
        values = np.array([item[1:] for item in measured if item[0] == gauge])
        if len(values) < FEWEST_RINGS:
            continue
        middle = np.median(values, axis=0)
        spread = 1.4826 * np.median(np.abs(values - middle), axis=0)
        errors = 1.2533 * np.maximum(spread, 1e-6 * middle) / np.sqrt(len(values))
        found += [Quantity(name, gauge, unit, float(value), float(error)) for name, unit, value,
                  error in zip(('ring-down frequency', 'ring-down damping'), ('Hz', ''), middle,
                               errors, strict=True)]
    return found


def stiffness_quantities(physical: Sequence[PhysicalParameter]) -> list[Quantity]:
    """Take the stiffnesses of gears and links that were identified."""
    found = []
    for item in physical:
        if item.shown and kind_of(item.name).adds < 0:
            part, _, joint = item.name.rstrip(')').partition('(')
            found.append(Quantity(f'stiffness: {part}', joint, item.unit, item.value,
                                  item.standard_error))
    return found


# -- Has the model of a first date aged: its errors on later ones, and on parts left out

def aged(output: str, then: FoldModels, now: FoldModels) -> list[ErrorChange]:
    """Compare the errors of a model on a later date with those on the date that it is of."""
    old = [part_errors(then.others[fold], part) for fold, part in then.parts.items()]
    new = [part_errors(then.whole, part) for part in now.parts.values()]
    return [change_of((output, 'analytical', channel), *(
        (first[i], second[i]) for first, second in zip(_figures(old), _figures(new), strict=True)))
        for i, channel in enumerate(then.whole.channels)]


def _figures(parts: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give root mean square and relative error, and how uncertain the mean square is."""
    squares, power, n = np.stack(parts, axis=1)
    means = squares / n
    doubt = (means.std(axis=0, ddof=1) / np.sqrt(len(parts)) / np.maximum(
        means.mean(axis=0), 1e-300) if len(parts) > 1 else np.full(n.shape[1], 0.5))
    total = squares.sum(axis=0)
    return (np.sqrt(total / n.sum(axis=0)),
            np.sqrt(total / np.maximum(power.sum(axis=0), 1e-300)), doubt)


# -- Which arm is an outlier, and which one drifts: robust statistics with standard errors.
#
# An arm is compared with the median of the others, so that it has no hand in what it is compared
# with; their scatter is that of their median absolute deviation, wider where they are few. What
# differs by less than a tenth is nothing that anybody would mend, however certain it is.

RELEVANT = 0.1  # part of a quantity that a difference must be
OUTLIER_SIGMAS = 5.0
"""Standard errors that it must be: many numbers of many arms are looked at, and errors from few
parts are themselves uncertain. With it at most two of a hundred fleets of like arms name anybody
(test/fleet/test_unlike.py)."""
FEWEST_OTHERS = 3  # arms that an arm is compared with
FEWEST_DATES = 3  # dates that make a drift
FEW = 4.0
"""Widens the scatter of few arms: their median absolute deviation may be small by chance; checked
with OUTLIER_SIGMAS, by the same test."""


@dataclass(frozen=True, eq=False)
class History:
    """A quantity of one arm over time."""

    days: FloatArray  # time since the first date of the fleet, (dates,) [d]
    # Values with their standard errors, (dates,).
    values: FloatArray
    errors: FloatArray


@dataclass(frozen=True)
class Difference:
    """How far a number is from what was to be expected."""

    # The number; that of the other arms, or of the first date on the line through all.
    value: float
    expected: float
    sigmas: float  # their difference over its standard error
    named: bool  # whether it is large and certain enough to be named


def outliers(series: Sequence[History]) -> list[Difference | None]:
    """Compare the levels of arms; returns None where there are too few others."""
    scale, weights = day_scatter(series), [item.errors ** -2.0 for item in series]
    levels = np.array([own @ item.values / own.sum()
                       for own, item in zip(weights, series, strict=True)])
    errors = np.array([scale / np.sqrt(own.sum()) for own in weights])
    found: list[Difference | None] = []
    for i, (level, error) in enumerate(zip(levels.tolist(), errors.tolist(), strict=True)):
        others = np.delete(levels, i)
        n = len(others)
        if n < FEWEST_OTHERS:
            found.append(None)
            continue
        middle = float(np.median(others))
        # the median absolute deviation of few values is small by chance; not below their errors
        spread = max(1.4826 * float(np.median(np.abs(others - middle))),
                     float(np.median(np.delete(errors, i)))) * (1.0 + FEW / n)
        found.append(_difference(level, middle, float(np.hypot(error, spread)), abs(middle)))
    return found


def drifts(series: Sequence[History]) -> list[Difference | None]:
    """Look for arms that change over time; returns None where there are too few dates."""
    scale = day_scatter(series)
    found: list[Difference | None] = []
    for item in series:
        if len(item.days) < FEWEST_DATES:
            found.append(None)
            continue
        line, covariance = _line(item)
        first, last = np.polyval(line, item.days[[0, -1]]).tolist()
        error = float((item.days[-1] - item.days[0]) * np.sqrt(covariance[0, 0])) * scale
        found.append(_difference(last, first, error, abs(float(np.median(item.values)))))
    return found


def day_scatter(series: Sequence[History]) -> float:
    """Say how much more a quantity scatters from date to date than its standard errors say."""
    ratios = []
    for item in series:
        freedom = len(item.days) - 2
        if freedom < 1:
            continue
        line, _ = _line(item)
        left = (item.values - np.polyval(line, item.days)) / item.errors
        # median of chi squared over its mean (Wilson and Hilferty, 1931)
        usual = freedom * (1.0 - 2.0 / (9.0 * freedom)) ** 3
        ratios.append(float(left @ left) / usual)
    return float(np.sqrt(max(1.0, np.median(ratios)))) if ratios else 1.0


def _line(item: History) -> tuple[FloatArray, FloatArray]:
    """Fit slope and beginning of a line, with their covariance."""
    return np.polyfit(item.days, item.values, 1, w=1.0 / item.errors, cov='unscaled')


def _difference(value: float, expected: float, error: float, size: float) -> Difference:
    sigmas = (value - expected) / max(error, 1e-300)
    return Difference(value, expected, sigmas, abs(sigmas) > OUTLIER_SIGMAS
                      and abs(value - expected) > RELEVANT * size)


# -- What a fleet came to: numbers by arm and date, and which arms are named for what

WORDS = {'unlike': 'differs from the others', 'drift': 'drifts', 'aged': 'its model has aged'}
"""Kinds of what an arm is named for."""


@dataclass(frozen=True)
class Observation:
    """A number of an arm at a date."""

    arm: str
    date: datetime.date
    # What it was found in: `effort`, `strain`, `ring` of the strain at rest, or the `elastic`
    # model.
    output: str
    quantity: Quantity

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        item = self.quantity
        return {'arm': self.arm, 'date': self.date.isoformat(), 'output': self.output,
                'quantity': item.name, 'channel': item.channel, 'unit': item.unit,
                'value': item.value, 'standard_error': item.error}


@dataclass(frozen=True)
class Named:
    """Something that an arm is named for."""

    arm: str
    kind: str  # one of `WORDS`
    what: str  # quantity and channel
    unit: str
    # Its value; that of the other arms, of its first date, or of its validation.
    value: float
    expected: float
    sigmas: float  # their difference over its standard error

    def __str__(self) -> str:
        """Write it on one line."""
        reference = {'unlike': 'the others', 'drift': 'at first', 'aged': 'when it was new'}
        return (f'{self.arm}: {WORDS[self.kind]}: {self.what}: {self.value:.3g} {self.unit}, '
                f'{reference[self.kind]} {self.expected:.3g} ({self.sigmas:+.1f} standard errors)')


@dataclass(frozen=True, eq=False)
class Fleet:
    """A fleet that was fitted and compared."""

    name: str  # what it is called
    arms: tuple[str, ...]  # names of the arms
    seen: tuple[Observation, ...]  # all numbers, of each arm at each of its dates
    named: tuple[Named, ...]  # arms that are named, and what for
    choices: tuple[str, ...]  # what was chosen for all arms, in words
    models: dict[str, str]  # arm to the folder of its model, below that of the fleet
    unused: tuple[Unused, ...]  # bags, dates and models that were left out

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return {'name': self.name, 'arms': list(self.arms), 'models': self.models,
                'named': [asdict(item) for item in self.named],
                'quantities': [item.as_dict() for item in self.seen],
                'choices': list(self.choices), 'unused': [asdict(item) for item in self.unused]}


# -- Comparison of all arms: series of each quantity, and which arms are named

def parted(sights: Sequence[SurveyedBag], least: int) -> list[SurveyedBag]:
    """Divide few bags, so that there are enough parts for standard errors."""
    count = -(-least // len(sights))
    return list(sights) if count == 1 else [
        replace(sight, choice=sight.choice.within(i / count, (i + 1) / count))
        for sight in sights for i in range(count)]


def named_outliers(seen: Sequence[Observation]) -> list[Named]:
    """Compare each quantity of all arms."""
    start = min((item.date for item in seen), default=datetime.date.min)
    groups: dict[tuple[str, str, str, str], dict[str, list[Observation]]] = {}
    for item in seen:
        quantity = item.quantity
        if not 0.0 < quantity.error < float('inf'):
            continue
        key = item.output, quantity.name, quantity.channel, quantity.unit
        groups.setdefault(key, {}).setdefault(item.arm, []).append(item)
    found = []
    for (output, name, channel, unit), arms in groups.items():
        series = [History(*np.array([
            (float((item.date - start).days), item.quantity.value, item.quantity.error)
            for item in sorted(items, key=lambda item: item.date)]).T) for items in arms.values()]
        for kind, differences in (('unlike', outliers(series)), ('drift', drifts(series))):
            found += [Named(arm, kind, f'{name}, {channel} ({output})', unit, item.value,
                            item.expected, item.sigmas)
                      for arm, item in zip(arms, differences, strict=True)
                      if item is not None and item.named]
    return found


def named_aged(changes: Mapping[str, Sequence[ErrorChange]]) -> list[Named]:
    """Say whose model has aged: a motion that no model knows lets the errors of all arms grow."""
    found = []
    for same in zip(*changes.values(), strict=True):
        growth = [np.log(max(item.now / item.then, 1e-12)) for item in same]
        errors = [max(abs(value / item.sigmas), 1e-3) if item.sigmas else LEAST_SPREAD
                  for value, item in zip(growth, same, strict=True)]
        outlying = outliers([History(np.zeros(1), np.array([value]), np.array([error]))
                             for value, error in zip(growth, errors, strict=True)])
        for arm, change, other in zip(changes, same, outlying, strict=True):
            if change.changed and (other is None or other.sigmas > SIGMAS):
                found.append(Named(
                    arm, 'aged', f'relative error of {change.output}, {change.channel}', '',
                    change.relative_now, change.relative_then, change.sigmas))
    return found


# -- The page of a fleet: which arms are named, and each quantity of all arms over time

LOOKS = 6  # looks of arms that are named, in `templates/report.js`; those of others are grey
MOST = 200  # arms that a figure draws, besides those that are named


def page_of(fleet: Fleet) -> str:
    """Render the page."""
    groups: dict[str, list[Observation]] = {}
    for item in fleet.seen:
        quantity = item.quantity
        groups.setdefault(f'{quantity.name}, {quantity.channel} ({item.output})', []).append(item)
    figures = {title: _figure(title, items, list(dict.fromkeys(
        item.arm for item in fleet.named if item.what == title)))
        for title, items in groups.items()}
    dates = sorted({item.date for item in fleet.seen})
    return rendered('fleet', fleet=fleet, figures=figures, words=WORDS, dates=dates,
                    alike=len(fleet.arms) - len({item.arm for item in fleet.named}))


def _figure(title: str, items: Sequence[Observation], named: Sequence[str]) -> Plot:
    arms: dict[str, list[Observation]] = {}
    for item in sorted(items, key=lambda item: item.date):
        arms.setdefault(item.arm, []).append(item)
    others = [arm for arm in arms if arm not in named]
    traces = [trace(f'arm{named.index(arm) % LOOKS}' if arm in named else 'others',
                    [item.date.isoformat() for item in arms[arm]],
                    [item.quantity.value for item in arms[arm]],
                    arm if arm in named else 'the others', points=True,
                    error=np.array([item.quantity.error for item in arms[arm]]))
              for arm in [*others[:MOST], *named]]
    quantity = items[0].quantity
    return {'columns': 1, 'panels': [panel(
        '', '', label(quantity.name.partition(' at ')[0], quantity.unit), *traces)]}
