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

"""Velocities, efforts and strains that come late: by what lag they are explained best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.doctor.case import Case, gain
from tudor_dynamics.doctor.explained import share_of
from tudor_dynamics.doctor.structure import Alternative
from tudor_dynamics.doctor.thinned import Thinned
from tudor_dynamics.identification.finding import Finding
from tudor_dynamics.typing import FloatArray

LAGS = np.arange(-0.06, 0.1501, 0.01)
"""Tried [s]."""
LEAST = {'effort': 0.015, 'strain': 0.015, 'velocity': 0.03}
"""Smaller ones are the filters of drivers, which every arm has [s]."""
LEAST_GAIN = {'effort': 0.1, 'strain': 0.1, 'velocity': 0.5}
"""What is left has to become less by this sum of log ratios."""
EXPLAINED = 0.6
"""Relative residual that a lag leaves at most; where it leaves more, something else is wrong."""
KINDS = {'effort': 'effort_late', 'strain': 'strain_late', 'velocity': 'velocity_late'}
REMEDIES = {
    'effort': 'let the driver stamp efforts when they are measured, or take the efforts of the '
              'joint states',
    'strain': 'let the amplifier stamp strains when they are measured, not when they arrive',
    'velocity': 'leave them out with preprocessing.measured_velocity: false, or mend the '
                "driver's filter"}


@dataclass(frozen=True)
class Lag:
    """The lag that explains an output best."""

    seconds: float  # positive where the output comes late [s]
    gain: float  # by how much less it leaves, see `case.gain`
    # Relative residual without and with the lag.
    now: float
    otherwise: float


def best_lag(shares: Callable[[float], FloatArray]) -> Lag:
    """Search for the lag that leaves least."""
    values = [shares(float(lag)) for lag in LAGS]
    scores = np.array([float(np.sum(np.log(x))) for x in values])
    i = int(np.argmin(scores))
    seconds = float(LAGS[i])
    if 0 < i < len(LAGS) - 1:  # the vertex of the parabola through three
        before, here, after = scores[i - 1:i + 2]
        bend = before - 2.0 * here + after
        if bend > 0.0:
            seconds += float(0.5 * (before - after) / bend * (LAGS[1] - LAGS[0]))
    zero = shares(0.0)
    return Lag(seconds, gain(zero, values[i]), float(np.sqrt(zero.mean())),
               float(np.sqrt(values[i].mean())))


def output_lag(case: Case, name: str, chosen: Alternative) -> Lag:
    """Search for the lag of all efforts, or of all strains."""
    change = _change(case, name, chosen)

    def shares(lag: float) -> FloatArray:
        values = np.where(case.sound[name], case.thinned.output(name, lag), 0.0)
        return chosen.explained[name].shares(change(values))

    return best_lag(shares)


def _change(case: Case, name: str, chosen: Alternative) -> Callable[[FloatArray], FloatArray]:
    before, after = case.thinned.output(name), chosen.outputs[name]
    # scales and exchanges as a matrix, found from the samples
    sizes = np.maximum(np.sum(before ** 2, axis=0), 1e-300)
    products = before.T @ after
    fits = np.abs(products) / np.sqrt(sizes)[:, None]
    matrix = np.zeros_like(products)
    for j, i in enumerate(np.argmax(fits, axis=0)):
        matrix[i, j] = products[i, j] / sizes[i]
    return lambda values: values @ matrix


def velocity_lag(recording: Recording, thinned: Thinned) -> Finding | None:
    """
    Look for a lag of the driver's velocities behind the derivative of the positions.

    Returns None where there are none, or they come in time.
    """
    if not thinned.has('velocity'):
        return None
    n = thinned.motion.shape[1] // 3
    derivative = thinned.motion[:, n:2 * n]
    moves = np.std(derivative, axis=0) > 0.05 * float(np.std(derivative, axis=0).max())

    def shares(lag: float) -> FloatArray:
        values = thinned.output('velocity', lag)[:, moves]
        return share_of(values - derivative[:, moves], derivative[:, moves])

    return lag_told(recording, 'velocity', best_lag(shares), 1.0)


def lag_told(
    recording: Recording, name: str, lag: Lag, brevity: float,
) -> Finding | None:
    """
    Tell of a lag, where it is more than drivers usually have.

    Returns None where it comes in time.
    """
    if abs(lag.seconds) < LEAST[name] * np.sqrt(brevity) or lag.gain < LEAST_GAIN[name]:
        return None
    if lag.otherwise > EXPLAINED or not LAGS[0] < lag.seconds < LAGS[-1] - 1e-9:
        return None  # it is not the lag that the residual comes from
    kinds = {'effort': 'efforts', 'strain': 'strains', 'velocity': 'velocities'}
    way = 'late' if lag.seconds > 0.0 else 'early'
    size = round(lag.seconds, 4)
    return Finding(
        KINDS[name], f'{kinds[name]} come {abs(size) * 1e3:.0f} ms {way} against the positions',
        REMEDIES[name], recording.path, (), 0.0, size, 's', 'relative residual', lag.now,
        lag.otherwise)
