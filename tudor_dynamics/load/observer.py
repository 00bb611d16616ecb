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

"""The load sample by sample: a Kalman filter, and when the load changed."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, Protocol

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.load.bending import BentLinks
from tudor_dynamics.load.rows import LoadWorth
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model
from tudor_dynamics.signals.filters import SmoothStates
from tudor_dynamics.typing import FloatArray


# -- When the load changed, and whether it was a load at all.
#
# Over the last part of the past every instant is tried: before it the load was what it had been,
# behind it another one. The best of them is what least squares leave the least over with (the
# generalised likelihood ratio of Willsky and Jones, IEEE TAC 21(1), 1976). It is a load where that
# explains nearly all of what came, since a mass in the hand has one number for all channels, poses
# and accelerations; a touch elsewhere, or in another direction, has other levers and does not turn
# with the arm. A force that is held downwards at the tip has its levers, but no inertia: links
# ring with a load as they do with its mass, and with that force as they do without.

BLOCK = 0.05
"""Time over which samples are summed up [s]."""
SCALARS = 7
"""Sums before those by channel: squares of what is left, its products with what a kilogram adds,
squares of that, time; products of its weight with what is left, and with what it adds, squares."""


@dataclass(frozen=True)
class Change:
    """The best instant for a change of the load, and what speaks for it."""

    mass: float  # by how much the load has changed [kg]
    information: float  # of that: one by the variance [1/kg^2]
    # What was left over from that instant on with the load of before: squares in units of the
    # noise.
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
    left: FloatArray, worth: FloatArray, weight: FloatArray, dt: float, sums: FloatArray,
) -> None:
    """Add a sample to the sums of a block."""
    channels = left.shape[0]
    for c in range(channels):
        sums[0] += left[c] * left[c] * dt
        sums[1] += left[c] * worth[c] * dt
        sums[2] += worth[c] * worth[c] * dt
        sums[4] += left[c] * weight[c] * dt
        sums[5] += worth[c] * weight[c] * dt
        sums[6] += weight[c] * weight[c] * dt
        sums[SCALARS + c] += left[c] * dt
        sums[SCALARS + channels + c] += worth[c] * dt
        sums[SCALARS + 2 * channels + c] += weight[c] * dt
    sums[3] += dt


@compiled
def best_change(
    blocks: FloatArray, x: FloatArray, ramp: FloatArray, least: int, out: FloatArray,
) -> None:
    """
    Try each block as the first of another load.

    ``x`` are load and zeros of before; ``ramp`` is how much of a change is seen so many blocks
    behind it. ``out`` takes mass, information, what came, what is left, what a touch leaves, what
    a force at the tip leaves, and the number of blocks; nothing where all information is zero.
    """
    count = blocks.shape[0]
    channels = x.shape[0] - 1
    own = np.empty((count, 4 + channels))
    for i in range(count):
        block = blocks[i]
        square, cross, extent = block[0], block[1], block[2]
        own[i, 0] = square - 2.0 * x[0] * cross + x[0] * x[0] * extent
        own[i, 1] = cross - x[0] * extent
        own[i, 2] = extent
        own[i, 3] = block[4] - x[0] * block[5]
        for c in range(channels):
            zero = x[1 + c]
            there, worth = block[SCALARS + c], block[SCALARS + channels + c]
            own[i, 0] += zero * (zero * block[3] - 2.0 * there + 2.0 * x[0] * worth)
            own[i, 1] -= zero * worth
            own[i, 3] -= zero * block[SCALARS + 2 * channels + c]
            own[i, 4 + c] = there - x[0] * worth - zero * block[3]
    most = 0.0
    for first in range(count - least + 1):
        along = extent = 0.0
        for i in range(first, count):
            seen = ramp[i - first]
            along += seen * own[i, 1]
            extent += seen * seen * own[i, 2]
        if extent <= 0.0 or along * along <= most * extent:
            continue
        most = along * along / extent
        out[0], out[1], out[6] = along / extent, extent, count - first
    if most <= 0.0:
        return
    first = count - int(out[6])
    moments = np.zeros(channels)
    extent = pressing = pressed = 0.0
    for i in range(first, count):
        seen = ramp[i - first]
        out[2] += own[i, 0]
        extent += seen * seen * blocks[i, 3]
        pressing += seen * own[i, 3]
        pressed += seen * seen * blocks[i, 6]
        for c in range(channels):
            moments[c] += seen * own[i, 4 + c]
    out[3] = out[2] - most
    out[4] = out[5] = out[2]
    if pressed > 0.0:
        out[5] -= pressing * pressing / pressed
    for c in range(channels):
        out[4] -= moments[c] * moments[c] / extent


class RecentPast:
    """Sums of the last samples, by blocks: longest [s], ramp (blocks,)."""

    def __init__(self, channels: int, longest: float, ramp: FloatArray) -> None:
        self._most = round(longest / BLOCK)
        self._ramp = ramp
        self._blocks = np.zeros((self._most + 1, SCALARS + 3 * channels))
        self._out = np.zeros(7)
        self.clear()

    def clear(self) -> None:
        """Forget the past."""
        self._blocks[:] = 0.0
        self._full = 0

    @property
    def full(self) -> bool:
        """Say whether there is no place for another block."""
        return self._full == self._most

    def add(
        self, dt: float, left: FloatArray, worth: FloatArray, weight: FloatArray,
    ) -> bool:
        """
        Add a sample, in units of its noise; say whether a block is full with it.

        dt [s], left, worth, weight (channels,).
        """
        newest = self._blocks[self._full]
        add_sample(left, worth, weight, dt, newest)
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
        blocks = max(1, round(least / BLOCK))
        if self._full < blocks:
            return None
        out = self._out
        out[:] = 0.0
        best_change(self._blocks[:self._full], x, self._ramp, blocks, out)
        mass, information, came, left, touched, pressed, count = out.tolist()
        if not count:
            return None
        return Change(mass, information, came, left, touched, pressed, count * BLOCK)


# -- The load sample by sample: a Kalman filter with the mass and the zero of each channel.
#
# All channels come in units of their noise, which over a second is white: its density is 1. What
# is old is forgotten as the mass and the zeros may wander. What comes suddenly is another load
# from an instant on, which is looked for in the recent past: at once where it was announced, and
# where it was not, once it is clear that it is no touch.

WANDERS = 0.005
"""Of the mass, in payloads of the model over a second."""
ZERO, ZERO_WANDERS = 1.0, 0.03
"""Of a channel in its noise: as it is not known at first, and over a second."""
BEGUN = 2.0
"""Time for which the load that is there at the beginning is learned, touched or not [s]."""
RECENT, ANNOUNCED = 1.2, 4.0
"""Past in which a change is looked for, and the same while one is announced [s]."""
SEEN, SOONEST = 0.2, 0.6
"""Time since a change until it is looked for, and until it is told if not announced [s]."""
EXPECTED_GAIN = 6.0
"""What an announced change explains at least; by chance it is 1."""
LOUD = 40.0
"""What any other explains at least."""
TOUCH = 1.3
"""A load explains it as well as a moment that stays, but for this."""
PRESSED = 0.9
"""Part of what its weight without inertia leaves over that a load leaves at most, until it has
stayed: on an arm that does not move the two are the same."""
LIGHTEST, HEAVIEST = 0.12, 1.5
"""Loads that are told from touches, in payloads of the model."""
LASTING, LIGHTER = 3.0, 0.02
"""What has stayed for so long [s] is a load from so little on, and be it as its weight alone."""
ODD = 60.0
"""What a moment that stays explains at least of what came, if something touches the arm."""
UNSURE = 0.05
"""Part of a load that has just come by which it may be wrong, beside its own noise."""
LARGEST_STEP = 0.1
"""A sample stands for no more time than this [s]."""


@compiled
def observe_load(x: FloatArray, p: FloatArray, left: FloatArray, worth: FloatArray, dt: float,
                 wander: float, zero: float) -> None:
    """Advance the filter by one sample; channels have noise of the density 1."""
    size, channels = x.shape[0], left.shape[0]
    p[0, 0] += wander * dt
    gain = np.empty(size)
    for c in range(channels):
        p[1 + c, 1 + c] += zero * dt
        for i in range(size):
            gain[i] = p[i, 0] * worth[c] + p[i, 1 + c]
        spread = worth[c] * gain[0] + gain[1 + c] + 1.0 / dt
        new = left[c] - worth[c] * x[0] - x[1 + c]
        for i in range(size):
            x[i] += gain[i] / spread * new
        for i in range(size):
            for j in range(size):
                p[i, j] -= gain[i] * gain[j] / spread


class LoadObserver:
    """
    The load that an arm carries, and whether what came suddenly is one.

    reference [kg], lag [s].
    """

    def __init__(
        self, channels: int, reference: float, lag: float = 0.0, explained: float = 0.15,
    ) -> None:
        self._channels, self._reference, self._explained = channels, reference, explained
        seen = ramp(lag, round(ANNOUNCED / BLOCK))
        self._recent = RecentPast(channels, RECENT, seen)
        self._announced = RecentPast(channels, ANNOUNCED, seen)
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
        """Load beside what the model knows [kg]."""
        return float(self._x[0])

    @property
    def std(self) -> float:
        """Its standard deviation [kg]."""
        return math.sqrt(max(float(self._p[0, 0]), 0.0))

    def step(
        self, dt: float, left: FloatArray, worth: FloatArray, weight: FloatArray, *, held: bool,
        expected: bool = False,
    ) -> float:
        """
        Take a sample into account.

        left, worth, weight (channels,); dt [s]: 0 at a beginning; returns [kg], zero otherwise.
        """
        dt = min(dt, LARGEST_STEP)
        if dt <= 0.0:
            self._keep()
            return 0.0
        self._seconds = min(self._seconds + dt, BEGUN)
        if expected != self._announcing or (expected and self._announced.full):
            self._announcing = expected
            self._keep()
        if expected and self._seconds >= BEGUN:
            if self._announced.add(dt, left, worth, weight):
                self._follow()
            return 0.0
        self._waited = self._waited + dt if held or self._odd else 0.0
        if self._recent.add(dt, left, worth, weight):
            found = self._recent.changed(self._kept[0][0], SEEN)
            if found is not None and self._told(found):
                self._take(found, *self._kept[0])
                self._keep()
                return found.mass
            self._odd = found is not None and found.came - found.touched > ODD
            self._kept.append((self._x.copy(), self._p.copy()))
        if self._seconds < BEGUN or not (held or self._odd):
            observe_load(self._x, self._p, left, worth, dt, (WANDERS * self._reference) ** 2,
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

    def _told(self, found: Change) -> bool:
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


def ramp(lag: float, count: int) -> FloatArray:
    """
    Give how much of a step is seen behind three equal low-passes.

    lag [s]; returns (blocks,).
    """
    if lag <= 0.0:
        return np.ones(count)
    t = (np.arange(count) + 0.5) * (BLOCK / lag)
    return np.asarray(1.0 - np.exp(-t) * (1.0 + t + 0.5 * t ** 2))


# -- What a load is told by, sample by sample, in units of the noise of a model

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
