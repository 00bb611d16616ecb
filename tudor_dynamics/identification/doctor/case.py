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

"""A bag ready to be compared with alternatives: decimated rows, and what they explain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification import settings
from tudor_dynamics.load.rows import friction_terms
from tudor_dynamics.models.friction import Coupling
from tudor_dynamics.models.regressor import regressor_of
from tudor_dynamics.signals.filters import zero_phase
from tudor_dynamics.typing import FloatArray, IndexArray


class Delay(NamedTuple):
    """How late an output comes."""

    seconds: FloatArray | float = 0.0  # of each channel, or of all [s]
    rate: float = 0.0  # by how much it grows with time: a clock that runs fast [s/s]

    @property
    def size(self) -> float:
        """Give that of all channels, or of the one that is late, at first [s]."""
        return round(float(np.sum(self.seconds)), 4)

    def undone(self, t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
        """Give values (n, channels) as if they had not come late, at other times than t [s]."""
        each = np.broadcast_to(self.seconds, values.shape[1])
        return np.stack([np.interp((1.0 + self.rate) * at + late, t, column)
                         for late, column in zip(each, values.T, strict=True)], axis=1)


@dataclass(frozen=True, eq=False)
class Part:
    """A gapless stretch at the full rate, smoothed."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    keep: IndexArray  # samples that are used
    signals: dict[str, FloatArray]  # (n, channels): `q`, `effort`, `strain`, `velocity`, if any


@dataclass(frozen=True, eq=False)
class Decimated:
    """What the doctor compares: motion and outputs of the same bandwidth."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    motion: FloatArray  # from the positions alone
    parts: tuple[Part, ...]  # stretches they come from

    def has(self, name: str) -> bool:
        """Say whether an output, or the driver's velocity, of this name is there."""
        return name in self.parts[0].signals

    def output(self, name: str, late: Delay = Delay()) -> FloatArray:
        """Give an output on the samples kept, (n, channels), as if it had not come late."""
        return np.vstack([late.undone(part.t, part.signals[name], part.t[part.keep])
                          for part in self.parts])


def decimate(recording: Recording) -> Decimated | None:
    """Decimate a recording after smoothing; returns None where no stretch is long enough."""
    t_all = recording.t
    chosen = [part for part in recording.segments
              if t_all[part.stop - 1] - t_all[part.start] >= settings.LEAST_SECONDS
              and part.stop - part.start >= settings.LEAST_SAMPLES]
    if not chosen:
        return None
    seconds = sum(float(t_all[part.stop - 1] - t_all[part.start]) for part in chosen)
    wanted = max(settings.LEAST_STEP, seconds / settings.MOST_SAMPLES)
    cutoff = min(settings.CUTOFF, 0.2 / recording.dt)
    signals = {name: values for name, values in (
        ('q', recording.q), ('effort', recording.effort), ('strain', recording.strain),
        ('velocity', recording.dq)) if values is not None}
    ends = np.cumsum([values.shape[1] for values in signals.values()])
    parts, motions, times = [], [], []
    for part in chosen:
        t = t_all[part]
        states = zero_phase(t, np.hstack([values[part] for values in signals.values()]), cutoff)
        factor = max(1, int(wanted / ((t[-1] - t[0]) / (len(t) - 1))))
        begin, end = np.searchsorted(t, [t[0] + settings.MARGIN, t[-1] - settings.MARGIN])
        keep = np.arange(int(begin), int(end), factor)
        motions.append(np.hstack([x[keep, :ends[0]] for x in (states.q, states.dq, states.ddq)]))
        times.append(t[keep])
        smooth = np.split(states.q, ends[:-1], axis=1)
        parts.append(Part(t, keep, dict(zip(signals, smooth, strict=True))))
    return Decimated(np.concatenate(times), np.vstack(motions), tuple(parts))


class BodyRows:
    """Rows of an output, linear in the parameters of the bodies."""

    def __init__(self, arm: Arm, output: str) -> None:
        self._regressor = regressor_of(arm.with_joints({
            joint.name: {'friction': (), 'rotor_inertia': False} for joint in arm.joints}),
            output, 'exact')
        self.channels, self.groups = self._regressor.channels, self._regressor.groups
        self._joints = arm.joints if output == 'effort' else ()
        self._coupling = Coupling(arm)

    def rows(self, motion: FloatArray) -> FloatArray:
        """Evaluate the bodies by columns (n, channels, columns)."""
        rows = self._regressor.rows(motion)
        return rows if self._joints else rows[:, :, :-1]  # the last is the offset of a gauge

    def own(self, motion: FloatArray) -> list[FloatArray]:
        """Evaluate what each channel has to itself: rotor, friction and offset, or an offset."""
        if not self._joints:
            return [np.ones((len(motion), 1))] * len(self.channels)
        _, speeds, rates = np.split(self._coupling.of_joints(motion), 3, axis=1)
        terms = [np.column_stack([ddq, friction_terms(dq, joint.friction_velocity)])
                 for joint, dq, ddq in zip(
                     self._joints, (speeds @ self._coupling.speeds.T).T,
                     (rates @ self._coupling.speeds.T).T, strict=True)]
        return [np.hstack([own, *(terms[k][:, :3] for k in np.flatnonzero(reach) if k != i)])
                for i, (own, reach) in enumerate(zip(terms, self._coupling.reach, strict=True))]


