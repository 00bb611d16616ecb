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

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.identification.doctor import settings
from tudor_dynamics.identification.doctor.settings import FLOOR
from tudor_dynamics.models.friction import Coupling
from tudor_dynamics.models.rigid_bodies import RigidBodies
from tudor_dynamics.signals.filters import zero_phase
from tudor_dynamics.typing import FloatArray, IndexArray


@dataclass(frozen=True, eq=False)
class Part:
    """A gapless stretch at the full rate, smoothed."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    keep: IndexArray  # samples that are used
    # (n, channels): `effort`, `strain` and `velocity`, where there are some.
    outputs: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Decimated:
    """What the doctor compares: motion and outputs of the same bandwidth."""

    t: FloatArray  # time since the start of the recording, (n,) [s]
    # `[q, dq, ddq]`, from the positions alone, (n, 3 joints)
    # [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    parts: tuple[Part, ...]  # stretches they come from

    def has(self, name: str) -> bool:
        """Say whether an output, or the driver's velocity, of this name is there."""
        return name in self.parts[0].outputs

    def output(self, name: str, lag: float = 0.0) -> FloatArray:
        """
        Give an output on the samples kept, as if it had come earlier.

        lag [s]; returns (n, channels) [its unit].
        """
        found = []
        for part in self.parts:
            values = part.outputs[name]
            if lag == 0.0:
                found.append(values[part.keep])
            else:
                at = part.t[part.keep] + lag
                found.append(np.stack([np.interp(at, part.t, column) for column in values.T],
                                      axis=1))
        return np.vstack(found)


def decimate(recording: Recording) -> Decimated | None:
    """Decimate a recording after smoothing; returns None where no stretch is long enough."""
    t_all = recording.t
    chosen = [part for part in recording.segments
              if t_all[part.stop - 1] - t_all[part.start] >= settings.LEAST_SECONDS
              and part.stop - part.start >= 64]
    if not chosen:
        return None
    seconds = sum(float(t_all[part.stop - 1] - t_all[part.start]) for part in chosen)
    wanted = max(settings.LEAST_STEP, seconds / settings.MOST_SAMPLES)
    cutoff = min(settings.CUTOFF, 0.2 / recording.dt)
    n_joints = recording.q.shape[1]
    parts, motions, times = [], [], []
    for part in chosen:
        t = t_all[part]
        columns = {'position': recording.q[part]}
        for name, values in (('effort', recording.effort), ('strain', recording.strain),
                             ('velocity', recording.dq)):
            if values is not None:
                columns[name] = values[part]
        states = zero_phase(t, np.hstack(list(columns.values())), cutoff)
        factor = max(1, int(wanted / ((t[-1] - t[0]) / (len(t) - 1))))
        begin, end = np.searchsorted(t, [t[0] + settings.MARGIN, t[-1] - settings.MARGIN])
        keep = np.arange(int(begin), int(end), factor)
        motions.append(np.hstack([x[keep, :n_joints] for x in (states.q, states.dq, states.ddq)]))
        times.append(t[keep])
        outputs, first = {}, n_joints
        for name, values in list(columns.items())[1:]:
            outputs[name] = states.q[:, first:first + values.shape[1]]
            first += values.shape[1]
        parts.append(Part(t, keep, outputs))
    return Decimated(np.concatenate(times), np.vstack(motions), tuple(parts))


