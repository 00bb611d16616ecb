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

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, ClassVar

import numpy as np
from tudor_dynamics.compiled import all_finite, compiled
from tudor_dynamics.errors import ModelError
from tudor_dynamics.load.bending import bent_links, BentLinks, links_of
from tudor_dynamics.load.rows import carrier_frame, load_worth, LoadWorth, tip
from tudor_dynamics.load.settings import (
    ANNOUNCED, APART, BEGUN, BENT_EXPLAINED, BLOCK, DEPENDENT, EXPECTED, EXPECTED_GAIN, HEAVIEST,
    LARGEST_STEP, LASTING, LIGHTER, LIGHTEST, LOUD, ODD, PRESSED, QUIET, RECENT, RIGID_EXPLAINED,
    RINGS, ROUGHLY, SEEN, SOONEST, TOUCH, UNSURE, USUAL, WANDERS, ZERO, ZERO_WANDERS)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.signals.filters import SmoothStates
from tudor_dynamics.typing import FloatArray


# -- When the load changed, and whether it was a load at all.
#
# Over the last part of the past every instant is tried: before it the load was what it had been,
# after it another one. The best of them leaves the smallest residual in least squares (the
# generalised likelihood ratio of Willsky and Jones, IEEE TAC 21(1), 1976). It is a load where that
# explains nearly all of the change, since a mass in the hand has one number for all channels,
# poses and accelerations; a touch elsewhere, or in another direction, has other levers and does
# not turn with the arm. A force that is held downwards at the tip has its levers, but no inertia:
# links ring with a load as they do with its mass, and with that force as they do without.

SCALARS = 7
"""Sums before those by channel: squares of residuals, their products with what a kilogram adds,
squares of that, time; products of its weight with residuals, and with what it adds, squares."""


@dataclass(frozen=True)
class Change:
    """The best instant for a change of the load, and what speaks for it."""

    mass: float  # by how much the load has changed [kg]
    information: float  # of that: one by the variance [1/kg^2]
    # Residual from that instant on with the load of before: squares in units of the noise.
    came: float
    left: float  # the same with the change
    touched: float  # the same with a moment that stays as it is, of any size in each channel
    # The same with a force downwards at the tip, which weighs without having inertia.
    pressed: float
    since: float  # time since then [s]

    @property
    def gain(self) -> float:
        """Give what the change explains, as squares in units of the noise."""
        return self.mass ** 2 * self.information


@compiled
def add_sample(
    left: FloatArray, added: FloatArray, weight: FloatArray, dt: float, sums: FloatArray,
) -> None:
    """Add a sample to the sums of a block."""
    channels = left.shape[0]
    for c in range(channels):
        sums[0] += left[c] * left[c] * dt
        sums[1] += left[c] * added[c] * dt
        sums[2] += added[c] * added[c] * dt
        sums[4] += left[c] * weight[c] * dt
        sums[5] += added[c] * weight[c] * dt
        sums[6] += weight[c] * weight[c] * dt
        sums[SCALARS + c] += left[c] * dt
        sums[SCALARS + channels + c] += added[c] * dt
        sums[SCALARS + 2 * channels + c] += weight[c] * dt
    sums[3] += dt