class Explained:
    """Rows, freed of what each channel has to itself; channels of a group share parameters."""

    def __init__(
        self, rows: FloatArray, own: Sequence[FloatArray], groups: Sequence[tuple[int, ...]],
    ) -> None:
        self.groups, self.own = groups, own
        self.bodies = [rows[:, i] for i in range(rows.shape[1])]
        self._bases = [_orthonormal(x) for x in own]
        self._rows = [x - basis @ (basis.T @ x)
                      for x, basis in zip(self.bodies, self._bases, strict=True)]
        self._grams = [x.T @ x for x in self._rows]

    def freed(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values of what a channel has to itself: values (n,) or (lags, n)."""
        basis = self._bases[channel]
        return np.asarray(values - (basis @ (basis.T @ values.T)).T)

    def residuals(self, outputs: FloatArray) -> FloatArray:
        """Give the residual of each channel, of outputs ([lags,] n, channels)."""
        known = self.parameters(outputs)
        return np.stack([self.freed(i, outputs[..., i]) - (rows @ known[..., i, :].T).T
                         for i, rows in enumerate(self._rows)], axis=-1)

    def parameters(self, outputs: FloatArray) -> FloatArray:
        """Estimate the bodies, ([lags,] channels, columns), by outputs ([lags,] n, channels)."""
        found = np.empty((*outputs.shape[:-2], outputs.shape[-1], self._rows[0].shape[1]))
        for group in self.groups:
            free = [self.freed(i, outputs[..., i]) for i in group]
            sizes = np.array([np.std(outputs[..., i], axis=-1) for i in group])
            varies = sizes > 0.0  # what never changes has no say
            safe = np.where(varies, sizes, 1.0)
            weights = varies / safe
            for _ in range(settings.PASSES if len(group) > 1 else 1):
                gram = sum(w[..., None, None] ** 2 * self._grams[i]
                           for w, i in zip(weights, group, strict=True))
                right = sum(w[..., None] ** 2 * (self._rows[i].T @ y.T).T
                            for w, i, y in zip(weights, group, free, strict=True))
                parameters = _solve(np.asarray(gram), np.asarray(right))
                spread = [np.sqrt(np.mean((y - (self._rows[i] @ parameters.T).T) ** 2, axis=-1))
                          for i, y in zip(group, free, strict=True)]
                weights = varies / np.maximum(spread, settings.LEAST_RESIDUAL * safe)
            found[..., list(group), :] = parameters[..., None, :]
        return found

    def shares(self, outputs: FloatArray) -> FloatArray:
        """Give what part remains of the variances of outputs ([lags,] n, channels)."""
        return share_of(self.residuals(outputs), outputs)

    def rest(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values (n,) or (n, columns) of all that one channel's rows can explain."""
        free, rows = self.freed(channel, values.T), self._rows[channel]
        return np.asarray(free.T - rows @ _solve(self._grams[channel], (rows.T @ free.T).T).T)

    def own_parameters(
        self, channel: int, values: FloatArray, parameters: FloatArray,
    ) -> FloatArray:
        """Give a channel's own parameters (own,) by values (n,), for known ones of the bodies."""
        return _fitted(self.own[channel], values - self.bodies[channel] @ parameters)

    def predicted(self, channel: int, values: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
        """Learn one channel (n,) from some samples, and predict all of them."""
        columns = np.column_stack([self.bodies[channel], self.own[channel]])
        return np.asarray(columns @ _fitted(columns[known], values[known], settings.PREDICTING))

    def friction(self, channel: int, output: FloatArray) -> tuple[float, float]:
        """Correlate friction with speed; say how much larger the residual is without friction."""
        own, rows = self.own[channel], self.bodies[channel]
        both = np.column_stack([rows, own])
        few = np.column_stack([rows, np.delete(own, (1, 2), axis=1)])
        values = _fitted(both, output)
        friction, speed = own[:, 1:3] @ values[-own.shape[1]:][1:3], own[:, 1]
        size = float(np.sqrt(np.mean(friction ** 2) * np.mean(speed ** 2)))
        power = float(np.mean(friction * speed)) / size if size > 0.0 else 0.0
        least = settings.FLOOR * float(np.sum((output - output.mean()) ** 2))
        rest = max(float(np.sum((output - both @ values) ** 2)), least, 1e-300)
        return power, float(np.sum((output - few @ _fitted(few, output)) ** 2)) / rest


def share_of(residual: FloatArray, outputs: FloatArray) -> FloatArray:
    """Give the share of the variance of outputs that remains, never below `FLOOR`."""
    axis = max(outputs.ndim - 2, 0)  # samples, of one channel or of several
    total = np.sum((outputs - outputs.mean(axis=axis, keepdims=True)) ** 2, axis=axis)
    rest = np.sum(residual ** 2, axis=axis)
    # what never changes has nothing to be explained
    return np.where(total > 0.0, np.maximum(rest / np.where(total > 0.0, total, 1.0),
                                            settings.FLOOR), 1.0)


def _orthonormal(columns: FloatArray) -> FloatArray:
    scale = np.linalg.norm(columns, axis=0)
    used = columns[:, scale > 1e-12 * max(float(scale.max()), 1e-300)]
    return np.asarray(np.linalg.qr(used / np.linalg.norm(used, axis=0))[0])


def _fitted(
    columns: FloatArray, values: FloatArray, smallest: float = settings.SMALLEST,
) -> FloatArray:
    return _solve(columns.T @ columns, columns.T @ values, smallest)


def _solve(gram: FloatArray, right: FloatArray, smallest: float = settings.SMALLEST) -> FloatArray:
    """Solve scaled normal equations (..., columns), without the directions that are not there."""
    scale = np.sqrt(np.diagonal(gram, axis1=-2, axis2=-1))
    seen = scale > 1e-10 * np.maximum(scale.max(axis=-1, initial=0.0, keepdims=True), 1e-300)
    safe = np.where(seen, scale, 1.0)
    scaled = np.where(seen[..., None] & seen[..., None, :], gram, 0.0) / (
        safe[..., None] * safe[..., None, :])
    values, vectors = np.linalg.eigh(scaled)
    good = values > smallest * np.maximum(values[..., -1:], 1e-300)
    inverse = np.where(good, 1.0 / np.where(good, values, 1.0), 0.0)[..., None]
    freed = np.swapaxes(vectors, -2, -1) @ (right / safe)[..., None]
    return np.asarray((vectors @ (inverse * freed))[..., 0] / safe * seen)


@dataclass(frozen=True, eq=False)
class Case:
    """What is known of a bag, and how much of its outputs the description explains."""

    arm: Arm
    recording: Recording  # without its outliers
    decimated: Decimated
    broken: frozenset[str] = frozenset()  # channels that never change, die, ...: taken for zero
    units: Mapping[str, float] = field(default_factory=dict)  # joint to a factor of its effort

    @property
    def motion(self) -> FloatArray:
        """Give `[q, dq, ddq]` of the samples that are compared."""
        return self.decimated.motion

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Say which joints move."""
        n = self.motion.shape[1] // 3
        return np.asarray(np.ptp(self.motion[:, :n], axis=0) > settings.MOVING_SPAN)

    @cached_property
    def bodies(self) -> dict[str, BodyRows]:
        """Give the rows of each output that was recorded."""
        return {name: BodyRows(self.arm, name) for name in OUTPUTS
                if self.decimated.has(name)}

    @cached_property
    def sound(self) -> dict[str, NDArray[np.bool_]]:
        """Say which channels of each output have values that count."""
        return {name: np.array([one not in self.broken for one in bodies.channels])
                for name, bodies in self.bodies.items()}

    def output(self, name: str, late: Delay = Delay()) -> FloatArray:
        """Give an output in the unit described, as if it had not come late; (n, channels)."""
        # what never changes leaves the same whatever is changed
        values = np.where(self.sound[name], self.decimated.output(name, late), 0.0)
        return values if name == 'strain' else values / [
            self.units.get(joint, 1.0) for joint in self.arm.active_joints]

    @cached_property
    def outputs(self) -> dict[str, FloatArray]:
        """Give all outputs as they came: (n, channels)."""
        return {name: self.output(name) for name in self.bodies}

    def explained(
        self, motion: FloatArray | None = None, arm: Arm | None = None,
    ) -> dict[str, Explained]:
        """Build least squares of all outputs for other motion or another description."""
        x = self.motion if motion is None else motion
        described = self.bodies if arm is None else {
            name: BodyRows(arm, name) for name in self.bodies}
        return {name: Explained(bodies.rows(x), bodies.own(x), bodies.groups)
                for name, bodies in described.items()}

    @property
    def brevity(self) -> float:
        """Say how much shorter the recording is than one that shows enough; 1 or more."""
        seconds = float(self.decimated.t[-1] - self.decimated.t[0])
        return max(1.0, settings.ENOUGH_SECONDS / seconds)

    @cached_property
    def usual(self) -> dict[str, Explained]:
        """Build the least squares of the description as it is, once."""
        return self.explained()

    @cached_property
    def now(self) -> FloatArray:
        """Give the share that remains of the variance of each channel of all outputs."""
        return np.concatenate([explained.shares(self.outputs[name])
                               for name, explained in self.usual.items()])


def gain(now: FloatArray, other: FloatArray) -> float:
    """Say how much better an alternative is: the sum of log ratios of the shares that remain."""
    # up to a factor, twice the logarithm of the likelihood ratio of channels with unknown noise
    return float(np.sum(np.log(now / other)))


def unit_scale(scale: float) -> float:
    """Take a scale of efforts that is nearly a thousand or a thousandth for it."""
    return next((exact for exact in (1e3, 1e-3) if 1.0 / settings.NEARLY < abs(scale) / exact
                 < settings.NEARLY), scale)


def relative(shares: FloatArray) -> float:
    """Give the relative residual of all channels from their shares, each with the same weight."""
    return float(np.sqrt(np.mean(shares)))
