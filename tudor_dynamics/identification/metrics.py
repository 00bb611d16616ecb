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
Figures by which predictions are judged, per channel and over all channels.

*Fit* is everywhere ``100 (1 - |y - yhat| / |y - mean y|)``. What Malzahn et al. call fit has the
predictions in the denominator; it is called by the number of their equation, Eq. (18).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import FitError
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class ChannelScore:
    """Figures of one channel."""

    rmse: float  # root mean square error, in the unit of the output
    # `100 (1 - |y - yhat| / |y - mean y|)` [%]; NaN where the measured values never change.
    fit: float
    relative_error: float  # `|y - yhat| / |y|`; NaN where the measured values are zero
    # Root mean square error while the joint moves, and while it stands, in the unit of the output;
    # None where it never does, or it is not known.
    moving_rmse: float | None = None
    standing_rmse: float | None = None


@dataclass(frozen=True)
class Score:
    """
    Figures over all channels of an output.

    Attributes
    ----------
    samples : int
        Number of samples.
    rmse : float
        Root of the mean square over samples and channels, in the unit of the output.
    sigma_e : float
        Standard deviation over the samples of the Euclidean norm of the error. That of Malzahn
        et al., Table I, is unknown: for strain it exceeds the RMSE up to 1.52 times, which
        neither a pooled standard deviation nor this one, at most sqrt(2) for two channels, can.
    fit : float
        ``100 (1 - |y - yhat| / |y - mean y|)``, the mean per channel, norms over all channels [%].
        NaN where no channel changes.
    fit_printed : float
        Eq. (18) of Malzahn et al. as printed, ``|yhat - mean y|`` in the denominator [%].
    relative_error : float
        ``|y - yhat| / |y|``.
    channels : dict of str to ChannelScore
        Figures of each channel.

    """

    samples: int
    rmse: float
    sigma_e: float
    fit: float
    fit_printed: float
    relative_error: float
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
    # Means of what was measured and predicted, in their units, (channels,).
    mean: FloatArray
    predicted_mean: FloatArray
    # Squares about these means, summed, (channels,).
    spread: FloatArray
    predicted_spread: FloatArray
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
            n, mean(self.mean, other.mean), mean(self.predicted_mean, other.predicted_mean),
            spread(self.spread, other.spread, self.mean, other.mean),
            spread(self.predicted_spread, other.predicted_spread, self.predicted_mean,
                   other.predicted_mean),
            self.error + other.error, mean(self.length, other.length),
            spread(self.length_spread, other.length_spread, self.length, other.length),
            None if self.moving is None or other.moving is None else self.moving + other.moving)

    def score(self, names: Sequence[str]) -> Score:
        """Give the figures."""
        squares = self.spread + self.n * self.mean**2
        printed = self.predicted_spread + self.n * (self.predicted_mean - self.mean) ** 2
        moves, moved, stood = (np.zeros((3, len(names))) if self.moving is None else self.moving)
        stands = self.n - moves if self.moving is not None else moves
        channels = {
            name: ChannelScore(
                rmse=math.sqrt(self.error[i] / self.n),
                fit=_fit(self.error[i], self.spread[i], squares[i]),
                relative_error=_ratio(math.sqrt(self.error[i]), math.sqrt(squares[i])),
                moving_rmse=math.sqrt(moved[i] / moves[i]) if moves[i] else None,
                standing_rmse=math.sqrt(stood[i] / stands[i]) if stands[i] else None)
            for i, name in enumerate(names)}
        error, square = float(self.error.sum()), float(squares.sum())
        return Score(
            samples=self.n, rmse=math.sqrt(error / self.n / len(names)),
            sigma_e=math.sqrt(self.length_spread / self.n),
            fit=_fit(error, float(self.spread.sum()), square),
            fit_printed=_fit(error, float(printed.sum()), square),
            relative_error=_ratio(math.sqrt(error), math.sqrt(square)), channels=channels)


def _fit(error: float, spread: float, square: float) -> float:
    return 100.0 * (1.0 - _ratio(math.sqrt(error), math.sqrt(spread), math.sqrt(square)))


def tally(
    measured: FloatArray, predicted: FloatArray, moving: NDArray[np.bool_] | None = None,
) -> Tally:
    """
    Sum up a prediction.

    measured, predicted (samples, channels) [its unit], moving (samples, channels).
    """
    if measured.shape != predicted.shape or measured.ndim != 2 or not len(measured):
        msg = (f'measured has shape {measured.shape}, predicted {predicted.shape}; '
               'expected two equal shapes (n_samples, n_channels) with samples')
        raise FitError(msg)
    squares = (measured - predicted) ** 2
    length = np.sqrt(squares.sum(axis=1))
    return Tally(
        len(measured), measured.mean(axis=0), predicted.mean(axis=0), _about_mean(measured),
        _about_mean(predicted), squares.sum(axis=0), float(length.mean()),
        float(_about_mean(length)), None if moving is None else np.array(
            [moving.sum(axis=0), np.where(moving, squares, 0.0).sum(axis=0),
             np.where(moving, 0.0, squares).sum(axis=0)]))


def _about_mean(values: FloatArray) -> FloatArray:
    return np.asarray(np.sum((values - values.mean(axis=0)) ** 2, axis=0))


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

    """
    return tally(measured, predicted, moving).score(names)


def rounded(score: Score, digits: int = 6) -> dict[str, Any]:
    """Give a score as plain values without digits that mean nothing."""
    def shorten(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: shorten(item) for key, item in value.items()}
        return float(f'{value:.{digits}g}') if isinstance(value, float) else value
    return dict(shorten(score.as_dict()))