class RecentPast:
    """Sums of the last samples, by blocks: longest [s]; lag [s] of each of three low-passes."""

    REMEMBERED = '_blocks', '_full'

    def __init__(self, channels: int, longest: float, lag: float) -> None:
        self._most = round(longest / BLOCK)
        # row: what is seen of a change that begins with that block
        steps = ramp(lag, self._most)
        self._seen = np.array([np.append(np.zeros(first), steps[:self._most - first])
                               for first in range(self._most)])
        self._blocks = np.zeros((self._most + 1, SCALARS + 3 * channels))
        self.clear()

    def clear(self) -> None:
        """Forget the past."""
        self._blocks[:] = 0.0
        self._full = 0

    @property
    def full(self) -> bool:
        """Say whether there is no place for another block."""
        return self._full == self._most

    def add(self, dt: float, left: FloatArray, added: FloatArray, weight: FloatArray) -> bool:
        """Add a sample (channels,) in units of its noise; say whether a block is full with it."""
        newest = self._blocks[self._full]
        add_sample(left, added, weight, dt, newest)
        if newest[3] < BLOCK - 1e-9:
            return False
        if self.full:
            self._blocks[:-1] = self._blocks[1:]
        else:
            self._full += 1
        self._blocks[self._full] = 0.0
        return True

    def changed(self, x: FloatArray, least: float) -> Change | None:
        """Find the best instant for a change of the load: x (1 + channels,) [kg], least [s]."""
        count, blocks = self._full, max(1, round(least / BLOCK))
        if count < blocks:
            return None
        square, cross, extent, time, pressing, both, pressed = self._blocks[:count, :SCALARS].T
        there, added, weight = np.split(self._blocks[:count, SCALARS:], 3, axis=1)
        carried, zeros = x[0], x[1:]
        # residuals with the load of before: squares, and products with what a change would add
        came = square - 2.0 * carried * cross + carried ** 2 * extent + (
            zeros ** 2 * time[:, None] - 2.0 * zeros * (there - carried * added)).sum(axis=1)
        along = cross - carried * extent - added @ zeros
        pressing = pressing - carried * both - weight @ zeros
        moments = there - carried * added - zeros * time[:, None]
        seen = self._seen[:count - blocks + 1, :count]
        products, information = seen @ along, seen ** 2 @ extent
        explained = np.divide(products ** 2, information, where=information > 0.0,
                              out=np.zeros(len(seen)))
        first = int(np.argmax(explained))
        if explained[first] <= 0.0:
            return None
        step, total = seen[first], float(came[first:].sum())
        weighs = float(step ** 2 @ pressed)
        return Change(
            float(products[first] / information[first]), float(information[first]), total,
            total - float(explained[first]),
            total - float(np.sum((step @ moments) ** 2) / (step ** 2 @ time)),
            total - (float(step @ pressing) ** 2 / weighs if weighs > 0.0 else 0.0),
            (count - first) * BLOCK)


def ramp(lag: float, count: int) -> FloatArray:
    """Give how much of a step is seen after three equal low-passes of a lag [s] (blocks,)."""
    if lag <= 0.0:
        return np.ones(count)
    t = (np.arange(count) + 0.5) * (BLOCK / lag)
    return np.asarray(1.0 - np.exp(-t) * (1.0 + t + 0.5 * t ** 2))


# -- The load sample by sample: a Kalman filter with the mass and the zero of each channel.
#
# All channels come in units of their noise, which over a second is white: its density is 1. What
# is old is forgotten as the mass and the zeros may wander. What comes suddenly is another load
# from an instant on, which is looked for in the recent past: at once where it was announced, and
# where it was not, once it is clear that it is no touch.

@compiled
def observe_load(x: FloatArray, p: FloatArray, left: FloatArray, added: FloatArray, dt: float,
                 wander: float, zero: float) -> None:
    """Advance the filter by one sample; channels have noise of the density 1."""
    size, channels = x.shape[0], left.shape[0]
    p[0, 0] += wander * dt
    gain = np.empty(size)
    for c in range(channels):
        p[1 + c, 1 + c] += zero * dt
        for i in range(size):
            gain[i] = p[i, 0] * added[c] + p[i, 1 + c]
        spread = added[c] * gain[0] + gain[1 + c] + 1.0 / dt
        new = left[c] - added[c] * x[0] - x[1 + c]
        for i in range(size):
            x[i] += gain[i] / spread * new
        for i in range(size):
            for j in range(size):
                p[i, j] -= gain[i] * gain[j] / spread


