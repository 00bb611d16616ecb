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
Frequencies and damping ratios of a free decay.

Matrix pencil method (Hua and Sarkar, IEEE Transactions on Acoustics, Speech and Signal Processing
38, 1990): the poles of a sum of damped oscillations are eigenvalues of a pair of Hankel matrices.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.errors import SignalError

MOST_SAMPLES = 600
"""The signal is averaged down to no more than this: the pencil costs the cube of it."""


@dataclass(frozen=True)
class RingMode:
    """One oscillation of a free decay."""

    frequency: float  # of the damped oscillation [Hz]
    damping: float  # damping ratio; negative where the oscillation grows
    amplitude: float  # at the first sample, in the unit of the signal


def ring_modes(
    signal: ArrayLike, dt: float, *, count: int = 2, highest: float = 25.0, lowest: float = 0.5,
) -> tuple[RingMode, ...]:
    """
    Find the strongest oscillations of a free decay.

    signal (samples,), dt [s], highest, lowest [Hz].
    """
    y = np.asarray(signal, dtype=float)
    if y.ndim != 1 or not np.isfinite(y).all():
        msg = f'a free decay must be one finite signal, found shape {y.shape}'
        raise SignalError(msg)
    every = max(int(1.0 / (6.0 * highest * dt)), -(-y.size // MOST_SAMPLES), 1)
    n = y.size // every
    if n < 12 * count:
        msg = (f'{y.size} samples at {1.0 / dt:g} Hz are too few to find {count} oscillations; '
               'record longer')
        raise SignalError(msg)
    y = y[:n * every].reshape(n, every).mean(axis=1)
    y = y - y[-n // 4:].mean()
    step = every * dt
    width = n // 3
    hankel = np.lib.stride_tricks.sliding_window_view(y, width + 1)
    _, values, vectors = np.linalg.svd(hankel, full_matrices=False)
    # Room for slow motion and for what else is there.
    order = min(2 * count + 6, int((values > 1e-9 * values[0]).sum()))
    signals = vectors[:order].T
    poles = np.linalg.eigvals(np.linalg.lstsq(signals[:-1], signals[1:], rcond=None)[0])
    basis = np.vander(poles, n, increasing=True).T
    weights = np.linalg.lstsq(basis, y.astype(complex), rcond=None)[0]
    found = []
    for pole, weight in zip(poles, weights, strict=True):
        if pole.imag <= 0.0 or pole == 0.0:
            continue
        s = np.log(pole) / step
        frequency = float(s.imag) / (2.0 * math.pi)
        if lowest <= frequency <= highest:
            energy = float(np.sum(np.abs(weight * pole ** np.arange(n)) ** 2))
            found.append((energy, RingMode(frequency, float(-s.real / abs(s)),
                                           2.0 * float(abs(weight)))))
    found.sort(key=lambda item: -item[0])
    return tuple(sorted((mode for _, mode in found[:count]), key=lambda mode: mode.frequency))
