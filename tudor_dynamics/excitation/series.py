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
A Fourier series of every joint over the whole motion, faded in from rest and out to rest.

Positions, velocities and accelerations are linear in the coefficients, so that whatever is asked
of the motion has exact slopes by them. One period is as long as the motion: nothing has to repeat,
and the band of frequencies is what is bounded (Swevers et al., IEEE T-RA 13, 1997, repeat a short
period instead, which costs freedom that a search may use).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.excitation import fade, JointRange
from tudor_dynamics.signals.motion_profile import MotionLimits, Reference
from tudor_dynamics.typing import FloatArray

REST = 1.0
"""Rest at both ends: filters settle [s]."""
FADE = 3.0
"""Way from rest into the series and back [s]."""


@dataclass(frozen=True, eq=False)
class Series:
    """Basis of the motion on a grid of times, and sizes of its coefficients."""

    dt: float  # step of the grid [s]
    # (3, samples, functions): functions of time and their first and second derivatives; the first
    # is constant.
    basis: FloatArray
    # Amplitude of each that alone goes to a limit of the joint, (functions, joints) [rad or m].
    sizes: FloatArray
    centre: FloatArray  # middle of the range, (joints,) [rad or m]

    def motion(self, x: FloatArray) -> FloatArray:
        """
        Give ``[q, dq, ddq]`` of coefficients, shape (n_samples, 3 n_joints).

        x (functions, joints).
        """
        parts = self.basis @ (x * self.sizes)
        parts[0] += self.centre
        return np.hstack(list(parts))

    def slope(self, motion: FloatArray) -> FloatArray:
        """
        Turn slopes by motion into slopes by coefficients.

        motion (samples, 3 joints): slopes by each sample of ``[q, dq, ddq]``.
        """
        parts = np.stack(np.split(motion, 3, axis=1))
        return np.asarray(np.einsum('dsf,dsj->fj', self.basis, parts) * self.sizes)

    def reference(self, x: FloatArray) -> Reference:
        """Give the motion of coefficients as a reference: x (functions, joints)."""
        return Reference(self.dt, *np.split(self.motion(x), 3, axis=1))


def series(
    bounds: JointRange, limits: MotionLimits, seconds: float, highest: float, dt: float,
) -> Series:
    """Lay out the basis: seconds, dt [s], highest [Hz]."""
    length = seconds - 2.0 * REST
    harmonics = int(highest * length + 1e-9)
    if length < 2.0 * FADE or harmonics < 1:
        msg = (f'a Fourier series of {seconds:g} s up to {highest:g} Hz has no room; give at '
               f'least {2.0 * (REST + FADE):g} s, and a frequency above '
               f'{1.0 / max(length, 1e-3):.3g} Hz')
        raise SignalError(msg)
    t = np.asarray(np.arange(int(round(seconds / dt)) + 1) * dt - REST, dtype=np.float64)
    window = [part[:, None] for part in fade(t, length, FADE)]
    w = 2.0 * np.pi / length * np.arange(1, harmonics + 1)
    sine, cosine = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    plain = np.hstack([sine, cosine])
    slope = np.hstack([w * cosine, -w * sine])
    bend = -np.hstack([w, w]) ** 2 * plain
    whole = np.stack([window[0] * plain, window[1] * plain + window[0] * slope,
                      window[2] * plain + 2.0 * window[1] * slope + window[0] * bend])
    constant = np.zeros((3, len(t), 1))
    constant[0] = 1.0
    half = 0.5 * (bounds.upper - bounds.lower)
    both = np.concatenate([w, w])[:, None]
    sizes = np.minimum(half, np.minimum(limits.velocity / both, limits.acceleration / both**2))
    return Series(dt, np.concatenate([constant, whole], axis=2), np.vstack([half, sizes]),
                  0.5 * (bounds.upper + bounds.lower))
