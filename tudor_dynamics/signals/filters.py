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

"""Filters: causal differentiation, zero-phase low-passes, and ring-down analysis."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals import settings
from tudor_dynamics.typing import FloatArray, Shown


# Low-passes of even order as sections of second order, run forward and backward over a record: the
# filters of scipy's `butter`, `cheby1` and `sosfiltfilt` (test/signals/test_sections.py). They are
# here because they take most of the time of a fit to many bags, and scipy takes 5 times as long
# (bench/filters.py: ratio 4.7 for 7 columns, 4.9 for 64). To import `scipy.signal` would also take
# half of the time in which a command starts.

Poles = NDArray[np.complex128]


def butterworth(order: int) -> Poles:
    """Give the poles (order / 2,) of a Butterworth low-pass with its corner at 1 rad/s."""
    return np.exp(0.5j * np.pi * (1.0 + (2.0 * np.arange(order // 2) + 1.0) / order))


def chebyshev(order: int, ripple: float) -> Poles:
    """Give the poles (order / 2,) of a Chebyshev low-pass (I, ripple [dB]), corner at 1 rad/s."""
    flat = np.arcsinh(1.0 / np.sqrt(10.0 ** (0.1 * ripple) - 1.0)) / order
    return -np.sinh(flat + 0.5j * np.pi * (2.0 * np.arange(order // 2) + 1.0) / order)


def low_pass_sections(poles: Poles, cutoff: float) -> FloatArray:
    """Make discrete sections (n, 3) of a low-pass's poles, by the bilinear transform."""
    continuous = np.tan(np.pi * cutoff) * poles
    discrete = (1.0 + continuous) / (1.0 - continuous)
    # |1 - discrete|^2 / 4 without the difference of numbers that are nearly the same
    gain = np.abs(continuous / (1.0 - continuous)) ** 2
    return np.column_stack([gain, -2.0 * discrete.real, np.abs(discrete) ** 2])


def forward_backward(sections: FloatArray, x: FloatArray, pad: int) -> FloatArray:
    """Filter a record without delay: forward, then backward, begun at rest where it begins."""
    y = np.concatenate([2.0 * x[:1] - x[pad:0:-1], x, 2.0 * x[-1:] - x[-2:-pad - 2:-1]])
    _run(sections, y, False)
    _run(sections, y, True)
    return y[pad:len(y) - pad]


@compiled
def _run(sections: FloatArray, x: FloatArray, backward: bool) -> None:
    """Filter all columns in place, from one end to the other; the innermost loop is vectorised."""
    samples, channels = x.shape
    first, step = (samples - 1, -1) if backward else (0, 1)
    state = np.empty((len(sections), 2, channels))
    for section in range(len(sections)):
        gain, a2 = sections[section, 0], sections[section, 2]
        for i in range(channels):  # as if the first sample had been there for ever
            state[section, 0, i] = (1.0 - gain) * x[first, i]
            state[section, 1, i] = (gain - a2) * x[first, i]
    for k in range(samples):
        row = x[first + step * k]
        for section in range(len(sections)):
            gain, a1, a2 = sections[section, 0], sections[section, 1], sections[section, 2]
            near, far = state[section, 0], state[section, 1]
            for i in range(channels):
                scaled = gain * row[i]
                y = scaled + near[i]
                near[i] = 2.0 * scaled - a1 * y + far[i]
                far[i] = scaled - a2 * y
                row[i] = y


# The papers' causal differentiation filter is one object for all uses: fed sample by sample next
# to the robot, or with a whole record offline, it gives the same numbers.

@dataclass(frozen=True, eq=False, repr=False)
class MotionState(Shown):
    """Positions with their derivatives, at an instant (joints,) or one row a sample."""

    q: FloatArray  # positions of the joints [rad or m]
    dq: FloatArray  # velocities of the joints [rad/s or m/s]
    ddq: FloatArray  # accelerations of the joints [rad/s^2 or m/s^2]

    @property
    def motion(self) -> FloatArray:
        """All of it side by side, as regressors take it."""
        return np.hstack([self.q, self.dq, self.ddq])


