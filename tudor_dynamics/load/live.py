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

"""The load of a running robot: estimated, expected, separated from contact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from tudor_dynamics.compiled import all_finite
from tudor_dynamics.errors import ModelError
from tudor_dynamics.load.bending import bent_links, BentLinks
from tudor_dynamics.load.observer import LoadObserver
from tudor_dynamics.load.rows import carrier_frame, load_worth, LoadWorth, tip
from tudor_dynamics.load.settings import (
    APART, BEGUN, BENT_EXPLAINED, DEPENDENT, EXPECTED, LARGEST_STEP, LIGHTEST, QUIET,
    RIGID_EXPLAINED, RINGS, ROUGHLY, USUAL)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.signals.filters import SmoothStates
from tudor_dynamics.typing import FloatArray


# -- Samples in units of the noise of a model, whose density is then 1

Sensed = tuple[FloatArray, FloatArray, FloatArray]
"""Residual of a model without the load, what a kilogram adds, and what its weight adds without its
inertia (a force that is held at the tip), (channels,)."""


class RigidSense:
    """
    Residuals of a model of rigid bodies, each channel by itself.

    Its error is no white noise. It counts by what it has over a second: its mean square times the
    time for which it depends on itself, more so where the arm accelerates, which is when links
    ring.
    """

    lag = 0.0
    explained = RIGID_EXPLAINED

    def __init__(self, model: Model, worth: LoadWorth, noise: FloatArray) -> None:
        self._model, self._worth, self._noise = model, worth, noise
        self._now = self._usual = self._seconds = 0.0

    def step(self, dt: float, row: FloatArray, measured: FloatArray) -> Sensed:
        """Take a sample; dt 0 at a beginning."""
        acceleration = row[2 * (len(row) // 3):]
        size = float(acceleration @ acceleration)
        if dt > 0.0:
            self._now += min(dt / RINGS, 1.0) * (size - self._now)
            self._seconds = min(self._seconds + dt, USUAL)
            self._usual += min(dt / self._seconds, 1.0) * (size - self._usual)
        lively = QUIET + (self._now / self._usual if self._usual > 0.0 else 0.0)
        unit = self._noise * math.sqrt(DEPENDENT * lively)
        left = measured - self._model.predict(row[None, :])[0]
        added, weight = self._worth.along(_and_still(row[None, :])) / unit
        return left / unit, added, weight


class BentSense:
    """Residuals by where links are that bend, all gauges together: known [kg]."""

    explained = BENT_EXPLAINED

    def __init__(self, bent: BentLinks, worth: LoadWorth, known: float) -> None:
        self._bent, self._worth, self._model = bent, worth, bent.model.at(known)
        self._white = np.linalg.inv(np.linalg.cholesky(bent.density))
        self._joints = bent.model.n_joints
        self._states = SmoothStates(bent.cutoff)
        self.lag = 1.0 / (2.0 * math.pi * bent.cutoff)
        self._elapsed = 0.0

    def step(self, dt: float, row: FloatArray, measured: FloatArray) -> Sensed | None:
        """Take a sample as `RigidSense` does; None while filters settle."""
        self._elapsed = self._elapsed + dt if dt > 0.0 else 0.0
        states = self._states.step(dt, np.concatenate([row[:self._joints], measured]))
        if self._elapsed < self._states.settle:
            return None
        motion = self._bent.motion(states[:, None])
        left = states[0, self._joints:] - self._model.predict(motion)[0]
        added, weight = self._worth.along(_and_still(motion)) @ self._white.T
        return self._white @ left, added, weight


def _and_still(motion: FloatArray) -> FloatArray:
    """Put the same pose at rest after a row of motion."""
    both = np.repeat(motion, 2, axis=0)
    both[1, both.shape[1] // 3:] = 0.0
    return both


def rigid_noise(
    facts: Mapping[str, Any], output: str, model: AnalyticalModel, worth: LoadWorth,
) -> FloatArray:
    """Give the residual of a model of the robot in its training; returns (channels,)."""
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


# -- What is carried, for predictions and detectors

@dataclass(frozen=True)
class LoadFound:
    """A collision that was none: a load."""

    stamp: int  # stamp of the sample at which it was clear [ns]
    mass: float  # what is carried now in all [kg]
    change: float  # by how much it has changed [kg]


class CarriedLoad:
    """A load that is put onto predictions of an arm without it: known [kg], place (3,) [m]."""

    def __init__(self, bundle: ModelBundle, known: float) -> None:
        self.worth = load_worth(bundle.arm, bundle.models)
        if not self.worth:
            raise ModelError('no output of this model tells a load in kilograms: fit a model to '
                             'bags of two payloads (tudor fit --payload-of), or describe torque '
                             'constants or the gain of a gauge')
        self.known = known
        self.frame, self.place = carrier_frame(bundle.arm), tip(bundle.arm)
        self.output = 'strain' if 'strain' in self.worth else 'effort'
        self._mass = self._reported = known
        self._expected = self._last = 0

    @property
    def mass(self) -> float:
        """Give what is carried in all [kg]."""
        return self._mass

    def carry(self, mass: float) -> None:
        """Take another load, as somebody else knows it: mass [kg]."""
        self._mass = mass

    def expect(self) -> None:
        """Let a load come or go within the next seconds without being a collision."""
        self._expected = self._last + round(EXPECTED * 1e9)

    @property
    def expecting(self) -> bool:
        """Say whether a load may come now."""
        return self._last < self._expected

    def step(
        self, stamp: int, dt: float, row: FloatArray, measured: FloatArray, *, touched: bool,
    ) -> LoadFound | None:
        """Take a sample of the load's output; ``touched``: anything touches the arm, or may."""
        self._advance(stamp)
        change, self._reported = self._mass - self._reported, self._mass
        if abs(change) < LIGHTEST * self.worth[self.output].reference:
            return None
        return LoadFound(self._last, self._mass, change)

    def _advance(self, stamp: int) -> bool:
        """Let time go by; say whether the clock was set back."""
        back = stamp < self._last
        if back:
            self._expected = 0
        self._last = stamp
        return back

    def add_to(self, predicted: dict[str, FloatArray], row: FloatArray) -> dict[str, FloatArray]:
        """Add the load to predictions (channels,) at ``row``, a sample of motion (3 joints,)."""
        more = self.mass - self.known
        return {output: values + more * self.worth[output].along(row[None])[0]
                if output in self.worth else values for output, values in predicted.items()}