class LoadObserver:
    """The load that an arm carries [kg], and whether a sudden change is one."""

    REMEMBERED = ('_x', '_p', '_seconds', '_announcing', '_odd', '_waited', '_recent',
                  '_announced', '_kept')

    def __init__(
        self, channels: int, reference: float, lag: float = 0.0, explained: float = BENT_EXPLAINED,
    ) -> None:
        self._channels, self._reference, self._explained = channels, reference, explained
        self._recent = RecentPast(channels, RECENT, lag)
        self._announced = RecentPast(channels, ANNOUNCED, lag)
        self.reset()

    def reset(self) -> None:
        """Know nothing."""
        count = 1 + self._channels
        self._x, self._p = np.zeros(count), np.diag(np.full(count, ZERO ** 2))
        self._p[0, 0] = self._reference ** 2
        self._seconds = 0.0
        self._announcing = False
        self._keep()

    def _keep(self) -> None:
        """Let the past begin now."""
        self._odd, self._waited = False, 0.0
        self._recent.clear()
        self._announced.clear()
        # as many as there are blocks, and the one before them
        self._kept = deque([(self._x.copy(), self._p.copy())], maxlen=round(RECENT / BLOCK) + 1)

    @property
    def mass(self) -> float:
        """Load in addition to what the model knows [kg]."""
        return float(self._x[0])

    @property
    def std(self) -> float:
        """Its standard deviation [kg]."""
        return math.sqrt(max(float(self._p[0, 0]), 0.0))

    def step(
        self, dt: float, left: FloatArray, added: FloatArray, weight: FloatArray, *, held: bool,
        expected: bool = False,
    ) -> float:
        """Take a sample (channels,) into account, dt 0 at a beginning; returns [kg], else zero."""
        dt = min(dt, LARGEST_STEP)
        if dt <= 0.0:
            self._keep()
            return 0.0
        self._seconds = min(self._seconds + dt, BEGUN)
        if expected != self._announcing or (expected and self._announced.full):
            self._announcing = expected
            self._keep()
        if expected and self._seconds >= BEGUN:
            if self._announced.add(dt, left, added, weight):
                self._follow()
            return 0.0
        self._waited = self._waited + dt if held or self._odd else 0.0
        if self._recent.add(dt, left, added, weight):
            found = self._recent.changed(self._kept[0][0], SEEN)
            if found is not None and self._is_load(found):
                self._take(found, *self._kept[0])
                self._keep()
                return found.mass
            self._odd = found is not None and found.came - found.touched > ODD
            self._kept.append((self._x.copy(), self._p.copy()))
        if self._seconds < BEGUN or not (held or self._odd):
            observe_load(self._x, self._p, left, added, dt, (WANDERS * self._reference) ** 2,
                         ZERO_WANDERS ** 2)
        return 0.0

    def _follow(self) -> None:
        """Look for the announced change, from the load of before."""
        before, spread = self._kept[0]
        found = self._announced.changed(before, BLOCK)
        if found is None:
            return
        if found.gain > EXPECTED_GAIN and self._possible(float(before[0]), found):
            self._take(found, before, spread)
            return
        self._x[:], self._p[:] = before, spread
        # it may have come without having shown: no better known than it would be
        self._p[0, 0] += 1.0 / max(found.information, self._reference ** -2)

    def _take(self, found: Change, before: FloatArray, spread: FloatArray) -> None:
        self._x[:], self._p[:] = before, spread
        self._x[0] += found.mass
        self._p[0, :] = self._p[:, 0] = 0.0
        self._p[0, 0] = 1.0 / found.information + (UNSURE * found.mass) ** 2

    def _possible(self, carried: float, found: Change) -> bool:
        return (abs(found.mass) < HEAVIEST * self._reference
                and carried + found.mass > -LIGHTEST * self._reference)

    def _is_load(self, found: Change) -> bool:
        """Say whether a change that nobody has announced is clearly one of the load."""
        stayed = self._waited >= LASTING
        lightest, pressed = (LIGHTER, TOUCH) if stayed else (LIGHTEST, PRESSED)
        return (self._seconds >= BEGUN and found.since > SOONEST - 0.5 * BLOCK
                and found.gain > LOUD
                and abs(found.mass) > lightest * self._reference
                and self._possible(float(self._kept[0][0][0]), found)
                and found.left < self._explained * found.came
                and found.left < TOUCH * found.touched
                and found.left < pressed * found.pressed)


