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
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm, load_arm
from tudor_dynamics.arm.kinematics import joint_axis
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.consistent.full import full_parameters, FullParameters, scaled_columns
from tudor_dynamics.models.consistent.solve import full_of
from tudor_dynamics.models.storage.bundle_io import load_bundle
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Side:
    """
    One of two that are compared.

    Attributes
    ----------
    name : str
        As it was asked for.
    arm : Arm
        Arm that it describes.
    bodies : dict of str to ndarray of shape (10,)
        Mass, first moments, inertia about the joint, by joint [kg, kg m, kg m^2].
    full : FullParameters or None
        What was identified; None for a description.
    bundle : ModelBundle or None
        The model; None for a description.

    """

    name: str
    arm: Arm
    bodies: dict[str, FloatArray]
    full: FullParameters | None = None
    bundle: ModelBundle | None = None


@dataclass(frozen=True)
class BodyRow:
    """
    A body as both sides have it.

    Attributes
    ----------
    joint : str
        Joint that moves it.
    mass : (float, float)
        Of each side [kg].
    apart : float
        Distance of the centres of mass [m].
    inertia : (float, float)
        Moment of inertia about the joint's axis, bodies beyond it left out [kg m^2].

    """

    joint: str
    mass: tuple[float, float]
    apart: float
    inertia: tuple[float, float]


def side_of(path: str | Path) -> Side:
    """
    Read a model bundle, or an arm description with its URDF's own numbers.

    Parameters
    ----------
    path : str or Path
        Directory of a bundle, or arm YAML.

    Returns
    -------
    Side
        Bodies with where they came from.

    Raises
    ------
    TudorError
        If it can be read as neither.

    """
    path = Path(path)
    if path.is_dir():
        bundle = load_bundle(path, with_data=True)
        full = full_parameters(bundle)
        return Side(str(path), bundle.arm, full.bodies, full, bundle)
    arm = load_arm(path)
    model = arm.model
    bodies = {str(model.names[i]): np.asarray(model.inertias[i].toDynamicParameters())
              for i in range(1, model.njoints)}
    if not any(body[0] > 0.0 for body in bodies.values()):
        raise UsageError('describes no masses: there is nothing to compare', place=path,
                         remedy='give a description with a URDF that has masses, or a model')
    return Side(str(path), arm, bodies)


def compare_bodies(one: Side, other: Side) -> list[BodyRow]:
    """
    Put bodies side by side.

    Parameters
    ----------
    one, other : Side
        Sides with the same active joints.

    Returns
    -------
    list of BodyRow
        One for each joint.

    Raises
    ------
    UsageError
        If the sides have other joints.

    """
    if one.arm.active_joints != other.arm.active_joints:
        raise UsageError(
            f'{one.name} has the joints {", ".join(one.arm.active_joints)}, {other.name} '
            f'{", ".join(other.arm.active_joints)}', remedy='compare models of one arm')
    rows = []
    for joint in one.bodies:
        found = []
        for side in (one, other):
            inertia = pin.Inertia.FromDynamicParameters(side.bodies[joint])
            axis = _axis(side.arm, joint)
            about = side.bodies[joint][[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3)
            found.append((float(inertia.mass), np.asarray(inertia.lever),
                          float(axis @ about @ axis)))
        (mass_a, center_a, turn_a), (mass_b, center_b, turn_b) = found
        rows.append(BodyRow(joint, (mass_a, mass_b), float(np.linalg.norm(center_b - center_a)),
                            (turn_a, turn_b)))
    return rows


def _axis(arm: Arm, joint: str) -> FloatArray:
    return np.asarray(joint_axis(arm.model, joint))


def errors_on(side: Side, measure: Side, stretches: Sequence[Stretch]) -> FloatArray:
    """
    Judge the bodies of a side on recorded motion.

    Parameters
    ----------
    side : Side
        Side to be judged. A description has no drives: those of ``measure`` count.
    measure : Side
        Side with a model, which gives filters, friction and torque constants.
    stretches : sequence of Stretch
        Motion with efforts, filtered as the model of ``measure`` was.

    Returns
    -------
    ndarray of shape (n_joints,)
        Relative error of each joint's effort.

    """
    full = side.full or measure.full
    assert full is not None
    parameters = full.model.coefficients()
    if side.full is None:
        bodies = np.array([side.bodies[name] for name in full.bodies])
        parameters = full_of(replace(full.solution, bodies=bodies),
                             scaled_columns(full.arm, full.columns))
    measured, predicted = [], []
    for stretch in stretches:
        if stretch.effort is not None:
            measured.append(stretch.decimation(stretch.effort))
            predicted.append(stretch.decimation(
                full.model.regressor.outputs(stretch.motion, parameters)))
    y, p = np.vstack(measured), np.vstack(predicted)
    size = np.linalg.norm(y, axis=0)
    return np.asarray(np.linalg.norm(p - y, axis=0) / np.where(size > 0.0, size, np.nan))
