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
The load sample by sample: a Kalman filter with the mass and the zero of each channel.

The error of a model is no white noise. It counts by what it has over a second: its mean square
times the time for which it depends on itself, more so where the arm accelerates, which is when
links ring. What is old is forgotten as the mass and the zeros may wander.
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.payload.trial import LoadTrial
from tudor_dynamics.typing import FloatArray

DEPENDENT = 0.3
"""Time for which the error of a model depends on itself [s]."""
QUIET = 0.2
"""Part of its mean square that is there without acceleration."""
RINGS = 0.6
"""Time for which a link rings behind an acceleration [s]."""
USUAL = 30.0
"""Time over which the usual acceleration is learned [s]."""
WANDERS = 0.005
"""Of the mass, in payloads of the model over a second."""
ZERO, ZERO_WANDERS = 1.0, 0.01
"""Of a channel in its noise: as it is not known at first, and over a second."""
EXPECTED_WANDERS = 0.25
"""The same while a load may come or go."""
KEPT, KEPT_EVERY = 5, 0.2
"""States that are put aside, and the time between two [s]: the oldest knows nothing of what has
come within the time of a trial."""
BEGUN = 2.0
"""Time for which the load that is there at the beginning is learned [s]."""
UNSURE = 0.3
"""Part of a load that has just come by which it may be wrong."""
LARGEST_STEP = 0.1
"""A sample stands for no more time than this [s]."""


@compiled
def observe_load(x: FloatArray, p: FloatArray, left: FloatArray, worth: FloatArray,
                 noise: FloatArray, dt: float, wander: float, zero: float) -> None:
    """Advance the filter by one sample; a noise is a mean square times a time."""
    size, channels = x.shape[0], left.shape[0]
    p[0, 0] += wander * dt
    for c in range(channels):
        p[1 + c, 1 + c] += zero * noise[c] * dt
    gain = np.empty(size)
    for c in range(channels):
        for i in range(size):
            gain[i] = p[i, 0] * worth[c] + p[i, 1 + c]
        spread = worth[c] * gain[0] + gain[1 + c] + noise[c] / dt
        new = left[c] - worth[c] * x[0] - x[1 + c]
        for i in range(size):
            x[i] += gain[i] / spread * new
        for i in range(size):
            for j in range(size):
                p[i, j] -= gain[i] * gain[j] / spread


class LoadObserver:
    """
    The load that an arm carries, and whether what came suddenly is one.

    Parameters
    ----------
    noise : ndarray of shape (n_channels,)
        What the model leaves over in free motion, in units of the output.
    reference : float
        Payloads of the model, or what weighs like the arm itself [kg].

    """

    def __init__(self, noise: FloatArray, reference: float) -> None:
        self._noise, self._reference = noise, reference
        self._trial = LoadTrial(noise, reference)
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        count = 1 + len(self._noise)
        self._x, self._p = np.zeros(count), np.zeros((count, count))
        self._p[0, 0] = self._reference ** 2
        for c, noise in enumerate(self._noise):
            self._p[1 + c, 1 + c] = (ZERO * noise) ** 2
        self._now = self._usual = self._seconds = 0.0
        self._trial.reset()
        self._kept = deque([(self._x.copy(), self._p.copy())], maxlen=KEPT)
        self._since = 0.0

    @property
    def mass(self) -> float:
        """Load beside what the model knows [kg]."""
        return float(self._x[0])

    @property
    def std(self) -> float:
        """Its standard deviation [kg]."""
        return math.sqrt(max(float(self._p[0, 0]), 0.0))

    def step(
        self, stamp: int, dt: float, acceleration: FloatArray, left: FloatArray,
        worth: FloatArray, *, held: bool, expected: bool = False,
    ) -> float:
        """
        Take a sample into account.

        Parameters
        ----------
        stamp : int
            Stamp of the sample [ns].
        dt : float
            Time since the sample before; 0 at a beginning [s].
        acceleration : ndarray of shape (n_joints,)
            Of the joints [rad/s^2 or m/s^2].
        left : ndarray of shape (n_channels,)
            What a model without the load leaves over, in units of the output.
        worth : ndarray of shape (n_channels,)
            What a kilogram adds.
        held : bool
            Whether something touches the arm: then the mass stays as it is.
        expected : bool, default=False
            Whether a load may come or go now: then the mass may change quickly.

        Returns
        -------
        float
            Change of the load, where what came suddenly has just turned out to be one; zero
            otherwise [kg].

        """
        dt = min(dt, LARGEST_STEP)
        if dt <= 0.0:
            self._trial.reset()
            return 0.0
        size = float(acceleration @ acceleration)
        self._now += min(dt / RINGS, 1.0) * (size - self._now)
        self._seconds = min(self._seconds + dt, USUAL)
        self._usual += dt / self._seconds * (size - self._usual)
        x, p = self._x, self._p
        # against what was known before: meanwhile the zeros have learned what was no zero
        old, spread = self._kept[0]
        change = 0.0
        if self._seconds >= BEGUN:
            change = self._trial.step(stamp, left - worth * old[0] - old[1:], worth,
                                      float(old[0]))
        if change:
            x[:], p[:] = old, spread
            x[0] += change
            p[0, :] = p[:, 0] = 0.0
            p[0, 0] = (UNSURE * change) ** 2
            self._kept.clear()
            self._kept.append((x.copy(), p.copy()))
            return change
        self._since += dt
        if self._since >= KEPT_EVERY:
            self._since = 0.0
            self._kept.append((x.copy(), p.copy()))
        if held:
            return 0.0
        lively = QUIET + (self._now / self._usual if self._usual > 0.0 else 0.0)
        wanders = (EXPECTED_WANDERS if expected else WANDERS) * self._reference
        observe_load(x, p, left, worth, self._noise ** 2 * (DEPENDENT * lively), dt, wanders ** 2,
                     ZERO_WANDERS ** 2)
        return 0.0