class BodyRows:
    """Rows of an output, linear in the parameters of the bodies and in gravity."""

    def __init__(self, arm: Arm, output: str) -> None:
        strain = output == 'strain'
        self.model = pin.Model(arm.gauge_model if strain else arm.model)
        self.gravity = np.array(arm.spec.gravity)
        self.channels = arm.gauge_names if strain else arm.active_joints
        self._bodies = RigidBodies(self.model, self._places(arm.active_joints),
                                   self._places(self.channels))
        alone = [(i,) for i in range(len(self.channels))]
        known = () if strain else tuple(
            i for i, joint in enumerate(arm.joints)
            if joint.effort.unit != 'A' or joint.effort.torque_constant is not None)
        self.groups: tuple[tuple[int, ...], ...] = tuple(
            ([known] if known else []) + [one for one in alone if one[0] not in known])
        self.scale = np.array([1.0] * len(self.channels) if strain else
                              [joint.effort.torque_constant or 1.0 for joint in arm.joints])
        self._own = output == 'effort'
        self._sharp = np.array([joint.friction_velocity for joint in arm.joints])
        self._coupling = Coupling(arm)

    def _places(self, names: tuple[str, ...]) -> np.ndarray:
        return np.array([self.model.joints[self.model.getJointId(name)].idx_v for name in names],
                        dtype=np.intp)

    def rows(self, motion: FloatArray, gravity: FloatArray | None = None) -> FloatArray:
        """
        Evaluate the rows of the bodies.

        gravity (3,) [m/s^2]; motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (n, channels, columns).
        """
        out = np.zeros((len(motion), len(self.channels), 10 * (self.model.njoints - 1)))
        self._bodies.rows(self._coupling.of_joints(motion), out,
                          self.gravity if gravity is None else gravity)
        if self._own:
            self._coupling.mix(out)
        return out / self.scale[None, :, None]

    def of_gravity(self, motion: FloatArray) -> FloatArray:
        """
        Evaluate what gravity along each axis of the base adds to the rows.

        motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints, the positions count; returns
        (3, n, channels, columns).
        """
        still = motion.copy()
        still[:, motion.shape[1] // 3:] = 0.0
        return np.stack([self.rows(still, axis) for axis in np.eye(3)])

    def own(self, motion: FloatArray) -> list[FloatArray]:
        """
        Evaluate what each channel has to itself: rotor, friction and offset, or an offset.

        motion (n, 3 joints): ``[q, dq, ddq]`` of the active joints; returns (n, own).
        """
        ones = np.ones((len(motion), 1))
        if not self._own:
            return [ones] * len(self.channels)
        n = len(self.channels)
        joints, speeds = self._coupling.of_joints(motion), self._coupling.speeds
        terms = []
        for dq, ddq, least in zip((joints[:, n:2 * n] @ speeds.T).T,
                                  (joints[:, 2 * n:] @ speeds.T).T, self._sharp, strict=True):
            sharp = max(float(least), 0.03 * float(np.sqrt(np.mean(dq ** 2))), 1e-9)
            terms.append(np.column_stack([ddq, dq, np.tanh(dq / sharp)]))
        reach = self._coupling.reach != 0.0
        return [np.hstack([terms[i], ones, *(
            terms[k] for k in np.flatnonzero(reach[i]) if k != i)]) for i in range(n)]


class Explained:
    """
    Rows, freed of what each channel has to itself, ready for many candidates of the outputs.

    Channels of a group share their parameters and are weighted by their residuals.

    rows (n, channels, columns), own (n, own).
    """

    def __init__(
        self, rows: FloatArray, own: Sequence[FloatArray], groups: Sequence[tuple[int, ...]],
    ) -> None:
        self.groups = tuple(groups)
        self._plain, self._bodies = tuple(own), [rows[:, i] for i in range(rows.shape[1])]
        self._own = [_orthonormal(x) for x in own]
        self._rows = [rows[:, i] - basis @ (basis.T @ rows[:, i])
                      for i, basis in enumerate(self._own)]
        self._grams = [x.T @ x for x in self._rows]

    def freed(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values of what a channel has to itself: values (n,)."""
        basis = self._own[channel]
        return np.asarray(values - basis @ (basis.T @ values))

    def residuals(self, outputs: FloatArray) -> FloatArray:
        """Give the residual of each channel: outputs (n, channels); returns (n, channels)."""
        return np.column_stack([
            self.freed(i, outputs[:, i]) - self._rows[i] @ x
            for i, x in enumerate(self.parameters(outputs))])

    def parameters(self, outputs: FloatArray) -> FloatArray:
        """
        Give the parameters of the bodies.

        outputs (n, channels); returns (channels, columns).
        """
        found = np.empty((outputs.shape[1], self._rows[0].shape[1]))
        for group in self.groups:
            free = [self.freed(i, outputs[:, i]) for i in group]
            sizes = np.array([float(np.std(outputs[:, i])) for i in group])
            varies = sizes > 0.0  # what never changes has no say
            safe = np.where(varies, sizes, 1.0)
            weights = varies / safe
            for _ in range(settings.PASSES if len(group) > 1 else 1):
                gram = sum(w ** 2 * self._grams[i] for w, i in zip(weights, group, strict=True))
                right = sum(w ** 2 * (self._rows[i].T @ y)
                            for w, i, y in zip(weights, group, free, strict=True))
                parameters = _solve(np.asarray(gram), np.asarray(right))
                residual = [y - self._rows[i] @ parameters
                            for i, y in zip(group, free, strict=True)]
                spread = np.array([np.sqrt(np.mean(x ** 2)) for x in residual])
                weights = varies / np.maximum(spread, 0.03 * safe)
            found[list(group)] = parameters
        return found

    def shares(self, outputs: FloatArray) -> FloatArray:
        """
        Give the share of each channel's variance that remains.

        outputs (n, channels); returns (channels,).
        """
        return share_of(self.residuals(outputs), outputs)

    def alone(self, channel: int, candidates: FloatArray) -> FloatArray:
        """
        Give the share of each candidate's variance that remains after one channel's rows.

        candidates (n, candidates); returns (candidates,).
        """
        basis, rows = self._own[channel], self._rows[channel]
        free = candidates - basis @ (basis.T @ candidates)
        residual = free - rows @ _solve(self._grams[channel], rows.T @ free)
        return share_of(residual, candidates)

    def rest(self, channel: int, values: FloatArray) -> FloatArray:
        """Free values of all that one channel's rows can explain: values (n,); returns (n,)."""
        free, rows = self.freed(channel, values), self._rows[channel]
        return np.asarray(free - rows @ _solve(self._grams[channel], rows.T @ free))

    def of_own(self, channel: int, values: FloatArray, parameters: FloatArray) -> FloatArray:
        """
        Give what a channel has to itself, beside known parameters of the bodies.

        values (n,), parameters (columns,); returns (own,).
        """
        own, residual = self._plain[channel], values - self._bodies[channel] @ parameters
        return _solve(own.T @ own, own.T @ residual)

    def whole(self, channel: int, parameters: FloatArray, own: FloatArray) -> FloatArray:
        """
        Give what a channel measures with known parameters.

        parameters (columns,), own (own,).
        """
        return np.asarray(self._bodies[channel] @ parameters + self._plain[channel] @ own)

    def predicted(
        self, channel: int, values: FloatArray, known: NDArray[np.bool_],
    ) -> FloatArray:
        """
        Learn one channel from some samples, and predict all of them.

        values, known (n,); returns (n,).
        """
        columns = np.column_stack([self._bodies[channel], self._plain[channel]])
        some = columns[known]
        return np.asarray(columns @ _solve(some.T @ some, some.T @ values[known],
                                           settings.PREDICTING))

    def extended(self, columns: FloatArray) -> Explained:
        """Give each channel more columns to itself: columns (n, more)."""
        return Explained(np.stack(self._bodies, axis=1),
                         [np.column_stack([own, columns]) for own in self._plain], self.groups)

    def friction(self, channel: int, output: FloatArray) -> tuple[float, float]:
        """
        Say whether friction brakes a joint, as it does wherever directions are right.

        output (n,).
        """
        own, rows = self._plain[channel], self._bodies[channel]
        both, few = np.column_stack([rows, own]), np.column_stack([
            rows, np.delete(own, (1, 2), axis=1)])
        values = _solve(both.T @ both, both.T @ output)
        residual = output - both @ values
        without = output - few @ _solve(few.T @ few, few.T @ output)
        friction, speed = own[:, 1:3] @ values[-own.shape[1]:][1:3], own[:, 1]
        size = float(np.sqrt(np.mean(friction ** 2) * np.mean(speed ** 2)))
        power = float(np.mean(friction * speed)) / size if size > 0.0 else 0.0
        least = FLOOR * float(np.sum((output - output.mean()) ** 2))
        rest = max(float(np.sum(residual ** 2)), least, 1e-300)
        return power, float(np.sum(without ** 2)) / rest


def share_of(residual: FloatArray, outputs: FloatArray) -> FloatArray:
    """Give the share of the variance of outputs that remains, never below `FLOOR`."""
    total = np.sum((outputs - outputs.mean(axis=0)) ** 2, axis=0)
    rest = np.sum(residual ** 2, axis=0)
    # what never changes has nothing to be explained
    return np.where(total > 0.0, np.clip(rest / np.where(total > 0.0, total, 1.0), FLOOR, None),
                    1.0)


def _orthonormal(columns: FloatArray) -> FloatArray:
    scale = np.linalg.norm(columns, axis=0)
    used = columns[:, scale > 1e-12 * max(float(scale.max()), 1e-300)]
    return np.asarray(np.linalg.qr(used / np.linalg.norm(used, axis=0))[0])


def _solve(gram: FloatArray, right: FloatArray, smallest: float = settings.SMALLEST) -> FloatArray:
    """Solve the scaled normal equations, without the directions that are not there."""
    scale = np.sqrt(np.diag(gram))
    seen = scale > 1e-10 * max(float(scale.max(initial=0.0)), 1e-300)
    safe = np.where(seen, scale, 1.0)
    scaled = np.where(np.outer(seen, seen), gram, 0.0) / np.outer(safe, safe)
    values, vectors = np.linalg.eigh(scaled)
    good = values > smallest * max(float(values[-1]), 1e-300)
    inverse = np.where(good, 1.0 / np.where(good, values, 1.0), 0.0)
    shape = (-1,) + (1,) * (right.ndim - 1)
    projected = inverse.reshape(shape) * (vectors.T @ (right / safe.reshape(shape)))
    return np.asarray((vectors @ projected) / safe.reshape(shape)
                      * seen.reshape(shape))


OUTPUTS = ('effort', 'strain')


class Case:
    """
    What is known of a bag, and how much of its outputs an alternative explains.

    outputs (n, channels).
    """

    def __init__(
        self, arm: Arm, recording: Recording, decimated: Decimated,
        broken: Collection[str] = frozenset(),
    ) -> None:
        self.arm, self.recording, self.decimated = arm, recording, decimated
        self.broken = frozenset(broken)
        self.motion = decimated.motion
        self.bodies = {name: BodyRows(arm, name) for name in OUTPUTS if decimated.has(name)}
        self.sound = {name: np.array([one not in broken for one in bodies.channels])
                      for name, bodies in self.bodies.items()}
        # what never changes leaves the same whatever is changed
        self.outputs = {name: np.where(self.sound[name], decimated.output(name), 0.0)
                        for name in self.bodies}
        self.names = tuple((name, channel) for name, bodies in self.bodies.items()
                           for channel in bodies.channels)

    def scale(self, name: str, factors: Mapping[str, float]) -> None:
        """Divide channels by factors, before anything is compared."""
        divisor = np.array([factors.get(one, 1.0) for one in self.bodies[name].channels])
        self.outputs[name] = self.outputs[name] / divisor

    def explained(
        self, motion: FloatArray | None = None, gravity: FloatArray | None = None,
        arm: Arm | None = None,
    ) -> dict[str, Explained]:
        """
        Build the least squares of all outputs for another motion, gravity or description.

        motion (n, 3 joints), gravity (3,) [m/s^2].
        """
        x = self.motion if motion is None else motion
        described = self.bodies if arm is None else {
            name: BodyRows(arm, name) for name in self.bodies}
        return {name: Explained(bodies.rows(x, gravity), bodies.own(x), bodies.groups)
                for name, bodies in described.items()}

    def rows(self, output: str) -> FloatArray:
        """Give the rows of the bodies as the description has them."""
        return self.bodies[output].rows(self.motion)

    @property
    def brevity(self) -> float:
        """Say how much shorter the recording is than one that tells enough; 1 or more."""
        seconds = float(self.decimated.t[-1] - self.decimated.t[0])
        return max(1.0, settings.ENOUGH_SECONDS / seconds)

    def surely(self, least: float) -> float:
        """
        Give the gain that says something, not less than one that is asked for anyway.

        The residual of a channel is known as well as its independent samples are many, which
        after one filter go with time; the log ratios of all channels add up.
        """
        short = len(self.names) * self.brevity / settings.ENOUGH_SECONDS
        return max(least, 1.5 * float(np.sqrt(short)))

    @cached_property
    def moves(self) -> NDArray[np.bool_]:
        """Say which joints move."""
        n = len(self.arm.active_joints)
        return np.asarray(np.ptp(self.motion[:, :n], axis=0) > settings.MOVING_SPAN)

    @cached_property
    def usual(self) -> dict[str, Explained]:
        """Build the least squares of the description as it is, once."""
        return self.explained()

    @cached_property
    def now(self) -> FloatArray:
        """Give the share that remains of each channel, as things are."""
        return self.shares(self.usual)

    def shares(
        self, explained: Mapping[str, Explained], outputs: Mapping[str, FloatArray] | None = None,
    ) -> FloatArray:
        """
        Give the share of the variance of each channel that remains.

        Returns (channels of all outputs,).
        """
        values = {**self.outputs, **(outputs or {})}
        return np.concatenate([item.shares(values[name]) for name, item in explained.items()])


def gain(now: FloatArray, other: FloatArray) -> float:
    """
    Say how much better an alternative is: the sum of log ratios of the shares that remain.

    Up to a factor, twice the logarithm of the likelihood ratio of channels with unknown noise.

    now, other (channels,).
    """
    return float(np.sum(np.log(now / other)))


def relative(shares: FloatArray | Sequence[float]) -> float:
    """Give the relative residual of all channels from their shares, each with the same weight."""
    return float(np.sqrt(np.mean(shares)))