@compiled
def low_pass_gain(cutoff: float, dt: float) -> float:
    """Give the gain of a discrete first-order low-pass with the pole of the continuous one."""
    # `y[k] = y[k-1] + gain (x[k] - y[k-1])`; exact for any sample time, so also for a varying one.
    return -math.expm1(-2.0 * math.pi * cutoff * dt)


def low_pass(x: FloatArray, dt: FloatArray, cutoff: float, initial: FloatArray) -> FloatArray:
    """Filter a record by a causal first-order low-pass [Hz], sample time free to vary."""
    y = np.array(x, dtype=float, order='C')
    _low_pass(dt, cutoff, np.array(initial, dtype=float), y)
    return y


@compiled
def _low_pass(dt: FloatArray, cutoff: float, state: FloatArray, y: FloatArray) -> None:
    """Filter a record in place: the loop of `low_pass`."""
    for k in range(len(y)):
        gain = low_pass_gain(cutoff, dt[k])
        for i in range(len(state)):
            state[i] += gain * (y[k, i] - state[i])
            y[k, i] = state[i]


class CausalDifferentiator:
    """
    Velocity and acceleration as in Malzahn et al., Section III: difference quotient and low-pass.

    The velocity is the difference quotient of the position after a first-order low-pass (80 Hz),
    the acceleration the difference quotient of that velocity after a second one (20 Hz). At the
    first sample after a reset both are zero.
    """

    def __init__(self, velocity_cutoff: float = 80.0, acceleration_cutoff: float = 20.0) -> None:
        self.velocity_cutoff = velocity_cutoff
        self.acceleration_cutoff = acceleration_cutoff
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next sample is a first one."""
        self._last: FloatArray | None = None

    def process(
        self, dt: FloatArray, q: FloatArray, measured: FloatArray | None = None,
    ) -> MotionState:
        """Filter a record (samples, joints), whatever came before it."""
        if measured is not None and measured.shape != q.shape:
            raise SignalError(f'velocities have shape {measured.shape}; expected {q.shape}')
        wrong = np.flatnonzero(~(dt[1:] > 0)) + 1
        if wrong.size:
            raise SignalError(f'sample time {dt[wrong[0]]:g} s at sample {wrong[0]}; stamps must '
                              'increase')
        self.reset()
        _, dq, ddq = np.split(self._rows(dt, q, measured), 3, axis=1)
        return MotionState(q, dq.copy(), ddq.copy())

    def step_row(self, dt: float, q: FloatArray, measured: FloatArray | None = None) -> FloatArray:
        """Filter one sample, for the control loop; gives ``[q, dq, ddq]`` in one new array."""
        if self._last is not None and not dt > 0:
            raise SignalError(f'sample time {dt:g} s; stamps must increase')
        row: FloatArray = self._rows(np.array([dt]), q[None],
                                     None if measured is None else measured[None])[0]
        return row

    def _rows(self, dt: FloatArray, q: FloatArray, measured: FloatArray | None) -> FloatArray:
        """Filter the next samples, a row ``[q, dq, ddq]`` each."""
        given = np.empty((len(q), 0)) if measured is None else measured
        if self._last is None:  # the first sample comes after itself
            self._last = np.zeros((3, q.shape[1]))
            self._last[0], self._last[1, :given.shape[1]] = q[0], given[0]
            dt = np.concatenate([[1.0], dt[1:]])
        rows = np.empty((len(q), self._last.size))
        _differentiate(dt, self.velocity_cutoff, self.acceleration_cutoff,
                       np.ascontiguousarray(q), np.ascontiguousarray(given), self._last, rows)
        return rows


@compiled
def _differentiate(
    dt: FloatArray, velocity_cutoff: float, acceleration_cutoff: float, q: FloatArray,
    measured: FloatArray, last: FloatArray, rows: FloatArray,
) -> None:
    """Filter samples after the last one; without measured speeds that array has no columns."""
    n = last.shape[1]
    for k in range(len(q)):
        first = low_pass_gain(velocity_cutoff, dt[k])
        second = low_pass_gain(acceleration_cutoff, dt[k])
        for i in range(n):
            last_q, last_dq, last_ddq = last[0, i], last[1, i], last[2, i]
            dq = last_dq + first * ((q[k, i] - last_q) / dt[k] - last_dq)
            if measured.shape[1] > 0:
                dq = measured[k, i]
            ddq = last_ddq + second * ((dq - last_dq) / dt[k] - last_ddq)
            last[0, i], last[1, i], last[2, i] = q[k, i], dq, ddq
            rows[k, i], rows[k, n + i], rows[k, 2 * n + i] = q[k, i], dq, ddq


def zero_phase(
    t: FloatArray, q: FloatArray, cutoff: float, measured: FloatArray | None = None,
) -> MotionState:
    """Differentiate a record without phase lag: Butterworth forward and backward, then central."""
    # Fourth order, see Gautier, Janot and Vandanjon, IEEE TCST 21(2), 2013, Section II.C. Stamps
    # with jitter are brought to a uniform grid and back.
    n = len(t)
    dt = float(t[-1] - t[0]) / (n - 1)
    if not 0 < cutoff < 0.5 / dt:
        raise SignalError(f'cutoff= {cutoff:g} Hz: give more than 0 and less than {0.5 / dt:.4g} '
                          'Hz, half the sample rate; the arm may set it as preprocessing.cutoff')
    sections = low_pass_sections(butterworth(4), cutoff * dt)
    grid = t[0] + dt * np.arange(n)
    uniform = bool(np.max(np.abs(grid - t)) < 1e-3 * dt)

    def smooth(x: FloatArray) -> FloatArray:
        even = x if uniform else interpolated(grid, t, x)
        return forward_backward(sections, even, min(n - 1, max(27, int(3.0 / (cutoff * dt)))))

    def back(x: FloatArray) -> FloatArray:
        return x if uniform else interpolated(t, grid, x)

    smooth_q = smooth(q)
    dq = derivative(smooth_q, dt) if measured is None else smooth(measured)
    ddq = derivative(dq, dt)
    return MotionState(back(smooth_q), back(dq), back(ddq))


def derivative(x: FloatArray, dt: float) -> FloatArray:
    """Differentiate by central differences of fourth order."""
    # Those of second order make all accelerations of a motion of 2 Hz at 100 Hz too small by
    # 0.26 %, and inertias too large by as much: several standard errors, where these are small.
    # Here it is 0.001 %.
    slope = np.gradient(x, dt, axis=0)
    slope[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * dt)
    return np.asarray(slope)


def interpolated(new: FloatArray, old: FloatArray, x: FloatArray) -> FloatArray:
    """Give signals (samples, columns) at other times, linearly between those known."""
    return np.stack([np.interp(new, old, x[:, i]) for i in range(x.shape[1])], axis=1)


class SmoothStates:
    """Three first-order low-passes in a row, and central differences of the last one's output."""

    # Of signals that went through the same one, each derivative is late by the same time, and what
    # is linear between them stays so (the state variable filter of continuous-time identification:
    # Garnier, Mensler and Richard, "Continuous-time model identification from sampled data", Int.
    # J. Control 76(13), 2003).

    def __init__(self, cutoff: float) -> None:
        self.cutoff = cutoff
        self._pole = 2.0 * math.pi * cutoff
        self._stages: FloatArray | None = None
        self._before = 0.0

    @property
    def settle(self) -> float:
        """Give the warm-up: how long derivatives are wrong after a restart [s]."""
        return settings.SETTLED / self._pole

    def step(self, dt: float, x: FloatArray) -> FloatArray:
        """Filter one sample (channels,), dt 0 restarts; returns it with two derivatives."""
        if self._stages is None or dt <= 0.0:
            self._stages = np.tile(x, (5, 1))
            self._before = 0.0
            return central(1.0, 1.0) @ self._stages[2:]
        stages, gain, before = self._stages, low_pass_gain(self.cutoff, dt), x
        stages[4], stages[3] = stages[3], stages[2]
        for stage in stages[:3]:
            stage += gain * (before - stage)
            before = stage
        earlier, self._before = self._before or dt, dt
        return central(dt, earlier) @ stages[2:]

    def process(self, dt: FloatArray, x: FloatArray) -> FloatArray:
        """Filter a gapless record at once: (3, samples, channels)."""
        if not len(x):
            return np.zeros((3, *x.shape))
        last = x
        for _ in range(3):
            last = np.vstack([x[:1], low_pass(last[1:], dt[1:], self.cutoff, x[0])])
        lasts = np.array([last, last[np.maximum(np.arange(len(x)) - 1, 0)],
                          last[np.maximum(np.arange(len(x)) - 2, 0)]])
        times = np.maximum(np.where(np.arange(len(x)) > 0, dt, 1.0), 1e-9)
        earlier = np.concatenate([[1.0], times[1:2], times[1:-1]])[:len(x)]
        found: FloatArray = np.einsum('dvn,vnc->dnc', central(times, earlier), lasts)
        return found


