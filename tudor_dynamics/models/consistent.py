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

"""Bodies and drives that can physically exist and have the identified parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
from scipy import linalg

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation import Products, triangle
from tudor_dynamics.models.friction import (
    BY_LOAD, DAMPING, FRICTION, friction_columns, friction_names, term_of, TERMS)
from tudor_dynamics.models.regressor import EffortRegressor, random_inputs
from tudor_dynamics.models.settings import (
    ACTS, CORRELATED, ENERGY_PASSES, ENOUGH, EVALUATIONS, GRID, LEAST_RADIUS, LEAST_SHARE,
    PEAK, PRIOR_WIDTH, ROD, SEARCHES, TOOL, WIDTH_CONSTANT, WIDTH_DESCRIBED, WIDTH_DRIVE,
    WIDTH_ROD, WIDTH_SHAPE)
from tudor_dynamics.typing import FloatArray


# -- Bodies that can exist: what is known of them before any data.
#
# A body can exist if its pseudo-inertia, second moments of its mass with first moments and mass,
# is positive definite. The log-Cholesky parameters (Rucker and Wensing, IEEE RA-L 7(2), 2022)
# stand for such bodies and no others: any ten numbers are a body.

PARAMETERS = 10


@dataclass(frozen=True, eq=False)
class Prior:
    """What a description says of the bodies."""

    center: FloatArray  # Log-Cholesky parameters, (bodies, 10)
    width: FloatArray  # their standard deviations, (bodies, 10)
    described: bool  # whether masses stand in the description; otherwise bodies are rods


def prior_of(arm: Arm) -> Prior:
    """Collect what a description says of the bodies of its active joints."""
    inertias = list(arm.model.inertias)[1:]
    described = sum(float(inertia.mass) for inertia in inertias) > 0.0
    bodies = _described(inertias) if described else _rods(arm.model)
    center = np.array([log_cholesky(parameters) for parameters in bodies])
    width = np.empty_like(center)
    # pseudo-inertia = U U', U = e^a [[e^d1 s12 s13 t1] ...]: the d are logarithms of sizes, the s
    # and t lengths
    sizes = np.exp(center[:, 1:4])
    length = np.maximum(sizes.max(axis=1), np.abs(center[:, 7:]).max(axis=1))
    width[:, 0] = WIDTH_DESCRIBED if described else WIDTH_ROD
    width[:, 1:4] = WIDTH_SHAPE
    width[:, 4:] = WIDTH_SHAPE * length[:, None]
    return Prior(center, width, described)


def parameters_of(log: FloatArray) -> FloatArray:
    """Give a body's mass [kg], first moments [kg m], inertia about the joint [kg m^2], (10,)."""
    return np.asarray(pin.LogCholeskyParameters(log).toDynamicParameters())


def slopes_of(log: FloatArray) -> FloatArray:
    """Differentiate `parameters_of`, shape (10, 10): log (10,)."""
    return np.asarray(pin.LogCholeskyParameters(log).calculateJacobian())


