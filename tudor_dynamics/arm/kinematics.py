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

"""From a D-H table to a Pinocchio model; joints and gauges of any model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin

from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.errors import ArmError


def unit_vector(axis: str | Sequence[float]) -> NDArray[np.float64]:
    """Give the unit vector of an axis name or of any vector; returns (3,)."""
    if isinstance(axis, str):
        named: NDArray[np.float64] = np.eye(3)['xyz'.index(axis)]
        return named
    vector = np.asarray(axis, dtype=float)
    norm = float(np.linalg.norm(vector))
    if norm < 1e-12:
        msg = f'the axis {list(axis)} has no length: give x, y, z or a vector'
        raise ArmError(msg)
    unit: NDArray[np.float64] = vector / norm
    return unit


def gauge_point(gauge: GaugeSpec) -> NDArray[np.float64]:
    """
    Give the place of a gauge, for the regressor's cut and the simulator's beam alike.

    Returns (3,) [m].
    """
    return gauge.distance * unit_vector(gauge.direction)


def _translation(x: float, y: float, z: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def _rotation(axis: str, angle: float) -> pin.SE3:
    return pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3))


def model_from_dh(
    rows: Sequence[Sequence[float]],
    names: Sequence[str],
    types: Sequence[str],
    convention: str = 'standard',
) -> pin.Model:
    """
    Build a serial chain from Denavit-Hartenberg rows, links without mass.

    Standard: link i follows joint i by ``Rz(theta + q) Tz(d) Tx(a) Rx(alpha)`` (Siciliano et al.,
    Robotics: Modelling, Planning and Control, 2009, Eq. 2.52), or ``Tz(d + q)`` for a prismatic
    joint. The frame of joint i turns with the joint and has its x axis along the link, so that a
    gauge is found at ``distance`` along x.

    Modified: joint i follows joint i - 1 by ``Rx(alpha) Tx(a) Rz(theta + q) Tz(d)`` (Craig,
    Introduction to Robotics, 2005, Eq. 3.6), and its frame is that of the table.

    Parameters
    ----------
    rows : sequence of (a [m], alpha [rad], d [m], theta_offset [rad])
        One row a joint, base first.
    names : sequence of str
        Names of the joints, one a row, base first.
    types : sequence of {'revolute', 'continuous', 'prismatic'}
        How each joint moves, in the same order.
    convention : {'standard', 'modified'}
        Of the rows; modified ones may have one more than joints, for a flange.

    Returns
    -------
    pinocchio.Model
        Chain with a frame ``tip`` at the end of the last row.

    """
    model = pin.Model()
    placement = pin.SE3.Identity()
    parent = 0
    for number, (a, alpha, d, theta) in enumerate(rows):
        # along the joint's axis and across it: where the joint stands between them differs
        turn, rise = _rotation('z', theta), _translation(0.0, 0.0, d)
        across = _translation(a, 0.0, 0.0) * _rotation('x', alpha)
        standard = convention == 'standard'
        placement = placement * (turn if standard else across * turn * rise)
        if number < len(names):
            slides = types[number] == 'prismatic'
            joint = pin.JointModelPZ() if slides else pin.JointModelRZ()
            parent = model.addJoint(parent, joint, placement, names[number])
            model.addJointFrame(parent)
            placement = rise * across if standard else pin.SE3.Identity()
    model.addFrame(pin.Frame('tip', parent, placement, pin.FrameType.OP_FRAME))
    return model


def is_prismatic(model: pin.Model, joint: str) -> bool:
    """
    Say whether a joint moves along its axis.

    Returns False for a joint that turns about its axis.
    """
    short: str = model.joints[model.getJointId(joint)].shortname()
    return short.startswith('JointModelP')


def joint_axis(model: pin.Model, joint: str) -> NDArray[np.float64]:
    """Give the axis of a joint in its own frame; returns (3,)."""
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    index = model.getJointId(joint)
    column = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL)
    column = column.reshape(6, -1)[:, model.joints[index].idx_v]
    linear, angular = column[:3], column[3:]
    axis = angular if np.linalg.norm(angular) > 0.5 else linear
    return np.asarray(axis, dtype=float)


def link_frame(model: pin.Model, joint: str) -> str:
    """Give the name of the frame that turns with a joint: its link's, or the joint's own."""
    index = model.getJointId(joint)
    for frame in model.frames:
        if (frame.type == pin.FrameType.BODY and frame.parentJoint == index
                and frame.placement.isIdentity(1e-9)):
            return str(frame.name)
    return joint


def with_gauge_joints(
    model: pin.Model,
    places: Sequence[tuple[str, str, NDArray[np.float64], NDArray[np.float64]]],
) -> pin.Model:
    """
    Cut links at their gauges by virtual joints about the bending axes.

    The torque of such a joint, kept at zero angle, is the bending moment at the gauge: exactly the
    moment of everything outboard about the point x_s, with the reaction force's lever shortened by
    x_s and the moment's not. (Malzahn et al., Eqs. (8)-(15), take the joint's own moment instead
    and call the difference constant, which it is not.)

    Parameters
    ----------
    model : pinocchio.Model
        Arm without gauges.
    places : sequence of (name, joint, point (3,) [m], axis (3,))
        Gauge, joint before it, place and bending axis in the joint's frame. Gauges of one joint
        must be sorted from the joint outwards.

    Returns
    -------
    pinocchio.Model
        Arm with one revolute joint more for each gauge, named as the gauge. The outboard part of
        a cut link has its mass parameters to itself.

    """
    cut = pin.Model()
    cut.gravity = model.gravity
    moved: dict[int, tuple[int, pin.SE3]] = {0: (0, pin.SE3.Identity())}
    for index in range(1, model.njoints):
        parent, offset = moved[model.parents[index]]
        name = model.names[index]
        new = cut.addJoint(parent, model.joints[index],
                           offset.inverse() * model.jointPlacements[index], name)
        cut.addJointFrame(new)  # buildReducedModel reads the frames of the joints it locks
        cut.appendBodyToJoint(new, model.inertias[index], pin.SE3.Identity())
        here = pin.SE3.Identity()
        for gauge, joint, point, axis in places:
            if joint != name:
                continue
            place = pin.SE3(np.eye(3), np.asarray(point, dtype=float))
            new = cut.addJoint(new, pin.JointModelRevoluteUnaligned(axis),
                               here.inverse() * place, gauge)
            cut.addJointFrame(new)
            here = place
        moved[index] = (new, here)
    return cut
