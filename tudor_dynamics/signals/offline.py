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

"""A zero-phase alternative to the causal filters, for recordings."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import FilteredStates
from tudor_dynamics.signals.sections import butterworth, forward_backward, low_pass_sections
from tudor_dynamics.typing import FloatArray


def zero_phase(
    t: FloatArray,
    q: FloatArray,
    cutoff: float,
    measured: FloatArray | None = None,
) -> FilteredStates:
    """
    Differentiate a record without phase lag: Butterworth forward and backward, then central.

    Fourth order, see Gautier, Janot and Vandanjon, IEEE TCST 21(2), 2013, Section II.C. Stamps
    with jitter are brought to a uniform grid and back.

    t (samples,) [s], q (samples, joints) [rad or m], cutoff [Hz]; writes measured
    (samples, joints).
    """
    n = len(t)
    if n < 32:
        msg = f'{n} samples are too few for a zero-phase filter; expected 32 or more'
        raise SignalError(msg)
    dt = float(t[-1] - t[0]) / (n - 1)
    if not 0 < cutoff < 0.5 / dt:
        msg = (f'cut-off {cutoff} Hz; expected between 0 and half the sample rate, '
               f'{0.5 / dt:.4g} Hz')
        raise SignalError(msg)
    sections = low_pass_sections(butterworth(4), cutoff * dt)
    grid = t[0] + dt * np.arange(n)
    uniform = bool(np.max(np.abs(grid - t)) < 1e-3 * dt)

    def smooth(x: FloatArray) -> FloatArray:
        even = x if uniform else _interpolate(grid, t, x)
        return forward_backward(sections, even, min(n - 1, max(27, int(3.0 / (cutoff * dt)))))

    def back(x: FloatArray) -> FloatArray:
        return x if uniform else _interpolate(t, grid, x)

    smooth_q = smooth(q)
    dq = derivative(smooth_q, dt) if measured is None else smooth(measured)
    ddq = derivative(dq, dt)
    return FilteredStates(back(smooth_q), back(dq), back(ddq))


def derivative(x: FloatArray, dt: float) -> FloatArray:
    """
    Differentiate by central differences of fourth order.

    Those of second order make all accelerations of a motion of 2 Hz at 100 Hz too small by 0.26 %,
    and inertias too large by as much: several standard errors, where these are small. Here it is
    0.001 %.

    x (samples, ...), dt [s].
    """
    slope = np.gradient(x, dt, axis=0)
    slope[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * dt)
    return np.asarray(slope)


def _interpolate(new: FloatArray, old: FloatArray, x: FloatArray) -> FloatArray:
    return np.stack([np.interp(new, old, x[:, i]) for i in range(x.shape[1])], axis=1)
