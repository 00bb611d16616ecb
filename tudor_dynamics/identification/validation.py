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

"""Validation on unseen motion: metrics, noise, verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from enum import Enum
from functools import reduce
import math
import operator
from typing import Any
import warnings

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import FitError, TudorWarning
from tudor_dynamics.identification.dataset import BagData, model_for
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.estimation import Products, rescaled, squared_residuals
from tudor_dynamics.signals.preprocessing import noise_gain
from tudor_dynamics.typing import finite_array, FloatArray, Shown


# -- Figures by which predictions are judged, per channel and over all channels.
#
# *Fit* is everywhere ``100 (1 - |y - yhat| / |y - mean y|)``. What Malzahn et al. call fit has the
# predictions in the denominator; it is called by the number of their equation, Eq. (18).

@dataclass(frozen=True)
class ChannelScore:
    """Figures of one channel."""

    rmse: float  # root mean square error, in the unit of the output
    fit: float  # `100 (1 - |y - yhat| / |y - mean y|)` [%]; NaN if y never changes
    relative_error: float  # `|y - yhat| / |y|`; NaN where the measured values are zero
    # Root mean square error while the joint moves, and while it stands, in the unit of the output;
    # None where it never does, or it is not known.
    moving_rmse: float | None = None
    standing_rmse: float | None = None


@dataclass(frozen=True, repr=False)
class Score(Shown):
    """Figures over all channels of an output; NaN where no channel changes."""

    samples: int  # number of samples
    rmse: float  # root of the mean square over samples and channels, in the unit of the output
    # Standard deviation over the samples of the Euclidean norm of the error. That of Malzahn et
    # al., Table I, is unknown: for strain it exceeds the RMSE up to 1.52 times, which neither a
    # pooled standard deviation nor this one, at most sqrt(2) for two channels, can.
    sigma_e: float
    fit: float  # `100 (1 - |y - yhat| / |y - mean y|)`, the mean per channel, norms over all [%]
    fit_printed: float  # Eq. (18) as printed, `|yhat - mean y|` in the denominator [%]
    relative_error: float  # `|y - yhat| / |y|`
    channels: dict[str, ChannelScore]

    def as_dict(self) -> dict[str, Any]:
        """Give the figures as JSON-ready dictionary."""
        return asdict(self)


def _ratio(error: float, reference: float, size: float = 0.0) -> float:
    """Error relative to a reference; that of a constant signal of some size is only rounding."""
    return error / reference if reference > 1e-12 * size else float('nan')


@dataclass(frozen=True, eq=False)
class Tally:
    """What figures need of a prediction: sums, which those of several recordings add up to."""

    n: int  # number of samples
    mean: FloatArray  # of what was measured and what was predicted, in their units, (2, channels)
    spread: FloatArray  # squares about these means, summed, (2, channels)
    error: FloatArray  # squared errors, summed, (channels,)
    # Mean of the Euclidean norm of the error; squares about it, summed.
    length: float
    length_spread: float
    # (3, channels): samples at which the joint moves; squared errors of these, and of those at
    # which it stands, summed; None where unknown.
    moving: FloatArray | None

    def __add__(self, other: Tally) -> Tally:
        """Join two predictions (Chan, Golub and LeVeque, 1983, eq. 1.5)."""
        n = self.n + other.n
        part, both = other.n / n, self.n * other.n / n

        def mean(one: Any, two: Any) -> Any:
            return one + part * (two - one)

        def spread(one: Any, two: Any, one_mean: Any, two_mean: Any) -> Any:
            return one + two + both * (two_mean - one_mean) ** 2

        return Tally(
            n, mean(self.mean, other.mean),
            spread(self.spread, other.spread, self.mean, other.mean),
            self.error + other.error, mean(self.length, other.length),
            spread(self.length_spread, other.length_spread, self.length, other.length),
            None if self.moving is None or other.moving is None else self.moving + other.moving)

    def score(self, names: Sequence[str]) -> Score:
        """Give the figures."""
        (mean, predicted_mean), (spread, predicted_spread) = self.mean, self.spread
        squares = spread + self.n * mean**2
        printed = predicted_spread + self.n * (predicted_mean - mean) ** 2
        moves, moved, stood = (np.zeros((3, len(names))) if self.moving is None else self.moving)
        stands = self.n - moves if self.moving is not None else moves
        channels = {
            name: ChannelScore(
                rmse=math.sqrt(self.error[i] / self.n),
                fit=_fit(self.error[i], spread[i], squares[i]),
                relative_error=_ratio(math.sqrt(self.error[i]), math.sqrt(squares[i])),
                moving_rmse=math.sqrt(moved[i] / moves[i]) if moves[i] else None,
                standing_rmse=math.sqrt(stood[i] / stands[i]) if stands[i] else None)
            for i, name in enumerate(names)}
        error, square = float(self.error.sum()), float(squares.sum())
        return Score(
            samples=self.n, rmse=math.sqrt(error / self.n / len(names)),
            sigma_e=math.sqrt(self.length_spread / self.n),
            fit=_fit(error, float(spread.sum()), square),
            fit_printed=_fit(error, float(printed.sum()), square),
            relative_error=_ratio(math.sqrt(error), math.sqrt(square)), channels=channels)


def _fit(error: float, spread: float, square: float) -> float:
    return 100.0 * (1.0 - _ratio(math.sqrt(error), math.sqrt(spread), math.sqrt(square)))


def tally(
    measured: FloatArray, predicted: FloatArray, moving: NDArray[np.bool_] | None = None,
) -> Tally:
    """Sum up a prediction (samples, channels), all of it and where joints are ``moving``."""
    if measured.shape != predicted.shape or measured.ndim != 2 or not len(measured):
        raise FitError(f'measured has shape {measured.shape}, predicted {predicted.shape}; '
                       'expected two equal shapes (n_samples, n_channels) with samples')
    squares = (measured - predicted) ** 2
    length, n = np.sqrt(squares.sum(axis=1)), len(measured)
    both = np.stack([measured, predicted])
    return Tally(
        n, both.mean(axis=1), n * both.var(axis=1), squares.sum(axis=0), float(length.mean()),
        n * float(length.var()), None if moving is None else np.array(
            [moving.sum(axis=0), np.where(moving, squares, 0.0).sum(axis=0),
             np.where(moving, 0.0, squares).sum(axis=0)]))


def score(
    measured: FloatArray, predicted: FloatArray, names: Sequence[str],
    moving: NDArray[np.bool_] | None = None,
) -> Score:
    """
    Judge a prediction.

    Parameters
    ----------
    measured, predicted : ndarray of shape (n_samples, n_channels)
        Outputs in their units.
    names : sequence of str
        Names of the channels.
    moving : ndarray of bool, shape (n_samples, n_channels), optional
        Whether the joint of each channel moves.

    Returns
    -------
    Score
        Figures per channel and over all.

    Raises
    ------
    FitError
        If shapes differ or there is no sample.
    SignalError
        If a value is no finite number.

    """
    found = tally(measured, predicted, moving)
    for name, values in (('measured', measured), ('predicted', predicted)):
        finite_array(values, name, None, len(names))
    return found.score(names)


def rounded(score: Score, digits: int = 6) -> dict[str, Any]:
    """Give a score as plain values without digits that mean nothing."""
    def shorten(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: shorten(item) for key, item in value.items()}
        return float(f'{value:.{digits}g}') if isinstance(value, float) else value
    return dict(shorten(score.as_dict()))


# -- Errors of an analytical model on a part of the data, from what that part came to alone

def part_errors(model: AnalyticalModel, part: list[list[Products]]) -> FloatArray:
    """Judge a model by products: squared errors, squared outputs, samples, (3, channels)."""
    found = np.zeros((3, len(model.channels)))
    for group, products in zip(model.groups_, part, strict=True):
        for i, (channel, own) in enumerate(zip(group.base.channels, products, strict=True)):
            scaled = own
            if group.constants is not None:
                scaled = rescaled(own, model.regressor.scaled[group.base.kept],
                                  group.constants.values[i])
            found[:, channel] = (squared_residuals(scaled, group.estimate.parameters),
                                 scaled.gram[-1, -1], own.n)
    return found


# -- What no model can explain: the noise of the sensors, after the filters of a fit

ORDER = 5  # differences that leave nothing of a motion, and all of white noise
NORMAL = 0.6827  # share of a normal distribution within one standard deviation


def noise_floor(data: Sequence[BagData], output: str, spec: PreprocessingSpec) -> FloatArray:
    """Estimate the noise that the samples of a validation have."""
    # white noise alone is seen: what is smooth from sample to sample, such as hum or a sensor with
    # a filter of its own, is not, so that the floor is a lower bound
    # what a difference makes of white noise: binomial coefficients, squared and summed
    scale = math.sqrt(math.comb(2 * ORDER, ORDER))
    found = []
    for bag in data:
        raw = getattr(bag.recording, output)
        for s in bag.stretches:
            first = int(np.searchsorted(bag.recording.stamp, s.stamp[0]))
            differences = np.diff(raw[first:first + len(s.t)], ORDER, axis=0)
            if not len(differences):
                continue
            found.append(noise_gain(s, spec) * np.quantile(
                np.abs(differences), NORMAL, axis=0) / scale)
    return np.median(found, axis=0) if found else np.zeros(0)


# -- Validation: errors of a model on motion that it has not seen.
#
# By whole bag, as Malzahn et al. do by whole stimuli: the samples of one bag are neighbours in
# time, so that leaving out single samples at random shows a model nearly the same samples twice.

STANDING = 0.02  # slower joints stand [rad/s or m/s]
SLOW = 0.05  # the same as a share of the largest speed, where that is less


Case = tuple[Model, BagData]  # a bag with the model that is to predict it


@dataclass(frozen=True, eq=False, repr=False)
class Trace(Shown):
    """Measured against predicted output of one bag, at the samples used."""

    bag: str  # bag, or part of one
    t: FloatArray  # time since the start of the bag, (samples,) [s]
    stamp: NDArray[np.int64]  # header stamps, (samples,) [ns]
    # Outputs in their units, (samples, channels).
    measured: FloatArray
    predicted: FloatArray
    moving: NDArray[np.bool_] | None = None  # (samples, channels), of a strain any joint

    @property
    def residual(self) -> FloatArray:
        """Measured minus predicted, (samples, channels)."""
        return self.measured - self.predicted

    def tally(self) -> Tally:
        """Sum up the prediction for figures over several bags."""
        return tally(self.measured, self.predicted, self.moving)


@dataclass(frozen=True, eq=False)
class Validation(Shown):
    """Result of a validation of one model for one output."""

    method: str  # how it was done, in words
    score: Score  # figures over all samples of all bags
    traces: tuple[Trace, ...]  # one for each bag
    channels: tuple[str, ...]  # names of the channels
    cases: tuple[Case, ...] = ()

    def __repr__(self) -> str:
        """Write how it was done, and the fit of each channel."""
        channels = ', '.join(f'{name} {shown_fit(item.fit):.1f} %'
                             for name, item in self.score.channels.items())
        return f'Validation by {self.method}: fit {shown_fit(self.score.fit):.1f} % ({channels})'


def trace(model: Model, data: BagData, output: str) -> Trace:
    """Predict an output over a bag; nothing but motion goes into the model."""
    if model.has_memory and not data.has('strain') and any(
            s.past_unknown for s in data.stretches):
        warnings.warn(f'{data.choice} begins in motion, or goes on so after a gap, without strain:'
                      ' an elastic model is judged too low, as its links may oscillate there; '
                      'judge by bags with strain, or from standstill', TudorWarning, stacklevel=1)
    parts = [(s.t[s.decimation.keep], s.stamp[s.decimation.keep],
              s.decimation(getattr(s, output)), model.follow_kept(s),
              np.abs(s.states.dq[s.decimation.keep]))
             for s in data.stretches]
    t, stamp, measured, predicted, speed = (
        np.concatenate(column) for column in zip(*parts, strict=True))
    # a slow arm moves too: its own largest speed is the measure
    moving = speed > np.minimum(STANDING, SLOW * speed.max(axis=0))
    if output != 'effort':
        moving = np.repeat(moving.any(axis=1)[:, None], measured.shape[1], axis=1)
    return Trace(str(data.choice), t, stamp, measured, predicted, moving)


def cases_of(model: Model, data: Sequence[BagData]) -> list[Case]:
    """Let a fitted model predict bags, each with its own payload."""
    return [(model_for(model, bag), bag) for bag in data]


def validated(cases: Sequence[Case], output: str, method: str) -> Validation:
    """Judge bags by the model that is to predict each of them."""
    traces = tuple(trace(model, bag, output) for model, bag in cases)
    channels = cases[0][0].channels
    return Validation(method, reduce(operator.add, (item.tally() for item in traces)).score(
        channels), traces, channels, tuple(cases))


def method_of(tests: Sequence[str], bags: int, groups: int) -> str:
    """Say how a model is judged: by test bags, or by groups of bags that are left out."""
    if tests:
        return f'test bag {tests[0]}' if len(tests) == 1 else f'{len(tests)} test bags'
    return (f'leave one bag out, {bags} bags' if groups == bags else
            f'leave one of {groups} {"groups" if groups < bags else "parts"} of bags out, '
            f'{bags} bags')


# -- A verdict in words: may this model be used to predict, and why

GOOD_FIT = 85.0
USABLE_FIT = 60.0
USABLE_ERROR = 15.0
"""Relative error up to which a model is of use where the output hardly varies [%]."""
NOISE_LIMITED = 1.25  # times the noise of the sensor up to which no model does much better
LARGEST_CONDITION = 1e4
LARGEST_GAP = 10.0


class Grade(Enum):
    """How far a model can be trusted."""

    GOOD = 'good'
    USABLE = 'usable'
    DO_NOT_USE = 'do not use'


@dataclass(frozen=True)
class Verdict:
    """A level and its reasons."""

    level: Grade  # how far the model can be trusted
    reasons: tuple[str, ...] = field(default=())  # the first names the decisive figure
    channels: dict[str, Grade] = field(default_factory=dict)  # the same of each channel

    def __str__(self) -> str:
        """Write level and reasons on one line."""
        return f'{self.level.value}: {"; ".join(self.reasons)}'


def shown_fit(fit: float, digits: int = 1) -> float:
    """Round a fit as all pages and tables do [%]: not over a bound that it does not reach."""
    found = round(fit, digits)
    return found - 10.0**-digits * any(fit < bound <= found for bound in (USABLE_FIT, GOOD_FIT))


def level_of(score: Score | ChannelScore, noise: float = 0.0) -> Grade:
    """Judge figures; noise [unit of the output]: 0 where it is not known."""
    if score.fit >= GOOD_FIT:
        return Grade.GOOD
    limited = noise > 0.0 and score.rmse <= NOISE_LIMITED * noise
    if score.fit >= USABLE_FIT:
        return Grade.GOOD if limited else Grade.USABLE
    if 100.0 * score.relative_error <= USABLE_ERROR:
        return Grade.USABLE
    return Grade.DO_NOT_USE


def judge(
    validation: Validation, training_fit: float, *, condition: float = 1.0,
    unexcited: Sequence[str] = (), noise: Sequence[float] = (),
) -> Verdict:
    """Judge a model by validation, training fit [%], and noise in its unit, empty if unknown."""
    scores = validation.score.channels
    floors = dict(zip(scores, noise, strict=True)) if len(noise) else dict.fromkeys(scores, 0.0)
    still = [name for name, item in scores.items() if math.isnan(item.fit)]
    dead = (f'{", ".join(still)} never changed on {validation.method}: a dead sensor has no fit; '
            f'do not use {"this channel" if len(still) == 1 else "these channels"}')
    if len(still) == len(scores):
        return Verdict(Grade.DO_NOT_USE, (dead,), dict.fromkeys(scores, Grade.DO_NOT_USE))
    levels = {name: Grade.DO_NOT_USE if name in still else level_of(item, floors[name])
              for name, item in scores.items()}
    total = math.sqrt(sum(floor**2 for floor in floors.values()) / len(floors))
    level = level_of(validation.score, total)
    fit = max(validation.score.fit, -1e6)
    bound = (f'>= {GOOD_FIT:g}' if fit >= GOOD_FIT else
             f'usable: {USABLE_FIT:g} to {GOOD_FIT:g}' if fit >= USABLE_FIT else
             f'< {USABLE_FIT:g}')
    reasons = [f'fit {shown_fit(fit):.1f} % ({bound}) on {validation.method}, relative error '
               f'{100.0 * validation.score.relative_error:.1f} %']
    reasons += [f'{name}: its error of {item.rmse:.3g} is near the noise of {floors[name]:.3g}, '
                'no model does much better' for name, item in scores.items()
                if name not in still and item.rmse <= NOISE_LIMITED * floors[name]]
    doubts = [dead] if still else []
    order = list(Grade)
    doubts += [f'channel {name} alone has {shown_fit(scores[name].fit):.1f} %, relative error '
               f'{100.0 * scores[name].relative_error:.0f} %: '
               f'{"do not use it" if levels[name] is Grade.DO_NOT_USE else "usable"}'
               for name in sorted(scores, key=lambda key: scores[key].fit)
               if name not in still and order.index(levels[name]) > order.index(level)]
    if training_fit - validation.score.fit > LARGEST_GAP:
        doubts.append(f'{training_fit - max(validation.score.fit, -1e6):.0f} points below '
                      'training: fit to more bags, with other motion')
    if unexcited:
        shown = ', '.join(unexcited[:3]) + (' ...' if len(unexcited) > 3 else '')
        doubts.append(f'the motion does not excite {shown}: trust it on similar motion only')
    elif condition > LARGEST_CONDITION:
        doubts.append(f'condition number {condition:.0f}: richer motion would pin the parameters')
    if level is Grade.GOOD and any(not text.endswith(': usable') for text in doubts):
        level = Grade.USABLE
    return Verdict(level, tuple(reasons + doubts), levels)