class PayloadStage(CarriedLoad):
    """Follows the load of the arm: known [kg]."""

    def __init__(self, bundle: ModelBundle, known: float) -> None:
        super().__init__(bundle, known)
        self._sense, reference = self._sensed(bundle)
        channels = len(bundle.models[self.output]['analytical'].channels)
        self.observer = LoadObserver(
            channels, reference, self._sense.lag, self._sense.explained)
        # compiled now, and not while the robot runs
        nothing = np.zeros(3 * len(bundle.arm.joints))
        for _ in range(round(2.0 * BEGUN / LARGEST_STEP)):
            sensed = self._sense.step(LARGEST_STEP, nothing, np.zeros(channels))
            if sensed is not None:
                self.observer.step(LARGEST_STEP, *sensed, held=False)
        self.observer.reset()
        self._sense, _ = self._sensed(bundle)

    def _sensed(self, bundle: ModelBundle) -> tuple[RigidSense | BentSense, float]:
        """Choose what shows the load; give what loads are compared with as well [kg]."""
        bent = bent_links(bundle.facts, bundle.arm) if self.output == 'strain' else None
        self.bent = bent is not None
        if bent is not None:
            own = LoadWorth(bundle.arm, self.output, bent.model)
            return BentSense(bent, own, self.known), own.reference
        model, own = bundle.models[self.output]['analytical'], self.worth[self.output]
        assert isinstance(model, AnalyticalModel)  # an output with kilograms has one
        noise = rigid_noise(bundle.facts, self.output, model, own)
        return RigidSense(model.at(self.known), own, noise), own.reference

    @property
    def mass(self) -> float:
        """Give what is carried in all [kg]."""
        return self.known + self.observer.mass

    @property
    def std(self) -> float:
        """Give its standard deviation [kg]."""
        return self.observer.std

    def step(
        self, stamp: int, dt: float, row: FloatArray, measured: FloatArray, *, touched: bool,
    ) -> LoadFound | None:
        """Take a sample into account; see `CarriedLoad`."""
        before = self._last
        if self._advance(stamp):
            self.observer.reset()
        if not all_finite(measured):
            return None
        since = (stamp - before) * 1e-9
        if dt == 0.0 or not 0.0 < since < APART:
            since = 0.0  # the first one, also after a gap while filters settled
        sensed = self._sense.step(since, row, measured)
        if sensed is None:
            return None
        change = self.observer.step(
            since, *sensed, held=touched and not self.expecting, expected=self.expecting)
        return LoadFound(stamp, self.mass, change) if change else None