def log_cholesky(parameters: FloatArray) -> FloatArray:
    """Give the log-Cholesky parameters (10,) of a body that can exist; see ``parameters_of``."""
    pseudo = pseudo_inertia(parameters)
    # upper triangular factor: that of the reversed matrix, reversed
    upper = np.linalg.cholesky(pseudo[::-1, ::-1])[::-1, ::-1]
    upper = upper / upper[3, 3]
    return np.array([0.5 * np.log(pseudo[3, 3]), *np.log(np.diag(upper)[:3]),
                     upper[0, 1], upper[1, 2], upper[0, 2], *upper[:3, 3]])


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Give the matrix (4, 4) that is positive definite for bodies (10,) that can exist."""
    # Wensing, Kim and Slotine, IEEE RA-L 3(1), 2018, Eq. (10)
    return np.asarray(pin.PseudoInertia.FromDynamicParameters(parameters).toMatrix())


def parameters_from(pseudo: FloatArray) -> FloatArray:
    """Give the dynamic parameters of a pseudo-inertia: pseudo (4, 4); returns (10,)."""
    return np.asarray(pin.PseudoInertia.FromMatrix(pseudo).toDynamicParameters())


def _described(inertias: list[pin.Inertia]) -> list[FloatArray]:
    """Take inertias as they stand; what cannot exist is given the least that can."""
    total = sum(float(inertia.mass) for inertia in inertias)
    found = []
    for inertia in inertias:
        mass = max(float(inertia.mass), LEAST_SHARE * total)
        center = np.asarray(inertia.lever)
        second = 0.5 * np.trace(inertia.inertia) * np.eye(3) - np.asarray(inertia.inertia)
        values, axes = np.linalg.eigh(second)
        second = (axes * np.maximum(values, mass * LEAST_RADIUS ** 2)) @ axes.T
        found.append(_body(mass, center, second))
    return found


def _rods(model: pin.Model) -> list[FloatArray]:
    """Guess bodies as rods from their joint to the next."""
    found = []
    for joint in range(1, model.njoints):
        next_ones = model.children[joint]
        end = (np.asarray(model.jointPlacements[next_ones[0]].translation) if len(next_ones)
               else np.array([0.0, 0.0, TOOL]))
        length = max(float(np.linalg.norm(end)), TOOL)
        mass = ROD * length
        second = mass * (np.outer(end, end) / 12.0 + (0.1 * length) ** 2 * np.eye(3))
        found.append(_body(mass, end / 2.0, second))
    return found


def _body(mass: float, center: FloatArray, second: FloatArray) -> FloatArray:
    """Put a body together; ``second`` are the second moments about its centre of mass."""
    pseudo = np.empty((4, 4))
    pseudo[:3, :3] = second + mass * np.outer(center, center)
    pseudo[:3, 3] = pseudo[3, :3] = mass * center
    pseudo[3, 3] = mass
    return parameters_from(pseudo)


# -- What friction and rotor inertia have to be: rotors have mass, and friction takes energy


def speed_grid(largest: float, sharp: float) -> FloatArray:
    """Give the speeds (2 GRID,) over which the friction of a joint is looked at, both ways."""
    forward = np.geomspace(sharp, max(largest, 2.0 * sharp), GRID)
    return np.concatenate([-forward, forward])


def energy_rows(arm: Arm, columns: Sequence[str], speeds: FloatArray) -> FloatArray:
    """Give rows that must not be negative on the parameters of drives."""
    # rotor inertias, and the friction of each joint against the motion at each of its speeds: the
    # sum of all its terms, for friction that falls with the speed has terms that give
    place = {name: i for i, name in enumerate(columns)}
    rows = [np.eye(len(columns))[[i for name, i in place.items() if name.startswith('Ia(')]]]
    for joint, largest in zip(arm.joints, speeds.tolist(), strict=True):
        speed = speed_grid(largest, joint.friction_velocity)
        values = friction_columns(joint, speed) * np.sign(speed)[:, None]
        own = np.zeros((len(speed), len(columns)))
        for name, column in zip(friction_names(joint), values.T, strict=True):
            if TERMS[term_of(name)].takes_energy and name in place:
                own[:, place[name]] = column
        rows.append(own[np.any(own != 0.0, axis=1)])
    return np.vstack(rows)


def raised(values: FloatArray, columns: Sequence[str], rows: FloatArray) -> FloatArray:
    """Take away the little by which parameters (columns,) fall short of ``energy_rows``."""
    values = np.array(values)
    places = [i for kind in ('Ia', FRICTION, DAMPING) for i, name in enumerate(columns)
              if name.startswith(kind)]
    for _ in range(ENERGY_PASSES):
        for i in places:
            if np.min(rows @ values, initial=0.0) < 0.0:
                # not those of the other direction, on which it hardly acts
                part = np.abs(rows[:, i]) > ACTS * np.abs(rows[:, i]).max(initial=0.0)
                short = -(rows[part] @ values) / np.abs(rows[part, i])
                values[i] += np.sign(rows[part, i].sum()) * max(float(short.max(initial=0.0)), 0.0)
    return values


# -- Errors of full parameters on data, their distance from a description, and their derivatives


@dataclass(frozen=True, eq=False)
class BodySolution:
    """Full parameters."""

    bodies: FloatArray  # (bodies, 10), see `parameters_of`
    drives: FloatArray  # (drive_columns,): rotors and friction, in units of the columns
    constants: FloatArray  # (channels,): torque per unit beyond the described; 1 if known
    # Standard errors of the same shapes; of the constants relative ones.
    body_errors: FloatArray
    drive_errors: FloatArray
    constant_errors: FloatArray
    body_widths: FloatArray  # standard deviations before any data, (bodies, 10)
    speeds: FloatArray  # up to which friction takes energy, (channels,) [rad/s or m/s]
    # Root mean square of what each joint carries, where friction grows with it; else 0,
    # (channels,) [N m or N].
    loads: FloatArray
    # (channels,): relative error of each channel on the training data: of these parameters, and of
    # base parameters that need not belong to any bodies.
    relative_errors: FloatArray
    free_errors: FloatArray


def scaled_columns(arm: Arm, columns: Sequence[str]) -> NDArray[np.bool_]:
    """Say which parameters (columns,) unknown torque constants divide, where there are such."""
    together = EffortRegressor(arm, shared=True)
    return together.scaled if together.unknown else np.zeros(len(columns), dtype=np.bool_)


class BodyProblem:
    """Residuals of data and of prior knowledge, and their derivatives."""

    # Unknowns are log-Cholesky parameters of all bodies, in units of their widths from their
    # centres; parameters of drives in units of their sizes; logarithms of unknown torque
    # constants. What drives must not do (`energy_rows`) counts as an error where they do it.

    def __init__(self, arm: Arm, model: AnalyticalModel, prior: Prior) -> None:
        products = model.data_
        self.columns = model.regressor.columns
        self.scaled = scaled_columns(arm, self.columns)
        self.unknown = EffortRegressor(arm, shared=True).unknown
        self.prior = prior
        self.n_channels = len(model.channels)
        self.n_bodies = len(prior.center)
        self.first = PARAMETERS * self.n_bodies
        self.parts: list[tuple[int, FloatArray, FloatArray]] = []
        self.free = np.zeros(self.n_channels)
        rows = model.regressor.rows(random_inputs(
            model.regressor, model.n_joints, len(self.columns) + 20, 0))
        coefficients = model.coefficients()
        for group, data in zip(model.groups_, products, strict=True):
            kept = group.base.kept
            for channel, product, variance in zip(
                    group.base.channels, data, group.estimate.variances, strict=True):
                # what of a row the other columns are, on the base columns
                mixture = np.linalg.lstsq(rows[:, channel, kept], rows[:, channel], rcond=1e-10)[0]
                factor = product.factor() / np.sqrt(variance)
                self.parts.append((channel, factor[:, :-1] @ mixture, factor[:, -1]))
                best = np.linalg.norm(factor[:, :-1] @ coefficients[channel, kept] - factor[:, -1])
                self.free[channel] = best / max(float(np.linalg.norm(factor[:, -1])), 1e-300)
        self.parts.sort(key=lambda part: part[0])
        self.sizes = self._sizes()
        self.end = self.first + len(self.sizes)  # of the drives, where the constants begin
        self.data = self._joined()
        speeds = _mean_sizes(model, products, DAMPING)
        self.speeds = PEAK * np.where(speeds > 0.0, speeds, 1.0 / PEAK)
        self.loads = _mean_sizes(model, products, BY_LOAD)
        self.rows = energy_rows(arm, self.columns[self.first:], self.speeds)
        steps = self.rows * self.sizes
        self.steps = steps / np.maximum(np.abs(steps).max(axis=1, keepdims=True), 1e-300)
        self.trusted = self.strict = 1.0

    def _joined(self) -> list[tuple[int, FloatArray, FloatArray]]:
        """Give the data with all channels of known constants as one, which has fewer rows."""
        known = [part for part in self.parts if part[0] not in self.unknown]
        if not known:
            return self.parts
        whole = triangle(np.vstack([np.column_stack([matrix, target])
                                    for _, matrix, target in known]))
        return [(known[0][0], whole[:, :-1], whole[:, -1]),
                *(part for part in self.parts if part[0] in self.unknown)]

    def _sizes(self) -> FloatArray:
        """Give the size of each drive parameter that would make an output's whole size."""
        size = np.full(len(self.columns) - self.first, np.inf)
        for _, matrix, target in self.parts:
            norms = np.linalg.norm(matrix[:, self.first:], axis=0)
            whole = float(np.linalg.norm(target))
            seen = norms > 1e-9 * whole
            size[seen] = np.minimum(size[seen], whole / norms[seen])
        return np.where(np.isfinite(size), size, 1.0)

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give full parameters, logarithms of constants, log-Cholesky parameters."""
        logs = self.prior.center + self.prior.width * x[:self.first].reshape(-1, PARAMETERS)
        constants = np.zeros(self.n_channels)
        constants[list(self.unknown)] = x[self.end:]
        full = np.concatenate([*(parameters_of(log) for log in logs),
                               self.sizes * x[self.first:self.end]])
        return full, constants, logs

    def start(self) -> FloatArray:
        """Begin with the bodies as described, and drives and constants that suit them best."""
        x = np.zeros(self.end + len(self.unknown))
        full, _, _ = self._split(x)
        for channel, matrix, target in self.parts:
            own = np.flatnonzero(np.linalg.norm(matrix[:, self.first:], axis=0) > 0.0)
            bodies = matrix[:, :self.first] @ full[:self.first]
            columns = np.column_stack([matrix[:, self.first + own] * self.sizes[own], bodies])
            best = np.linalg.lstsq(columns, target, rcond=1e-8)[0]
            x[self.first + own] = best[:-1]
            if channel in self.unknown:
                share = max(float(best[-1]), 1e-3 * float(np.linalg.norm(target))
                            / max(float(np.linalg.norm(bodies)), 1e-300))
                x[self.end + self.unknown.index(channel)] = -np.log(share)
        return x

    def residual(self, x: FloatArray) -> FloatArray:
        """Give errors of the data in their noise, distances from the prior, energy of drives."""
        full, constants, _ = self._split(x)
        found = []
        for channel, matrix, target in self.data:
            factor = np.where(self.scaled, np.exp(-constants[channel]), 1.0)
            found.append(self.trusted * (matrix @ (full * factor) - target))
        drives, logs = x[self.first:self.end], x[self.end:]
        mean = logs.mean(keepdims=True) if len(logs) else logs
        return np.concatenate([
            *found, x[:self.first], drives / WIDTH_DRIVE, (logs - mean) / PRIOR_WIDTH,
            mean / WIDTH_CONSTANT, self.strict * np.minimum(self.steps @ drives, 0.0)])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Differentiate `residual`, shape (n_residuals, n_unknowns): x (unknowns,)."""
        (full, constants, logs), end = self._split(x), self.end
        inner = linalg.block_diag(*self._slopes(logs), np.diag(self.sizes))
        found = []
        for channel, matrix, _ in self.data:
            factor = np.where(self.scaled, np.exp(-constants[channel]), 1.0)
            block = np.zeros((len(matrix), len(x)))
            block[:, :end] = matrix @ (factor[:, None] * inner)
            if channel in self.unknown:
                block[:, end + self.unknown.index(channel)] = -matrix @ (
                    full * np.where(self.scaled, factor, 0.0))
            found.append(self.trusted * block)
        n = len(self.unknown)
        own = np.eye(len(x))
        own[self.first:end] /= WIDTH_DRIVE
        own[end:, end:] = (np.eye(n) - 1.0 / max(n, 1)) / PRIOR_WIDTH
        mean = np.zeros((min(n, 1), len(x)))
        mean[:, end:] = 1.0 / (max(n, 1) * WIDTH_CONSTANT)
        energy = np.zeros((len(self.steps), len(x)))
        active = self.steps @ x[self.first:end] < 0.0
        energy[active, self.first:end] = self.strict * self.steps[active]
        return np.vstack([*found, own, mean, energy])

    def _slopes(self, logs: FloatArray) -> list[FloatArray]:
        """Differentiate the parameters of each body by its unknowns, (10, 10)."""
        return [slopes_of(log) * width for log, width in zip(logs, self.prior.width, strict=True)]

    def reweigh(self, x: FloatArray) -> None:
        """Take the noise of each channel from what bodies that can exist leave over of it."""
        full, constants, _ = self._split(x)
        ratios = self.free / np.maximum(self.errors(full, np.exp(constants)), 1e-300)
        self.parts = [(channel, ratios[channel] * matrix, ratios[channel] * target)
                      for channel, matrix, target in self.parts]
        self.data = self._joined()

    def errors(self, full: FloatArray, constants: FloatArray) -> FloatArray:
        """Give the relative error of each channel: full (columns,), constants (channels,)."""
        factors = np.where(self.scaled, 1.0 / constants[:, None], 1.0)
        return np.array([
            np.linalg.norm(matrix @ (full * factors[channel]) - target)
            / max(float(np.linalg.norm(target)), 1e-300)
            for channel, matrix, target in self.parts])

    def solution(self, x: FloatArray) -> BodySolution:
        """Give the parameters with their errors; several samples of data count as one."""
        full, constants, logs = self._split(x)
        jacobian = self.jacobian(x)[:-len(self.steps) or None]
        rows = sum(len(matrix) for _, matrix, _ in self.data)
        jacobian[:rows] /= np.sqrt(CORRELATED)
        covariance = linalg.pinvh(jacobian.T @ jacobian)
        errors = np.empty((self.n_bodies, PARAMETERS))
        for i, slope in enumerate(self._slopes(logs)):
            part = slice(PARAMETERS * i, PARAMETERS * (i + 1))
            errors[i] = np.sqrt(np.diag(slope @ covariance[part, part] @ slope.T))
        widths = np.array([np.sqrt(np.sum(slope ** 2, axis=1))
                           for slope in self._slopes(self.prior.center)])
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        relative = np.zeros(self.n_channels)
        relative[list(self.unknown)] = deviation[self.end:]
        drives = raised(full[self.first:], self.columns[self.first:], self.rows)
        return BodySolution(
            full[:self.first].reshape(-1, PARAMETERS), drives, np.exp(constants), errors,
            self.sizes * deviation[self.first:self.end], relative, widths, self.speeds,
            self.loads, self.errors(full, np.exp(constants)), self.free)


