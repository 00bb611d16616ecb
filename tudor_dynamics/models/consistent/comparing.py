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

"""What two models or descriptions say of one arm: body by body, and of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm, load_arm
from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.consistent.bodies import prior_of
from tudor_dynamics.models.consistent.full import (
    described_parameters_of, effort_model, full_parameters, FullParameters)
from tudor_dynamics.models.storage.bundle_io import load_bundle
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Side:
    """One of two that are compared."""

    name: str  # as it was asked for
    arm: Arm  # arm that it describes
    # Mass, first moments, inertia about the joint, by joint, (10,) [kg, kg m, kg m^2].
    bodies: dict[str, FloatArray]
    full: FullParameters | None = None  # what was identified; None for a description
    bundle: ModelBundle | None = None  # the model; None for a description


@dataclass(frozen=True)
class BodyRow:
    """A body as both sides have it."""

    joint: str  # joint that moves it
    mass: tuple[float, float]  # of each side [kg]
    apart: float  # distance of the centres of mass [m]
    # Moment of inertia about the joint's axis, bodies beyond it left out [kg m^2].
    inertia: tuple[float, float]


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
        raise UsageError('describes no masses: there is nothing to compare', place=path,
                         remedy='give a description with a URDF that has masses, or a model')
    return Side(str(path), arm, bodies)


def compare_bodies(one: Side, other: Side) -> list[BodyRow]:
    """Put bodies side by side."""
    if one.arm.active_joints != other.arm.active_joints:
        raise UsageError(
            f'{one.name} has the joints {", ".join(one.arm.active_joints)}, {other.name} '
            f'{", ".join(other.arm.active_joints)}', remedy='compare models of one arm')
    return [body_row(joint, (one.arm, other.arm), (one.bodies[joint], other.bodies[joint]))
            for joint in one.bodies]


def described_bodies(arm: Arm) -> dict[str, FloatArray]:
    """Give the bodies as they are described, by the joint that moves each, as `Side` has them."""
    model = arm.model
    return {str(model.names[i]): np.asarray(model.inertias[i].toDynamicParameters())
            for i in range(1, model.njoints)}


def body_row(
    joint: str, arms: tuple[Arm, Arm], bodies: tuple[FloatArray, FloatArray],
) -> BodyRow:
    """Put a body beside another: bodies (10,)."""
    (one, other), (a, b) = bodies, (pin.Inertia.FromDynamicParameters(body) for body in bodies)
    turns = []
    for arm, body in zip(arms, (one, other), strict=True):
        axis = np.asarray(joint_axis(arm.model, joint))
        about = body[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3)
        turns.append(float(axis @ about @ axis))
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
