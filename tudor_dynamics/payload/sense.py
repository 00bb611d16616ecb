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

"""What a load is told by, sample by sample, in units of the noise of a model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, Protocol

import numpy as np

from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.payload.bent import BentLinks
from tudor_dynamics.payload.worth import LoadWorth
from tudor_dynamics.signals.smooth_states import SmoothStates
from tudor_dynamics.typing import FloatArray

DEPENDENT = 0.3
"""Time for which the error of a rigid model depends on itself [s]."""
QUIET = 0.2
"""Part of its mean square that is there without acceleration."""
RINGS = 0.6
"""Time for which a link rings behind an acceleration [s]."""
USUAL = 30.0
"""Time over which the usual acceleration is learned [s]."""
ROUGHLY = 0.05
"""Error of a model of which nothing is known, as a part of what loads the output."""


@dataclass(eq=False, slots=True)  # frozen would be three times as slow to make
class Sensed:
    """A sample in units of its noise, whose density is 1."""

    left: FloatArray  # what a model without the load leaves over, (channels,)
    worth: FloatArray  # what a kilogram adds, (channels,)
    # (channels,): what its weight adds without its inertia: a force that is held at the tip.
    weight: FloatArray


class Sense(Protocol):
    """
    Makes that of readings.

    Attributes
    ----------
    lag : float
        Of each of three filters that samples go through; 0 without [s].
    explained : float
        Part of what came suddenly that a load leaves over at most.

    """

    lag: float
    explained: float

    def step(self, dt: float, row: FloatArray, measured: FloatArray) -> Sensed | None:
        """
        Take a sample; None while filters settle.

        Parameters
        ----------
        dt : float
            Time since the sample before; 0 begins anew [s].
        row : ndarray of shape (3 n_joints,)
            ``[q, dq, ddq]`` [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        measured : ndarray of shape (n_channels,)
            Readings in units of the output.

        """
        ...


class RigidSense:
    """
    By a model of rigid bodies, for each channel by itself.

    Its error is no white noise. It counts by what it has over a second: its mean square times the
    time for which it depends on itself, more so where the arm accelerates, which is when links
    ring.

    noise (channels,).
    """

    lag = 0.0
    explained = 0.4

    def __init__(self, model: Model, worth: LoadWorth, noise: FloatArray) -> None:
        self._model, self._worth, self._noise = model, worth, noise
        self._now = self._usual = self._seconds = 0.0

    def step(self, dt: float, row: FloatArray, measured: FloatArray) -> Sensed | None:
        """Take a sample; see ``Sense``."""
        acceleration = row[2 * (len(row) // 3):]
        size = float(acceleration @ acceleration)
        if dt > 0.0:
            self._now += min(dt / RINGS, 1.0) * (size - self._now)
            self._seconds = min(self._seconds + dt, USUAL)
            self._usual += min(dt / self._seconds, 1.0) * (size - self._usual)
        lively = QUIET + (self._now / self._usual if self._usual > 0.0 else 0.0)
        unit = self._noise * math.sqrt(DEPENDENT * lively)
        left = measured - self._model.predict(row[None, :])[0]
        worth, weight = self._worth.along(_and_still(row[None, :])) / unit
        return Sensed(left / unit, worth, weight)


class BentSense:
    """By where links are that bend, all gauges together: known [kg]."""

    explained = 0.15

    def __init__(self, bent: BentLinks, worth: LoadWorth, known: float) -> None:
        self._bent, self._worth, self._model = bent, worth, bent.model.at(known)
        self._white = np.linalg.inv(np.linalg.cholesky(bent.density))
        self._joints = bent.model.n_joints
        self._states = SmoothStates(bent.cutoff)
        self.lag = 1.0 / (2.0 * math.pi * bent.cutoff)
        self._elapsed = 0.0

    def step(self, dt: float, row: FloatArray, measured: FloatArray) -> Sensed | None:
        """Take a sample; see ``Sense``."""
        self._elapsed = self._elapsed + dt if dt > 0.0 else 0.0
        states = self._states.step(dt, np.concatenate([row[:self._joints], measured]))
        if self._elapsed < self._states.settle:
            return None
        motion = self._bent.motion(states[:, None])
        left = states[0, self._joints:] - self._model.predict(motion)[0]
        worth, weight = self._worth.along(_and_still(motion)) @ self._white.T
        return Sensed(self._white @ left, worth, weight)


def _and_still(motion: FloatArray) -> FloatArray:
    """Put the same pose at rest behind a row of motion."""
    both = np.repeat(motion, 2, axis=0)
    both[1, both.shape[1] // 3:] = 0.0
    return both


def rigid_noise(
    facts: Mapping[str, Any], output: str, model: AnalyticalModel, worth: LoadWorth,
) -> FloatArray:
    """Give what a model beside the robot leaves over in its training; returns (channels,)."""
    found = np.maximum(ROUGHLY * worth.reference * worth.typical, 1e-300)
    for key in ('validation', 'causal_validation'):
        try:
            known = facts[key][output]['analytical']['training']['channels']
            values = np.array([float(known[name]['rmse']) for name in model.channels])
        except (KeyError, TypeError, ValueError):
            continue
        if np.isfinite(values).all() and (values > 0.0).all():
            found = values
    return found