def _mean_sizes(
    model: AnalyticalModel, products: Sequence[Sequence[Products]], term: str,
) -> FloatArray:
    """Give the root mean square of a friction term's columns by joint, 0 where there are none."""
    found = np.zeros(len(model.channels))
    for group, data in zip(model.groups_, products, strict=True):
        for channel, product in zip(group.base.channels, data, strict=True):
            factor, joint = product.factor(), model.channels[channel]
            for i, column in enumerate(group.base.kept.tolist()):
                name = model.regressor.columns[column]
                if name.startswith(term) and name.endswith(f'({joint})'):
                    found[channel] += float(factor[:, i] @ factor[:, i]) / max(product.n, 1)
    return np.sqrt(found)


# -- Full parameters that can exist, nearest to the data and, where these say nothing, to a
#    description.
#
# The data say ``y = Y chi`` with base parameters ``chi = M pi``, where many full parameters pi
# give the same chi, and an estimate of chi need not belong to any bodies that can exist. So the
# sum of squares of the data themselves, kept as factors, is minimised over log-Cholesky parameters
# of the bodies, together with their distance from the description in units of how far that can be
# trusted. Where the data speak, thousands of samples outweigh it; bodies that they cannot
# distinguish share what they show by the description's proportions, for the distance is one of
# logarithms.


