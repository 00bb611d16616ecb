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

"""What a planned motion shows of the parameters, and its limits as penalties."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.limits import effort_limits, Limits, SelfCollision
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import check_budget, SignalError, UsageError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.comparison import described_bodies
from tudor_dynamics.models.estimation import expected, rescaled
from tudor_dynamics.models.regressor import column_unit, EffortRegressor, Regressor
from tudor_dynamics.signals.motion_profile import fade, states
from tudor_dynamics.signals.preprocessing import noise_gain, prepare
from tudor_dynamics.typing import FloatArray


# -- A Fourier series of every joint over the whole motion, faded in from rest and out to rest.
#
# Positions, velocities and accelerations are linear in the coefficients, so that whatever is asked
# of the motion has exact slopes by them. One period is as long as the motion: nothing has to
# repeat, and the band of frequencies is what is bounded (Swevers et al., IEEE T-RA 13, 1997,
# repeat a short period instead, which costs freedom that a search may use).

REST = 1.0  # rest at both ends: filters settle [s]
FADE = 3.0  # way from rest into the series and back [s]


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
        """Give ``[q, dq, ddq]`` of coefficients (functions, joints)."""
        parts = self.basis @ (x * self.sizes)
        parts[0] += self.centre
        return np.hstack(list(parts))

    def slope(self, motion: FloatArray) -> FloatArray:
        """Turn slopes by each value of the motion into slopes by coefficients."""
        parts = np.stack(np.split(motion, 3, axis=1))
        return np.asarray(np.einsum('dsf,dsj->fj', self.basis, parts) * self.sizes)


def series(bounds: Limits, limits: Limits, seconds: float, highest: float, dt: float) -> Series:
    """Lay out the basis: seconds, dt [s], highest [Hz]."""
    length = seconds - 2.0 * REST
    harmonics = int(highest * length + 1e-9)
    what = f'a motion of {seconds:g} s with frequencies up to {highest:.3g} Hz'
    if length < 2.0 * FADE or harmonics < 1:
        raise SignalError(f'{what} has less than one period; raise seconds= ' + (
            f'to {2.0 * (REST + FADE):g} or more' if length < 2.0 * FADE else
            f'or raise highest= above {1.0 / length:.3g} Hz'))
    check_budget(what, seconds / dt, 112.0 * harmonics, 'lower seconds=, rate= or highest=')
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


# -- What a motion shows of the parameters of models: information, standard errors, and their
#    slopes.
#
# The information about the parameters of a group of channels is ``sum_c Y_c' Y_c / sigma_c^2``
# over its rows; the inverse is the covariance of weighted least squares. The slope by the motion
# goes through the rows: each coordinate of all samples is moved at once, since a row depends on
# its own sample alone, so that a gradient costs 3 n_joints evaluations whatever the motion is made
# of.

STEP = 1e-6  # step of difference quotients [rad, rad/s, rad/s^2 or m, m/s, m/s^2]
LEAST = 1e-12
"""Part of the largest eigenvalue of a scaled information matrix that every direction is given:
what a motion does not show at all is expensive, not infinite."""


class _Group:
    """Channels with common parameters, and what brings their rows to units of the noise."""

    def __init__(self, model: AnalyticalModel, noise: FloatArray, place: int) -> None:
        base = model.base_[place]
        self._channels, self._kept = list(base.channels), base.kept
        self._factor = np.repeat(1.0 / noise[self._channels, None], len(base.kept), axis=1)
        constants = model.groups_[place].constants if model.groups_ else None
        if constants is not None:
            self._factor[:, model.regressor.scaled[base.kept]] /= constants.values[:, None]

    def rows(self, rows: FloatArray) -> FloatArray:
        """Pick the group's own rows, in units of the noise."""
        return rows[:, self._channels][:, :, self._kept] * self._factor


Criterion = Callable[[Sequence[FloatArray]], tuple[float, list[FloatArray]]]
"""From the covariance of each group to a cost, and its slope by the information of each."""


