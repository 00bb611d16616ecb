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

"""Pinocchio models from D-H rows and URDF, against kinematics and moments computed here."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
import pytest

from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.arm.kinematics import joint_axis, model_from_dh, model_from_urdf, read_urdf
from tudor_dynamics.errors import ArmError

# D-H rows of the UR10 as its maker publishes them (universal-robots.com, "DH parameters for
# calculations of kinematics and dynamics"): a, alpha, d, theta offset.
UR10 = [
    [0.0, math.pi / 2, 0.1273, 0.0],
    [-0.612, 0.0, 0.0, 0.0],
    [-0.5723, 0.0, 0.0, 0.0],
    [0.0, math.pi / 2, 0.163941, 0.0],
    [0.0, -math.pi / 2, 0.1157, 0.0],
    [0.0, 0.0, 0.0922, 0.0],
]


def urdf_model(path: Path) -> pin.Model:
    """Read a URDF file into a model."""
    return model_from_urdf(read_urdf(path), str(path))


def dh_matrix(a: float, alpha: float, d: float, theta: float) -> NDArray[np.float64]:
    """Give Siciliano et al. (2009), Eq. (2.52), element by element."""
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array([[ct, -st * ca, st * sa, a * ct],
                     [st, ct * ca, -ct * sa, a * st],
                     [0.0, sa, ca, d],
                     [0.0, 0.0, 0.0, 1.0]])


def tip(model: pin.Model, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the pose of the frame ``tip``."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.asarray(data.oMf[model.getFrameId('tip')].homogeneous)


@pytest.mark.parametrize('kinds', [
    ['revolute'] * 6,
    ['revolute', 'prismatic', 'continuous', 'prismatic', 'revolute', 'prismatic'],
])
def test_dh_rows(kinds: list[str]) -> None:
    """The chain ends where the product of D-H matrices ends, for all joint types."""
    rng = np.random.default_rng(1)
    rows = [[a, alpha, d, rng.uniform(-1, 1)] for a, alpha, d, _ in UR10]
    model = model_from_dh(rows, [f'j{i}' for i in range(6)], kinds)
    for q in rng.uniform(-3, 3, (20, 6)):
        expected = np.eye(4)
        for (a, alpha, d, theta), kind, value in zip(rows, kinds, q, strict=True):
            slides = kind == 'prismatic'
            expected = expected @ dh_matrix(
                a, alpha, d + value * slides, theta + value * (not slides))
        np.testing.assert_allclose(tip(model, q), expected, atol=1e-12)


# D-H rows of the Panda as its maker publishes them (Franka Control Interface documentation,
# "Denavit-Hartenberg parameters", Craig's convention), the flange last: a, alpha, d, theta offset.
PANDA = [
    [0.0, 0.0, 0.333, 0.0],
    [0.0, -math.pi / 2, 0.0, 0.0],
    [0.0, math.pi / 2, 0.316, 0.0],
    [0.0825, math.pi / 2, 0.0, 0.0],
    [-0.0825, -math.pi / 2, 0.384, 0.0],
    [0.0, math.pi / 2, 0.0, 0.0],
    [0.088, math.pi / 2, 0.0, 0.0],
    [0.0, 0.0, 0.107, 0.0],
]


def craig_matrix(a: float, alpha: float, d: float, theta: float) -> NDArray[np.float64]:
    """Give Craig, Introduction to Robotics (2005), Eq. (3.6), element by element."""
    ct, st, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array([[ct, -st, 0.0, a],
                     [st * ca, ct * ca, -sa, -d * sa],
                     [st * sa, ct * sa, ca, d * ca],
                     [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize('flange', [True, False])
def test_modified_rows(flange: bool) -> None:
    """Frames of joints and tip are those of Craig's matrices, with a flange or without."""
    rng = np.random.default_rng(1)
    rows = [[a, alpha, d, rng.uniform(-1, 1)] for a, alpha, d, _ in PANDA[:8 if flange else 7]]
    kinds = ['revolute', 'prismatic', *5 * ['revolute']]
    arm = arm_from_dict({
        'name': 'seven', 'kinematics': {'dh': rows, 'convention': 'modified'},
        'joints': [{'name': f'j{i}', 'type': kind, 'effort': {'unit': 'A'}}
                   for i, kind in enumerate(kinds)]}, base=Path(), source='seven.yaml')
    model = arm.full_model
    data = model.createData()
    for q in rng.uniform(-3, 3, (20, 7)):
        pin.forwardKinematics(model, data, q)
        expected = np.eye(4)
        for number, (a, alpha, d, theta) in enumerate(rows):
            value = q[number] if number < 7 else 0.0
            slides = number < 7 and kinds[number] == 'prismatic'
            expected = expected @ craig_matrix(
                a, alpha, d + value * slides, theta + value * (not slides))
            if number < 7:
                np.testing.assert_allclose(data.oMi[number + 1].homogeneous, expected, atol=1e-12)
        np.testing.assert_allclose(tip(model, q), expected, atol=1e-12)


