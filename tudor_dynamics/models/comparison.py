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

"""What a model says of every body, and comparisons of two models or descriptions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.kinematics import joint_axis, model_from_urdf
from tudor_dynamics.errors import ModelError, UsageError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.models.consistent import (
    BodyProblem, BodySolution, full_of, Prior, prior_of, scaled_columns, solve_consistent,
    solve_drives)
from tudor_dynamics.models.estimation import Constants
from tudor_dynamics.models.friction import BY_LOAD, FRICTION, term_of, TERMS
from tudor_dynamics.models.settings import FROM_BOTH, FROM_DATA
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray


# -- What a fitted model says of every body and drive, for other programs


@dataclass(frozen=True, eq=False)
class FullParameters:
    """Parameters of every body and drive of an arm."""

    arm: Arm
    solution: BodySolution  # parameters, in the order of `model`'s columns, with their errors
    columns: tuple[str, ...]  # names of all parameters, bodies first
    model: AnalyticalModel  # the model of efforts that they make

    @property
    def bodies(self) -> dict[str, FloatArray]:
        """Mass, first moments, inertia about the joint, by the joint that moves a body."""
        return dict(zip(list(self.arm.model.names)[1:], self.solution.bodies, strict=True))

    @property
    def drives(self) -> dict[str, dict[str, float]]:
        """Give rotor inertia and friction of each joint [N m or N], by names of their terms."""
        # of a current whose constant is not known, that which was found along with the bodies
        constants = dict(zip(self.model.channels, self.solution.constants.tolist(), strict=True))
        found: dict[str, dict[str, float]] = {name: {} for name in self.arm.active_joints}
        first = self.solution.bodies.size
        for column, value in zip(self.columns[first:], self.solution.drives.tolist(), strict=True):
            term, _, joint = column[:-1].partition('(')
            own = 1.0 if term in ('Ia', BY_LOAD) else constants[joint]
            found[joint][term] = value * own
        return found

    @property
    def torque_constants(self) -> dict[str, float]:
        """Torque for each unit of what is measured, by joint; 1 where that is torque [N m/A]."""
        return {joint.name: (joint.effort.torque_constant or 1.0) * float(constant)
                for joint, constant in zip(self.arm.joints, self.solution.constants, strict=True)}

    @property
    def assumed(self) -> bool:
        """Whether torque is known up to a factor only, for which masses as described stand."""
        return bool(np.all(self.solution.constant_errors > 0.0))

    def sources(self) -> list[str]:
        """Say of each parameter whether it comes from ``data``, ``description`` or ``both``."""
        errors = np.concatenate([self.solution.body_errors.ravel(), self.solution.drive_errors])
        widths = np.concatenate([self.solution.body_widths.ravel(), np.full(
            len(self.solution.drives), np.inf)])
        ratio = errors / widths
        return ['data' if r <= FROM_DATA else 'both' if r <= FROM_BOTH else 'description'
                for r in ratio.tolist()]

    def loose_constants(self) -> str:
        """Name the torque constants that the data do not fix: all, or in proportion to others."""
        errors = self.solution.constant_errors
        if self.assumed:
            errors = np.sqrt(errors ** 2 - np.min(errors) ** 2)
        return ', '.join(f'{name} ({value:.3g} +- {error * value:.2g})' for (name, value), error in
                         zip(self.torque_constants.items(), errors.tolist(), strict=True)
                         if error > FROM_DATA)


def full_parameters(bundle: ModelBundle) -> FullParameters:
    """Find full parameters that can exist, of the effort model of a bundle."""
    return full_parameters_of(bundle.arm, effort_model(bundle))


# -- The same as a file has it: of a drive no more than rotor, damping and friction


def _of_file(bundle: ModelBundle, rotors: bool = True) -> tuple[BodyProblem, FloatArray]:
    """Give the data, and what the parameters of a file are in the model's drives, (drives, n)."""
    model = effort_model(bundle)
    problem = BodyProblem(bundle.arm, model, prior_of(bundle.arm))
    names = problem.columns[problem.first:]
    # of each joint rotor, damping, friction, and the zero of its effort, which no file has
    table = np.zeros((len(names), len(model.channels), 4))
    for row, name in zip(table, names, strict=True):
        kind, _, joint = name[:-1].partition('(')
        pair = 'rotor' if kind == 'Ia' else TERMS[term_of(name)].pair
        sign = TERMS[term_of(name)].backward_sign if kind.endswith('-') else 1.0
        row[model.channels.index(joint)] = (
            rotors and pair == 'rotor', sign * (pair == 'damping'), sign * (pair == 'friction'),
            kind in ('offset', f'{FRICTION}+', f'{FRICTION}-'))
    return problem, table.reshape(len(names), -1)