def mean_error(covariances: Sequence[FloatArray]) -> tuple[float, list[FloatArray]]:
    """Give the mean logarithm of all standard errors: units and sizes do not matter."""
    count = sum(len(item) for item in covariances)
    cost, slopes = 0.0, []
    for covariance in covariances:
        variance = np.diag(covariance)
        cost += 0.5 * float(np.sum(np.log(variance))) / count
        slopes.append(-0.5 / count * (covariance / variance) @ covariance)
    return cost, slopes


class Information:
    """What motions show of models, fitted or not, in the noise (channels,) of each output."""

    def __init__(
        self, models: Mapping[str, AnalyticalModel], noise: Mapping[str, FloatArray],
    ) -> None:
        self._parts: list[tuple[Regressor, list[_Group]]] = []
        for output, model in models.items():
            model.regressor.assume(None)
            self._parts.append((model.regressor, [
                _Group(model, noise[output], place) for place in range(len(model.base_))]))

    def matrices(self, motion: FloatArray) -> list[FloatArray]:
        """Give the information matrix of each group of channels of all models."""
        return [_square(group.rows(rows)) for regressor, groups in self._parts
                for rows in [regressor.rows(motion)] for group in groups]

    def value(self, motion: FloatArray, criterion: Criterion) -> float:
        """Judge a motion (samples, 3 joints)."""
        return _evaluate(criterion, self.matrices(motion))[0]

    def cost(
        self, motion: FloatArray, criterion: Criterion = mean_error,
    ) -> tuple[float, FloatArray]:
        """Judge a motion (samples, 3 joints); gives the slope by each of its values, too."""
        rows = [regressor.rows(motion) for regressor, _ in self._parts]
        own = [[group.rows(rows_) for group in groups]
               for rows_, (_, groups) in zip(rows, self._parts, strict=True)]
        cost, slopes = _evaluate(criterion, [_square(part) for parts in own for part in parts])
        slope, by_group = np.zeros_like(motion), iter(slopes)
        for rows_, parts, (regressor, groups) in zip(rows, own, self._parts, strict=True):
            pulls = [2.0 * (part @ next(by_group)) for part in parts]
            for k in range(motion.shape[1]):
                moved = motion.copy()
                moved[:, k] += STEP
                change = (regressor.rows(moved) - rows_) / STEP
                for group, pull in zip(groups, pulls, strict=True):
                    slope[:, k] += np.einsum('scp,scp->s', pull, group.rows(change))
        return cost, slope


def _evaluate(
    criterion: Criterion, information: Sequence[FloatArray],
) -> tuple[float, Sequence[FloatArray]]:
    """Ask a criterion, which may be a user's, for its cost and slopes."""
    covariances = [covariance_of(item) for item in information]
    found: Any = criterion(covariances)
    slopes = found[1] if isinstance(found, tuple) and len(found) == 2 else None
    if not isinstance(slopes, Sequence) or (
            [np.shape(item) for item in slopes] != [item.shape for item in covariances]):
        raise UsageError(
            f'the criterion returned {found!r:.60}; expected a cost, and a list with its slope '
            f'by the information of each of the {len(covariances)} groups of channels')
    return float(found[0]), slopes


def _square(rows: FloatArray) -> FloatArray:
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def covariance_of(information: FloatArray) -> FloatArray:
    """Invert an information matrix (parameters, parameters) in units of its columns."""
    size = np.sqrt(np.diag(information))
    size = np.where(size > 0.0, size, 1e-6 * max(float(size.max(initial=0.0)), 1e-300))
    values, vectors = linalg.eigh(information / np.outer(size, size))
    values = np.maximum(values, 0.0) + LEAST * max(float(values[-1]), 1e-300)
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


