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
The papers' causal differentiation filters.

The filter is one object for all uses: fed sample by sample next to the robot, or with a whole
record offline, it gives the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SignalError
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class FilteredStates:
    """Positions with their derivatives, one row a sample."""

    q: FloatArray  # positions of the joints, (samples, joints) [rad or m]
    dq: FloatArray  # velocities of the joints, (samples, joints) [rad/s or m/s]
    ddq: FloatArray  # accelerations of the joints, (samples, joints) [rad/s^2 or m/s^2]


@compiled
def low_pass_gain(cutoff: float, dt: float) -> float:
    """
    Give the gain of a discrete first-order low-pass with the pole of the continuous one.

    ``y[k] = y[k-1] + gain (x[k] - y[k-1])``; exact for any sample time, so also for a varying one.

    cutoff [Hz], dt [s].
    """
    return -math.expm1(-2.0 * math.pi * cutoff * dt)


def low_pass(x: FloatArray, dt: FloatArray, cutoff: float, initial: FloatArray) -> FloatArray:
    """
    Filter a record by a causal first-order low-pass, sample time free to vary.

    x (samples, channels), dt (samples,) [s], cutoff [Hz], initial (channels,); returns
    (samples, channels).
    """
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

    The velocity is the difference quotient of the position behind a first-order low-pass (80 Hz),
    the acceleration the difference quotient of that velocity behind a second one (20 Hz). At the
    first sample after a reset both are zero.

    velocity_cutoff, acceleration_cutoff [Hz].
    """

    def __init__(self, velocity_cutoff: float = 80.0, acceleration_cutoff: float = 20.0) -> None:
        for name, value in (('velocity_cutoff', velocity_cutoff),
                            ('acceleration_cutoff', acceleration_cutoff)):
            if not (math.isfinite(value) and value > 0):
                msg = f'{name} is {value}; expected a frequency above 0 Hz'
                raise SignalError(msg)
        self.velocity_cutoff = velocity_cutoff
        self.acceleration_cutoff = acceleration_cutoff
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next sample is a first one."""
        self._q: FloatArray | None = None
        self._dq: FloatArray = np.zeros(0)
        self._ddq: FloatArray = np.zeros(0)

    def process(
        self,
        dt: FloatArray,
        q: FloatArray,
        measured: FloatArray | None = None,
    ) -> FilteredStates:
        """
        Filter the samples that follow those seen so far; any number of them, one included.

        dt (samples,) [s], q (samples, joints) [rad or m]; writes measured (samples, joints)
        [rad/s or m/s].
        """
        q = np.asarray(q, dtype=float)
        dt = np.asarray(dt, dtype=float)
        if q.ndim != 2 or dt.shape != q.shape[:1]:
            msg = f'dt has shape {dt.shape} and q {q.shape}; expected (n,) and (n, n_joints)'
            raise SignalError(msg)
        if measured is not None and measured.shape != q.shape:
            msg = f'velocities have shape {measured.shape}, positions {q.shape}'
            raise SignalError(msg)
        if not len(q):
            return FilteredStates(q, q.copy(), q.copy())
        first = self._q is None
        begin = 1 if first else 0
        step = dt[begin:]
        if np.any(~(step > 0)):  # before anything is remembered: a refused record leaves no trace
            at = begin + int(np.flatnonzero(~(step > 0))[0])
            msg = f'sample time {dt[at]} s at sample {at}; stamps must increase'
            raise SignalError(msg)
        if self._q is None:
            self._q = q[0].copy()
            self._dq = np.zeros(q.shape[1]) if measured is None else measured[0].copy()
            self._ddq = np.zeros(q.shape[1])
        if q.shape[1:] != self._q.shape:
            msg = f'{q.shape[1]} joints after samples of {len(self._q)}; reset the filter between'
            raise SignalError(msg)
        dq, ddq = np.empty_like(q), np.empty_like(q)
        if first:
            dq[0], ddq[0] = self._dq, 0.0
        if measured is None:
            quotient = np.diff(q[begin:], axis=0, prepend=self._q[None]) / step[:, None]
            dq[begin:] = low_pass(quotient, step, self.velocity_cutoff, self._dq)
        else:
            dq[begin:] = measured[begin:]
        quotient = np.diff(dq[begin:], axis=0, prepend=self._dq[None]) / step[:, None]
        ddq[begin:] = low_pass(quotient, step, self.acceleration_cutoff, self._ddq)
        self._q, self._dq, self._ddq = q[-1].copy(), dq[-1].copy(), ddq[-1].copy()
        return FilteredStates(q, dq, ddq)

    def step(
        self, dt: float, q: FloatArray, measured: FloatArray | None = None,
    ) -> FilteredStates:
        """
        Filter one sample: ``process`` for the control loop, without its overhead.

        dt [s], q (joints,) [rad or m], measured (joints,) [rad/s or m/s].
        """
        row = self.step_row(dt, q, measured)
        n = len(q)
        return FilteredStates(row[:n], row[n:2 * n], row[2 * n:])

    def step_row(
        self, dt: float, q: FloatArray, measured: FloatArray | None = None,
    ) -> FloatArray:
        """
        Filter one sample as `step` does; gives ``[q, dq, ddq]`` in one array, the caller's.

        q (joints,) [rad or m], measured (joints,) [rad/s or m/s]; dt [s]: 0 begins anew.
        """
        n = len(q)
        row = np.empty(3 * n)
        if self._q is None:
            self._q = q.copy()
            self._dq = np.zeros(n) if measured is None else measured.copy()
            self._ddq = np.zeros(n)
            row[:n], row[n:2 * n], row[2 * n:] = q, self._dq, 0.0
            return row
        if not dt > 0:
            msg = f'sample time {dt} s; stamps must increase'
            raise SignalError(msg)
        _differentiate(dt, self.velocity_cutoff, self.acceleration_cutoff, q,
                       _NO_VELOCITY if measured is None else measured,
                       self._q, self._dq, self._ddq, row)
        return row


_NO_VELOCITY = np.empty(0)


@compiled
def _differentiate(
    dt: float, velocity_cutoff: float, acceleration_cutoff: float, q: FloatArray,
    measured: FloatArray, last_q: FloatArray, last_dq: FloatArray, last_ddq: FloatArray,
    row: FloatArray,
) -> None:
    """Filter one sample: the loop of `CausalDifferentiator.step_row`."""
    n = len(q)
    first, second = low_pass_gain(velocity_cutoff, dt), low_pass_gain(acceleration_cutoff, dt)
    for i in range(n):
        dq = last_dq[i] + first * ((q[i] - last_q[i]) / dt - last_dq[i])
        if len(measured) > 0:
            dq = measured[i]
        ddq = last_ddq[i] + second * ((dq - last_dq[i]) / dt - last_ddq[i])
        last_q[i], last_dq[i], last_ddq[i] = q[i], dq, ddq
        row[i], row[n + i], row[2 * n + i] = q[i], dq, ddq