def file_parameters(bundle: ModelBundle, *, rotors: bool) -> FullParameters:
    """Find full parameters, and for their bodies the drives of a file that suit the data best."""
    full, (problem, table) = full_parameters(bundle), _of_file(bundle, rotors)
    drives = table @ _suited(problem, table, full.solution)
    return _full(bundle.arm, effort_model(bundle), replace(full.solution, drives=drives))


def _suited(problem: BodyProblem, table: FloatArray, solution: BodySolution) -> FloatArray:
    """Give what suits bodies best: the drives of a file, then those of further columns."""
    from scipy import optimize  # slow to import

    rows, wanted = [], []
    for channel, matrix, target in problem.parts:
        scaled = matrix * np.where(problem.scaled, 1.0 / solution.constants[channel], 1.0)
        rows.append(scaled[:, problem.first:] @ table)
        wanted.append(target - scaled[:, :problem.first] @ solution.bodies.ravel())
    whole, of_file = np.vstack(rows), 4 * problem.n_channels
    size = np.linalg.norm(whole, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    least = np.full(len(size), -np.inf)
    least[:of_file] = np.tile([0.0, 0.0, 0.0, -np.inf], problem.n_channels)
    return np.asarray(optimize.lsq_linear(
        whole / size, np.concatenate(wanted), (least, np.inf)).x / size)


def file_effects(
    bundle: ModelBundle, full: FullParameters, *, rotors: bool,
) -> dict[str, FullParameters]:
    """Give drives as a file has them, under an empty name, and with each effect that it lacks."""
    problem, table = _of_file(bundle, rotors)
    lacking: dict[str, list[int]] = {'': [], 'offset': []}
    for row in np.flatnonzero(~table.any(axis=1)).tolist():
        name = term_of(problem.columns[problem.first + row])
        lacking.setdefault('rotor inertias' if name == 'Ia' else name, []).append(row)
    found, solution = {}, full.solution
    for name, more in lacking.items():
        columns = np.hstack([table, np.eye(len(table))[:, more]])
        drives = _suited(problem, columns, solution)
        drives[3:table.shape[1]:4] *= name == 'offset'
        drives = columns @ drives
        found[name] = _full(bundle.arm, effort_model(bundle), replace(
            solution, drives=drives, relative_errors=problem.errors(
                np.concatenate([solution.bodies.ravel(), drives]), solution.constants)))
    return found


def file_errors(bundle: ModelBundle, full: FullParameters, file: Path) -> FloatArray:
    """Judge a URDF or MJCF, as Pinocchio reads it, by the training data; returns (joints,)."""
    text = file.read_text()
    read = pin.buildModelFromMJCF(str(file)) if '<mujoco' in text else replace(
        bundle.arm, full_model=model_from_urdf(text, str(file))).model
    (problem, table), drives = _of_file(bundle), []
    for name, constant in zip(full.model.channels, full.solution.constants, strict=True):
        place = read.joints[read.getJointId(name)].idx_v
        drives += [read.armature[place], read.damping[place] / constant,
                   read.friction[place] / constant, 0.0]
    bodies = [read.inertias[read.getJointId(name)].toDynamicParameters() for name in full.bodies]
    return problem.errors(np.concatenate([*bodies, table @ drives]), full.solution.constants)


def effort_model(bundle: ModelBundle) -> AnalyticalModel:
    """Find the model of efforts of which there are full parameters."""
    model = bundle.models.get('effort', {}).get('analytical')
    if not isinstance(model, AnalyticalModel) or model.payload_range is not None:
        raise ModelError(
            'masses come from an analytical model of efforts for one load, but this fit has '
            'none',
            remedy='run tudor fit on bags that have efforts and were recorded with one load')
    if not model.data_:
        raise ModelError('the model lacks the file data.npz, of which masses are computed',
                         remedy='fit the model again with this version')
    return model


def full_parameters_of(
    arm: Arm, model: AnalyticalModel, prior: Prior | None = None,
) -> FullParameters:
    """Find full parameters that can exist, of a model of efforts; prior: as described."""
    return _full(arm, model, solve_consistent(arm, model, prior or prior_of(arm)))


def described_parameters_of(
    arm: Arm, model: AnalyticalModel, prior: Prior | None = None,
) -> FullParameters:
    """Take bodies as they are described, with the drives that suit them best."""
    return _full(arm, model, solve_drives(arm, model, prior or prior_of(arm)))


def _full(arm: Arm, model: AnalyticalModel, solution: BodySolution) -> FullParameters:
    """Put full parameters in place of base parameters."""
    columns = model.regressor.columns
    full = full_of(solution, scaled_columns(arm, columns))
    groups = []
    for group in model.groups_:
        channels = list(group.base.channels)
        constants = None
        values = full[channels[0]]
        if group.constants is not None:
            constants = Constants(solution.constants[channels], solution.constant_errors[channels])
            values = np.concatenate([solution.bodies.ravel(), solution.drives])
        kept = np.flatnonzero(np.any(full[channels] != 0.0, axis=0))
        groups.append(group.of(columns, kept, values, constants))
    return FullParameters(arm, solution, columns, AnalyticalModel(
        model.regressor, model.n_joints, estimator=model.estimator, groups=groups))


# -- What two models or descriptions say of one arm: body by body, and of a recording

@dataclass(frozen=True, eq=False)
class Side:
    """One of two that are compared."""

    name: str  # as it was asked for
    arm: Arm  # arm that it describes
    bodies: dict[str, FloatArray]  # by joint, (10,), see `parameters_of` in `consistent.py`
    full: FullParameters | None = None  # what was identified; None for a description
    bundle: ModelBundle | None = None  # the model; None for a description


@dataclass(frozen=True)
class BodyRow:
    """A body as both sides have it."""

    joint: str  # joint that moves it
    mass: tuple[float, float]  # of each side [kg]
    apart: float  # distance of the centres of mass [m]
    inertia: tuple[float, float]  # about the joint's axis, of this body alone [kg m^2]


def side_of(path: str | Path) -> Side:
    """Read a model bundle, or an arm description with its URDF's own numbers."""
    path = Path(path)
    if path.is_dir():
        bundle = load_bundle(path, with_data=True)
        full = full_parameters(bundle)
        return Side(str(path), bundle.arm, full.bodies, full, bundle)
    arm = load_arm(path)
    bodies = described_bodies(arm)
    if not any(body[0] > 0.0 for body in bodies.values()):
        raise UsageError('the description has no masses, so nothing can be compared', place=path,
                         remedy='give a description whose URDF has masses, or the folder that '
                                'tudor fit wrote')
    return Side(str(path), arm, bodies)


def compare_bodies(one: Side, other: Side) -> list[BodyRow]:
    """Put bodies side by side."""
    if one.arm.active_joints != other.arm.active_joints:
        raise UsageError(
            f'{one.name} has the joints {", ".join(one.arm.active_joints)}, but {other.name} '
            f'has {", ".join(other.arm.active_joints)}', remedy='compare models of the same arm')
    return [body_row(joint, (one.arm, other.arm), (one.bodies[joint], other.bodies[joint]))
            for joint in one.bodies]


def described_bodies(arm: Arm) -> dict[str, FloatArray]:
    """Give the bodies as they are described, by the joint that moves each, as `Side` has them."""
    model = arm.model
    return {str(model.names[i]): np.asarray(model.inertias[i].toDynamicParameters())
            for i in range(1, model.njoints)}


def body_row(joint: str, arms: tuple[Arm, Arm], bodies: tuple[FloatArray, FloatArray]) -> BodyRow:
    """Compare a body with another: bodies (10,)."""
    a, b = (pin.Inertia.FromDynamicParameters(body) for body in bodies)
    # the lower right block of a spatial inertia is that about the joint
    turns = [float(axis @ body.matrix()[3:, 3:] @ axis) for body, axis in zip(
        (a, b), (joint_axis(arm.model, joint) for arm in arms), strict=True)]
    return BodyRow(joint, (float(a.mass), float(b.mass)),
                   float(np.linalg.norm(b.lever - a.lever)), (turns[0], turns[1]))


def errors_on(side: Side, measure: Side, stretches: Sequence[Stretch]) -> FloatArray:
    """Judge the bodies of a side on recorded motion; returns (joints,)."""
    full = side.full
    if full is None:
        assert measure.full is not None and measure.bundle is not None
        full = described_parameters_of(measure.arm, effort_model(measure.bundle),
                                       prior_of(side.arm))
    return relative_errors(full.model, stretches)


def relative_errors(model: AnalyticalModel, stretches: Sequence[Stretch]) -> FloatArray:
    """Judge a model of efforts on recorded motion; returns (joints,)."""
    parameters = model.coefficients()
    judged = [stretch for stretch in stretches if stretch.effort is not None]
    y = np.vstack([stretch.decimation(np.asarray(stretch.effort)) for stretch in judged])
    p = np.vstack([stretch.decimation(model.regressor.outputs(model.inputs(stretch), parameters))
                   for stretch in judged])
    size = np.linalg.norm(y, axis=0)
    return np.asarray(np.linalg.norm(p - y, axis=0) / np.where(size > 0.0, size, np.nan))