# -- Samples in units of the noise of a model, whose density is then 1

Sensed = tuple[FloatArray, FloatArray, FloatArray]
"""Residual of a model without the load, what a kilogram adds, and what its weight adds without its
inertia (a force that is held at the tip), (channels,)."""


class RigidSense:
    """Residuals of a model of rigid bodies, each channel by itself."""

    # Its error is no white noise. It counts by what it has over a second: its mean square times
    # the time for which it depends on itself, more so where the arm accelerates, which is when
    # links ring.

    lag = 0.0
    explained = RIGID_EXPLAINED
    REMEMBERED = '_now', '_usual', '_seconds'

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
    REMEMBERED = ()

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
        motion = links_of(states[:, None], self._bent.bending)
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

    REMEMBERED: ClassVar[tuple[str, ...]] = ()  # of an alarm, see `online.memory`

    def __init__(self, bundle: ModelBundle, known: float) -> None:
        self.worth = load_worth(bundle.arm, bundle.models)
        if not self.worth:
            raise ModelError('the model cannot estimate loads in kg; fit one to bags of two loads '
                             '(tudor fit --payload-of), or with effort.torque_constant or '
                             'sensors[].gain in the arm description')
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
        return predicted if not more else {
            output: values + more * self.worth[output].along(row[None])[0]
            if output in self.worth else values for output, values in predicted.items()}


class PayloadStage(CarriedLoad):
    """Follows the load of the arm: known [kg]."""

    REMEMBERED = 'observer', '_sense'

    def __init__(self, bundle: ModelBundle, known: float) -> None:
        super().__init__(bundle, known)
        self._sense, reference = self._sensed(bundle)
        channels = len(bundle.models[self.output]['analytical'].channels)
        self.observer = LoadObserver(channels, reference, self._sense.lag, self._sense.explained)
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
        return self.known + self.observer.mass

    @property
    def std(self) -> float:
        """Give its standard deviation [kg]."""
        return self.observer.std

    def step(
        self, stamp: int, dt: float, row: FloatArray, measured: FloatArray, *, touched: bool,
    ) -> LoadFound | None:
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


def load_facts(load: CarriedLoad | None, bundle: ModelBundle, payload: float) -> dict[str, Any]:
    """Give mass and deviation, None where nobody estimates it [kg], and source of a load."""
    if load is not None:
        std = load.std if isinstance(load, PayloadStage) else None
        return {'mass': load.mass, 'std': std, 'source': 'topic' if std is None else 'estimate'}
    known = bundle.payload_range is None and bundle.payload is not None
    return {'mass': bundle.mass_at(payload), 'std': None,
            'source': 'model' if known else 'parameter'}


def load_text(mass: float, std: float | None, source: str) -> str:
    """Say what `load_facts` gives."""
    if std is not None:
        return f'load {mass:.3f} +- {std:.3f} kg, estimated'
    if source == 'topic':
        return f'load {mass:.3f} kg (topic payload)'
    where = 'of the model' if source == 'model' else 'parameter payload'
    return f'load {mass:g} kg assumed ({where})' if mass else 'no load assumed'


def carried_load(source: str, bundle: ModelBundle, payload: float) -> CarriedLoad | None:
    """Give what follows the load, by where it is known from; None for ``parameter``."""
    if source == 'parameter':
        return None
    return (PayloadStage if source == 'estimate' else CarriedLoad)(
        bundle, bundle.mass_at(payload))
