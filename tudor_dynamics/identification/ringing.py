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

"""Does the arm ring? The residual of a rigid-body model tells, and at which frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.models.base import Model
from tudor_dynamics.typing import FloatArray

LOWEST = 0.5
"""Below, the residual is the model's own error, not a vibration [Hz]."""
HALF_WIDTH = 0.2
"""Half width of a resonance, relative to its frequency: it moves with the pose."""
SMALLEST_SHARE = 0.5
"""Share of the residual's power above LOWEST that the resonance must have."""
SMALLEST_AMPLITUDE = 0.02
"""Rms of the resonance relative to the signal's standard deviation."""


@dataclass(frozen=True)
class Ringing:
    """A vibration found in a channel."""

    channel: str  # joint or gauge that rings
    frequency: float  # where the residual's power density peaks [Hz]
    rms: float  # root mean square of the band around it, in the channel's unit
    share: float  # its share of the residual's power above 0.5 Hz

    def __str__(self) -> str:
        """Say it in a sentence."""
        return (f'{self.channel} rings at {self.frequency:.2f} Hz with {self.rms:.3g} rms, '
                f'{100 * self.share:.0f} % of the residual above {LOWEST} Hz')


def power_density(
    x: FloatArray, rate: float, length: int,
) -> tuple[FloatArray, FloatArray]:
    """
    Estimate how the power of a record is distributed (Welch, IEEE Trans. AU 15(2), 1967).

    As scipy's `welch` does it: windows of Hann that overlap by half, without their means.

    x (samples, channels), rate [Hz]; returns frequency (frequencies,) [Hz] and density
    (frequencies, channels) [unit of x squared per Hz].
    """
    pieces = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)[::length - length // 2]
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    spectra = np.fft.rfft((pieces - pieces.mean(axis=-1, keepdims=True)) * window)
    density = (np.abs(spectra) ** 2).mean(axis=0).T / (rate * np.sum(window ** 2))
    density[1:(length + 1) // 2] *= 2.0  # all but 0 Hz and half the sample rate
    return np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64), density


def find_ringing(
    model: Model, data: Sequence[BagData], output: str,
) -> tuple[Ringing, ...]:
    """
    Look for a resonance in what a rigid-body model leaves over, at the full sample rate.

    Returns an empty tuple for a damped arm.
    """
    densities: list[FloatArray] = []
    seconds: list[float] = []
    spread: list[FloatArray] = []
    frequency: FloatArray | None = None
    for bag in data:
        rate = 1.0 / bag.recording.dt
        length = int(round(8.0 * rate))  # 1/8 Hz resolution
        at = model_for(model, bag)
        for s in bag.stretches:
            measured = getattr(s, output)
            if len(measured) < length:
                continue
            residual = measured - at.follow(s)
            grid, density = power_density(residual, rate, length)
            if frequency is None:
                frequency = grid
            if len(grid) != len(frequency):
                continue  # a bag of another rate
            densities.append(density)
            seconds.append(len(measured) / rate)
            spread.append(measured.std(axis=0))
    if frequency is None:
        return ()
    density = np.average(densities, axis=0, weights=seconds)
    deviation = np.average(spread, axis=0, weights=seconds)
    found = []
    above = frequency >= LOWEST
    step = frequency[1] - frequency[0]
    for i, channel in enumerate(model.channels):
        power = density[:, i] * step
        peak = float(frequency[above][np.argmax(power[above])])
        band = above & (np.abs(frequency - peak) <= HALF_WIDTH * peak)
        total = float(power[above].sum())
        inside_band = float(power[band].sum())
        rms, share = float(np.sqrt(inside_band)), inside_band / max(total, 1e-300)
        inside = LOWEST * 1.5 < peak < 0.8 * frequency[-1]
        if inside and share > SMALLEST_SHARE and rms > SMALLEST_AMPLITUDE * deviation[i]:
            found.append(Ringing(channel, peak, rms, share))
    return tuple(found)
