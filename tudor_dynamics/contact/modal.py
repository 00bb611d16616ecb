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
The slow vibrations of an arm where it is, and what presses carried along with them, compiled.

Modes above a limit follow a force at once: they are taken as statics, so that no sample rate is
too low for them. The others are carried exactly over a sample, as oscillators under a constant
force.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled


@compiled
def slow_modes(small: NDArray, basis: NDArray, squares: NDArray, rates: NDArray) -> None:
    """
    Find the slowest modes, scaled to a mass of one.

    small (3, m, m); squares, rates (c,): result: squares of the frequencies [rad^2/s^2], and
    damping [1/s]; writes basis (m, c).
    """
    lower = np.linalg.cholesky(small[0])
    inverse = np.linalg.inv(lower)
    values, vectors = np.linalg.eigh(inverse @ small[2] @ inverse.T)
    count = squares.shape[0]
    basis[:] = (inverse.T @ vectors)[:, :count]
    for i in range(count):
        squares[i] = max(values[i], 1.0)
        shape = basis[:, i].copy()
        rates[i] = max(shape @ (small[1] @ shape), 0.0)


@compiled
def turn_basis(before: NDArray, mass: NDArray, now: NDArray, state: NDArray, covariance: NDArray,
               ) -> None:
    """
    Describe the same vibration by the modes of another pose.

    before, now (m, c), mass (m, m); writes state, covariance (2 c + k,).
    """
    c, n = before.shape[1], state.shape[0]
    change = now.T @ mass @ before
    whole = np.eye(n)
    whole[:c, :c] = change
    whole[c:2 * c, c:2 * c] = change
    state[:] = whole @ state
    covariance[:] = whole @ covariance @ whole.T


@compiled
def carry(
    state: NDArray, covariance: NDArray, squares: NDArray, rates: NDArray, white: NDArray,
    acting: NDArray, dt: float, noise: float, fade: float, rise: NDArray,
) -> None:
    """
    Carry state and covariance over one sample.

    squares, rates (c,), white (c, w), acting (c, k), dt [s], noise [N^2 s], rise (k, k).
    """
    c, k, n = squares.shape[0], acting.shape[1], state.shape[0]
    step, entering = np.zeros((n, n)), np.zeros((n, white.shape[1]))
    for i in range(c):
        slow = min(0.5 * rates[i], 0.95 * math.sqrt(squares[i]))
        swing = math.sqrt(squares[i] - slow * slow)
        decay = math.exp(-slow * dt)
        cosine, sine = decay * math.cos(swing * dt), decay * math.sin(swing * dt) / swing
        step[i, i], step[i, c + i] = cosine + slow * sine, sine
        step[c + i, i], step[c + i, c + i] = -squares[i] * sine, cosine - slow * sine
        place, speed = (1.0 - step[i, i]) / squares[i], sine
        for j in range(k):
            step[i, 2 * c + j], step[c + i, 2 * c + j] = place * acting[i, j], speed * acting[i, j]
        for j in range(white.shape[1]):
            entering[i, j], entering[c + i, j] = place * white[i, j], speed * white[i, j]
    for j in range(k):
        step[2 * c + j, 2 * c + j] = fade
    state[:] = step @ state
    covariance[:] = step @ covariance @ step.T + noise / dt * (entering @ entering.T)
    covariance[2 * c:, 2 * c:] += rise


@compiled
def correct(
    state: NDArray, covariance: NDArray, rows: NDArray, variance: NDArray, measured: NDArray,
    trusted: float,
) -> float:
    """
    Correct a state by what gauges show beyond the model.

    rows (gauges, n), variance (gauges,) [N^2 m^2]; measured (gauges,) [N m]: NaN for a gauge that
    does not count.
    """
    n, likely = state.shape[0], 0.0
    # one gauge after the other: their noise is independent
    for g in range(measured.shape[0]):
        if math.isnan(measured[g]):
            continue
        row = covariance @ rows[g]
        spread = variance[g] + rows[g] @ row
        left = measured[g] - rows[g] @ state
        size = abs(left) / math.sqrt(spread)
        cut = min(size, trusted)
        likely -= cut * (size - 0.5 * cut) + 0.5 * math.log(2.0 * math.pi * spread)
        for i in range(n):
            state[i] += row[i] / spread * left
            for j in range(n):
                covariance[i, j] -= row[i] * row[j] / spread
    for i in range(n):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
    return likely
