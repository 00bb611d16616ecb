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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.errors import FitError
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True)
class ChannelScore:
    """
    Figures of one channel.

    Attributes
    ----------
    rmse : float
        Root mean square error, in the unit of the output.
    fit : float
        ``100 (1 - |y - yhat| / |y - mean y|)`` [%]; NaN where the measured values never change.
    relative_error : float
        ``|y - yhat| / |y|``; NaN where the measured values are zero.
    moving_rmse, standing_rmse : float or None
        Root mean square error while the joint moves, and while it stands, in the unit of the
        output; None where it never does, or it is not known.

    """

    rmse: float
    fit: float
    relative_error: float
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


def _rms(error: FloatArray, some: NDArray[np.bool_] | None) -> float | None:
    """Root mean square of some samples; None where there are none."""
    if some is None or not some.any():
        return None
    return float(np.sqrt(np.mean(error[some] ** 2)))


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
    if measured.shape != predicted.shape or measured.ndim != 2 or not len(measured):
        msg = (f'measured has shape {measured.shape}, predicted {predicted.shape}; '
               'expected two equal shapes (n_samples, n_channels) with samples')
        raise FitError(msg)
    error = measured - predicted
    mean = measured.mean(axis=0)
    norm = np.linalg.norm
    sizes = norm(measured, axis=0)
    channels = {
        name: ChannelScore(
            rmse=float(np.sqrt(np.mean(error[:, i] ** 2))),
            fit=100.0 * (1.0 - _ratio(float(norm(error[:, i])),
                                      float(norm(measured[:, i] - mean[i])), float(sizes[i]))),
            relative_error=_ratio(float(norm(error[:, i])), float(sizes[i])),
            moving_rmse=_rms(error[:, i], None if moving is None else moving[:, i]),
            standing_rmse=_rms(error[:, i], None if moving is None else ~moving[:, i]))
        for i, name in enumerate(names)}
    total, size = float(norm(error)), float(norm(measured))
    return Score(
        samples=len(measured),
        rmse=float(np.sqrt(np.mean(error ** 2))),
        sigma_e=float(np.std(norm(error, axis=1))),
        fit=100.0 * (1.0 - _ratio(total, float(norm(measured - mean)), size)),
        fit_printed=100.0 * (1.0 - _ratio(total, float(norm(predicted - mean)), size)),
        relative_error=_ratio(total, size),
        channels=channels)