# -- Standard errors that a motion will bring, by the filters and the estimator of a fit.
#
# The planned motion goes through what a recording goes through: filters, decimation, regressor,
# products. Only the outputs are missing, and the inverse of the information does not depend on
# them.


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of the outputs."""

    size: dict[str, FloatArray]  # for each output, standard deviation of each channel, in its unit
    residual: bool = False  # of a fit's residuals, after filters; else of samples, white


@dataclass(frozen=True)
class ExpectedError:
    """Standard error of one parameter."""

    output: str  # what the parameter predicts
    channels: tuple[str, ...]  # channels that share it
    column: str  # column of the regressor
    name: str  # what the base parameter stands for
    unit: str  # unit of the parameter, and so of its standard error
    value: float  # standard error; infinite where the motion does not show it


def played(trajectory: Trajectory, arm: Arm) -> Recording:
    """Give the recording of an arm that followed a trajectory exactly."""
    n, joints = trajectory.q.shape
    return Recording(
        'the planned motion', np.round(trajectory.t * 1e9).astype(np.int64), trajectory.q,
        states(trajectory)[:, joints:2 * joints], np.zeros((n, joints)),
        np.zeros((n, len(arm.gauges))) if arm.gauges else None, (slice(0, n),),
        float(np.median(np.diff(trajectory.t))))


def expected_errors(
    models: Mapping[str, AnalyticalModel], arm: Arm, trajectory: Trajectory,
    preprocessing: PreprocessingSpec, noise: Noise,
) -> list[ExpectedError]:
    """Say how well a motion will show the parameters of models."""
    stretches = prepare(played(trajectory, arm), preprocessing)
    gain = 1.0 if noise.residual else noise_gain(stretches[0], preprocessing)
    found = []
    for output, model in models.items():
        data = model.products(lambda: [
            block for stretch in stretches for block in stretch.blocks(output)])
        for place, (base, products) in enumerate(zip(model.base_, data, strict=True)):
            names = tuple(model.channels[i] for i in base.channels)
            constants = model.groups_[place].constants if model.groups_ else None
            if constants is not None:
                scaled = model.regressor.scaled[base.kept]
                products = [rescaled(product, scaled, value) for product, value in zip(
                    products, constants.values, strict=True)]
            estimate = expected(products, (gain * noise.size[output][list(base.channels)]) ** 2)
            found += [ExpectedError(
                output, names, column := model.regressor.columns[kept], name,
                column_unit(arm, output, names, column), float(error))
                for kept, name, error in zip(
                    base.kept, base.names, estimate.standard_errors, strict=True)]
    return found


# -- What a motion has to keep to, as penalties with slopes, and how far it goes beyond.
#
# Positions, speeds, accelerations and efforts are ratios to their limits; distances between links
# fall short of a clearance. A penalty grows with the square of what is beyond.

CLEARANCE = 0.02  # distance that links are to keep from each other [m]
TOUCH = 0.005  # distance that is taken for a collision: motion is looked at sample by sample [m]
EFFORT = 0.8  # part of the largest effort that is planned: friction and tracking need the rest


@dataclass(frozen=True, eq=False)
class Efforts:
    """Efforts that a motion asks for, by what is known of the arm, and their limits."""

    regressor: EffortRegressor  # rows of the efforts
    parameters: FloatArray  # parameters of each channel, (joints, columns)
    largest: FloatArray  # (joints,): planned [A, N m or N]; infinite where unknown

    def ratio(self, motion: FloatArray) -> FloatArray:
        """Give efforts over their limits, shape (samples, joints), of a motion."""
        return self.regressor.outputs(motion, self.parameters) / self.largest


def known_efforts(arm: Arm, parameters: FloatArray | None = None) -> Efforts | None:
    """Collect what is known of the efforts of an arm and of their limits; None without either."""
    if parameters is None:
        # what the description says of bodies and limits are torques, whatever is measured
        arm = arm.with_joints({joint.name: {'effort': joint.effort.model_copy(update={
            'unit': 'N' if arm.is_prismatic(joint.name) else 'N m', 'torque_constant': None})}
            for joint in arm.joints if joint.effort.unit == 'A'})
    largest, regressor = EFFORT * effort_limits(arm), EffortRegressor(arm)
    if parameters is None:
        bodies = list(described_bodies(arm).values())
        if not any(body[0] > 0.0 for body in bodies):
            return None
        parameters = np.zeros((len(arm.joints), len(regressor.columns)))
        parameters[:, :10 * len(bodies)] = np.concatenate(bodies)
    if not np.isfinite(largest).any():
        return None
    return Efforts(regressor, parameters, largest)


@dataclass(frozen=True, eq=False)
class Beyond:
    """How far a motion goes to its limits and beyond."""

    # (joints,): largest part of each limit; of the effort 0 where it is not known.
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    effort: FloatArray
    clearance: float  # least distance between links, where it is less than `CLEARANCE` [m]
    nearest: tuple[str, ...]  # links that come as near as that

    @property
    def excess(self) -> float:
        """Give what no joint can mend alone: efforts beyond their limits, links that touch."""
        return float(max(self.effort.max(initial=0.0) - 1.0, 0.0)
                     + max(TOUCH - self.clearance, 0.0) / CLEARANCE)


class Bounds:
    """All that a motion keeps to."""

    def __init__(
        self, bounds: Limits, limits: Limits, efforts: Efforts | None = None,
        links: SelfCollision | None = None,
    ) -> None:
        self.range, self.limits = bounds, limits
        self.efforts = efforts
        self.links = links if links is not None and links.pairs else None
        n = len(bounds.lower)
        self._centre = np.concatenate([0.5 * (bounds.lower + bounds.upper), np.zeros(2 * n)])
        self._size = np.concatenate([0.5 * (bounds.upper - bounds.lower), limits.velocity,
                                     limits.acceleration])

    def penalty(self, motion: FloatArray) -> tuple[float, FloatArray]:
        """Punish a motion beyond limits; gives the slope by each of its values as well."""
        cost, slope = self._cost((motion - self._centre) / self._size)
        return cost, slope / self._size

    def _cost(self, ratio: FloatArray) -> tuple[float, FloatArray]:
        """Punish ratios beyond 1 either way; gives the slope by each of them as well."""
        beyond = np.maximum(np.abs(ratio) - 1.0, 0.0)
        count = len(ratio) * len(self.range.lower)
        return float(np.sum(beyond**2)) / count, 2.0 / count * beyond * np.sign(ratio)

    def coupled_penalty(self, motion: FloatArray) -> tuple[float, FloatArray]:
        """Punish efforts beyond their limits, and links too near each other, as `penalty` does."""
        cost, slope = 0.0, np.zeros_like(motion)
        count = len(motion) * len(self.range.lower)
        if self.efforts is not None:
            here = self.efforts.ratio(motion)
            cost, pull = self._cost(here)
            for k in range(motion.shape[1] if cost > 0.0 else 0):
                moved = motion.copy()
                moved[:, k] += STEP
                slope[:, k] += np.sum(pull * (self.efforts.ratio(moved) - here), axis=1) / STEP
        if self.links is not None:
            n = len(self.range.lower)
            for row, q in zip(slope, motion[:, :n], strict=True):
                near = self.links.near(q, 2.0 * CLEARANCE)
                missing = 2.0 - near.distance / CLEARANCE
                cost += float(np.sum(missing**2)) / count
                row[:n] -= 2.0 / (count * CLEARANCE) * missing @ near.slope
        return cost, slope

    def beyond(self, motion: FloatArray) -> Beyond:
        """Say how far a motion (samples, 3 joints) goes."""
        parts = np.split(np.abs((motion - self._centre) / self._size).max(axis=0), 3)
        n = len(self.range.lower)
        effort = np.zeros(n) if self.efforts is None else np.abs(
            self.efforts.ratio(motion)).max(axis=0)
        clearance, nearest = CLEARANCE, tuple[str, ...]()
        if self.links is not None:
            for q in motion[:, :n]:
                near = self.links.near(q, clearance)
                if len(near.distance):
                    k = int(np.argmin(near.distance))
                    clearance, nearest = float(near.distance[k]), near.names[k]
        return Beyond(parts[0], parts[1], parts[2], effort, clearance, nearest)