def _searched(problem: BodyProblem, x: FloatArray, first: int = 0) -> FloatArray:
    """Minimise the sum of squares over the unknowns from the first one that is free."""
    from scipy import optimize  # slow to import

    def whole(part: FloatArray) -> FloatArray:
        return np.concatenate([x[:first], part])

    return whole(optimize.least_squares(
        lambda part: problem.residual(whole(part)), x[first:],
        lambda part: problem.jacobian(whole(part))[:, first:], method='lm', x_scale='jac',
        ftol=ENOUGH, xtol=ENOUGH, gtol=1e-12, max_nfev=EVALUATIONS).x)


def solve_consistent(arm: Arm, model: AnalyticalModel, prior: Prior) -> BodySolution:
    """Find bodies and drives that give base parameters."""
    problem = BodyProblem(arm, model, prior)
    x = problem.start()
    for search, (problem.trusted, problem.strict) in enumerate(SEARCHES, start=1):
        if search == len(SEARCHES):
            problem.reweigh(x)
        x = _searched(problem, x)
    if not np.all(np.isfinite(x)):
        raise FitError(f'arm {arm.name!r}: no physically possible masses and inertias explain the '
                       'efforts in the bags; look for faults with `tudor info BAG --arm ARM.yaml`')
    return problem.solution(x)


def solve_drives(arm: Arm, model: AnalyticalModel, prior: Prior) -> BodySolution:
    """Find the drives and torque constants that suit bodies as they are described."""
    problem = BodyProblem(arm, model, prior)
    problem.trusted, problem.strict = SEARCHES[-1]
    return problem.solution(_searched(problem, problem.start(), problem.first))


def full_of(solution: BodySolution, scaled: NDArray[np.bool_]) -> FloatArray:
    """Give each channel's full parameters (channels, columns), as a model's regressor has them."""
    full = np.concatenate([solution.bodies.ravel(), solution.drives])
    return np.array([full * np.where(scaled, 1.0 / constant, 1.0)
                     for constant in solution.constants])