def test_panda_stands_as_published() -> None:
    """At zero the flange is 88 mm before the base and 333 + 316 + 384 - 107 mm above it."""
    model = model_from_dh(PANDA, [f'j{i}' for i in range(7)], 7 * ['revolute'], 'modified')
    np.testing.assert_allclose(tip(model, np.zeros(7))[:3, 3], [0.088, 0.0, 0.926], atol=1e-12)


def test_dh_link_axis() -> None:
    """The x axis of a joint's frame lies along its link, where gauges are counted."""
    model = model_from_dh([[0.5, 0.3, 0.0, 0.7], [0.4, 0.0, 0.0, 0.0]], ['a', 'b'],
                          ['revolute', 'revolute'])
    np.testing.assert_allclose(model.jointPlacements[2].translation, [0.5, 0.0, 0.0], atol=1e-15)


def tudor_by_dh(config: Path) -> Arm:
    """Give the reference arm with D-H rows in place of the URDF."""
    content: dict[str, Any] = {
        'name': 'tudor',
        'kinematics': {'dh': [[0.0, math.pi / 2, 0.3, 0.0], [0.393, 0.0, 0.0, 0.0],
                              [0.393, 0.0, 0.0, 0.0]]},
        'joints': [{'name': f'joint{i}'} for i in (1, 2, 3)],
    }
    return arm_from_dict(content, base=config, source='test')


def test_urdf_is_dh(root: Path) -> None:
    """The URDF of the reference arm and D-H rows of the same geometry describe one arm."""
    urdf = load_arm(root / 'config' / 'tudor.yaml').full_model
    rows = tudor_by_dh(root / 'config').full_model
    rng = np.random.default_rng(2)
    for q in rng.uniform(-3, 3, (20, 3)):
        np.testing.assert_allclose(tip(urdf, q)[:3, 3], tip(rows, q)[:3, 3], atol=1e-12)
        axes = []
        for model in (urdf, rows):
            data = model.createData()
            axes.append(pin.computeJointJacobians(model, data, q)[3:])
        np.testing.assert_allclose(axes[0], axes[1], atol=1e-12)


def test_reference_arm_signs(root: Path) -> None:
    """A positive q2 lifts the stretched arm, and its load counts positive."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    q = np.array([0.0, 0.1, 0.0])
    assert tip(arm.full_model, q)[2, 3] == pytest.approx(0.3 + 0.786 * math.sin(0.1))
    # Blades of 185 g at their middles and the elbow motor of 0.82 kg at 0.393 m.
    load2 = 9.81 * (0.185 * 0.1965 + 0.82 * 0.393 + 0.185 * 0.5895)
    load3 = 9.81 * 0.185 * 0.1965
    tau = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), np.zeros(2))
    np.testing.assert_allclose(tau, [load2, load3], rtol=1e-9)


URDF = """<robot name="r"><link name="base"/><link name="a"/><link name="b"/>
<joint name="turn" type="{kind}"><parent link="base"/><child link="a"/>
<origin xyz="0 0 1" rpy="0.3 0 0"/><axis xyz="0 1 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/>
<axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_continuous_is_one_angle(tmp_path: Path) -> None:
    """A continuous joint has one coordinate and moves as a revolute one, with limits or none."""
    models = []
    for kind in ('revolute', 'continuous'):
        (tmp_path / f'{kind}.urdf').write_text(URDF.format(kind=kind))
        models.append(urdf_model(tmp_path / f'{kind}.urdf'))
    (tmp_path / 'free.urdf').write_text(URDF.format(kind='continuous').replace(
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>\n', '</joint>\n'))
    models.append(urdf_model(tmp_path / 'free.urdf'))
    poses = []
    for model in models:
        assert (model.nq, model.nv) == (2, 2)
        data = model.createData()
        pin.forwardKinematics(model, data, np.array([4.0, 0.2]))
        poses.append(data.oMi[2].homogeneous)
    np.testing.assert_allclose(poses[1], poses[0], atol=1e-12)
    np.testing.assert_allclose(poses[2], poses[0], atol=1e-12)


def test_axis_of_any_joint(tmp_path: Path) -> None:
    """A slanted axis is normalised; a slider's axis is its direction of travel."""
    (tmp_path / 'r.urdf').write_text(URDF.format(kind='revolute'))
    model = urdf_model(tmp_path / 'r.urdf')
    np.testing.assert_allclose(joint_axis(model, 'turn'), [0, 0.5**0.5, 0.5**0.5], atol=1e-12)
    np.testing.assert_allclose(joint_axis(model, 'slide'), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(('text', 'expected'), [
    ('<robot', 'no valid XML .*; for xacro files run xacro first'),
    ('<robot name="r"/>', 'Pinocchio cannot read this URDF'),
    (URDF.format(kind='floating'), "joint 'turn' is floating, but only revolute, "),
    (URDF.format(kind='planar'), "joint 'turn' is planar, but only revolute, "),
    (URDF.format(kind='screw'), 'r.urdf: '),
])
def test_urdf_mistakes(tmp_path: Path, text: str, expected: str) -> None:
    """A URDF that cannot be used is refused with its name and the reason."""
    (tmp_path / 'r.urdf').write_text(text)
    with pytest.raises(ArmError, match=expected) as caught:
        urdf_model(tmp_path / 'r.urdf')
    assert 'r.urdf' in str(caught.value)