def central(dt: float | FloatArray, earlier: float | FloatArray) -> FloatArray:
    """Give what a middle value and its derivatives take of three, the last first: (3, 3, ...)."""
    both, nothing = dt + earlier, 0.0 * dt
    return np.array([
        [nothing, nothing + 1.0, nothing],
        [earlier / (dt * both), (dt / earlier - earlier / dt) / both, -dt / (earlier * both)],
        [2.0 / (dt * both), -2.0 / (dt * earlier), 2.0 / (earlier * both)]])


# Matrix pencil method (Hua and Sarkar, IEEE Transactions on Acoustics, Speech and Signal
# Processing 38, 1990): the poles of a sum of damped oscillations are eigenvalues of a pair of
# Hankel matrices.

@dataclass(frozen=True)
class Vibration:
    """A damped oscillation."""

    frequency: float  # of the damped oscillation [Hz]
    damping: float  # damping ratio; negative where the oscillation grows


@dataclass(frozen=True)
class RingMode(Vibration):
    """One oscillation of a free decay."""

    amplitude: float  # at the first sample, in the unit of the signal


def ring_modes(signal: ArrayLike, dt: float, *, count: int = 2) -> tuple[RingMode, ...]:
    """Find the strongest oscillations of a free decay: signal (samples,), dt [s]."""
    y = np.asarray(signal, dtype=float)
    if y.ndim != 1 or not np.isfinite(y).all():
        raise SignalError(f'a free decay needs finite samples (n_samples,), found shape {y.shape}')
    every = max(int(1.0 / (6.0 * settings.HIGHEST_RINGING * dt)),
                -(-y.size // settings.MOST_SAMPLES), 1)
    n = y.size // every
    if n < 12 * count:
        raise SignalError(f'{y.size} samples at {1.0 / dt:g} Hz are too few to find {count} '
                          'oscillations; record longer')
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
        if settings.LOWEST_RINGING <= frequency <= settings.HIGHEST_RINGING:
            energy = float(np.sum(np.abs(weight * pole ** np.arange(n)) ** 2))
            found.append((energy, RingMode(frequency, float(-s.real / abs(s)),
                                           2.0 * float(abs(weight)))))
    found.sort(key=lambda item: -item[0])
    return tuple(sorted((mode for _, mode in found[:count]), key=lambda mode: mode.frequency))
