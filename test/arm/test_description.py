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

"""The arm as the package sees it: held joints, digest, and moments at the gauges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import pinocchio as pin
import pytest
from tudor_dynamics.arm.description import Arm, arm_from_dict, load_arm
from tudor_dynamics.errors import ArmError
import yaml

LENGTH = 0.393
GRAVITY = 9.81
# Where a link is cut, and one point mass [kg] at each of these places along it [m].
CUTS = {'joint2': ('joint2', 'link2_hub', 'link2_mid'),
        'joint3': ('joint3', 'link3_hub', 'link3_mid')}
GAUGES = {'link2_hub': 0.05, 'link2_mid': 0.24, 'link3_hub': 0.05, 'link3_mid': 0.24}
PLACES = np.linspace(0.01, 0.39, 13)
MASSES = {'joint2': np.linspace(0.02, 0.05, 13), 'joint3': np.linspace(0.03, 0.01, 13)}


@pytest.fixture
def content(root: Path) -> Any:
    """Read the reference arm's description."""
    return yaml.safe_load((root / 'config' / 'tudor.yaml').read_text(encoding='utf-8'))


@pytest.fixture
def arm(root: Path) -> Arm:
    """Load the reference arm."""
    return load_arm(root / 'config' / 'tudor.yaml')


def loaded_gauge_model(arm: Arm) -> pin.Model:
    """Give the cut model with the point masses, each on the piece of the link it sits on."""
    model = arm.gauge_model
    for joint, pieces in CUTS.items():
        starts = np.array([0.0, *(GAUGES[name] for name in pieces[1:])])
        inertias = [pin.Inertia.Zero() for _ in pieces]
        for place, mass in zip(PLACES, MASSES[joint], strict=True):
            piece = int(np.flatnonzero(starts <= place)[-1])
            point = np.array([place - starts[piece], 0.0, 0.0])
            inertias[piece] = inertias[piece] + pin.Inertia(mass, point, np.zeros((3, 3)))
        for name, inertia in zip(pieces, inertias, strict=True):
            model.inertias[model.getJointId(name)] = inertia
    return model


def points(q: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Place masses and gauges in the vertical plane by trigonometry alone, (n, 2) [m]."""
    along2 = np.array([np.cos(q[0]), np.sin(q[0])])
    along3 = np.array([np.cos(q[0] + q[1]), np.sin(q[0] + q[1])])
    elbow = LENGTH * along2
    found = {'joint2': PLACES[:, None] * along2, 'joint3': elbow + PLACES[:, None] * along3}
    for name, distance in GAUGES.items():
        found[name] = distance * along2 if 'link2' in name else elbow + distance * along3
    return found


def expected_moment(
    gauge: str, q: NDArray[np.float64], dq: NDArray[np.float64], ddq: NDArray[np.float64],
) -> float:
    """Sum the moments of weight and inertia of all outboard masses about the gauge [N m]."""
    step = 1e-4

    def at(time: float) -> dict[str, NDArray[np.float64]]:
        return points(q + dq * time + ddq * time**2 / 2)

    before, now, after = at(-step), at(0.0), at(step)
    moment = 0.0
    for joint in ('joint2', 'joint3'):
        if joint == 'joint2' and 'link3' in gauge:
            continue  # inboard
        acceleration = (after[joint] - 2 * now[joint] + before[joint]) / step**2
        force = MASSES[joint][:, None] * (acceleration + np.array([0.0, GRAVITY]))
        lever = now[joint] - now[gauge]
        each = lever[:, 0] * force[:, 1] - lever[:, 1] * force[:, 0]
        own_link = joint[-1] == gauge[4]
        moment += each[PLACES > GAUGES[gauge]].sum() if own_link else each.sum()
    return float(moment)


@pytest.mark.parametrize('gauge', sorted(GAUGES))
@pytest.mark.parametrize('moving', [False, True])
def test_bending_moment(arm: Arm, gauge: str, moving: bool) -> None:
    """The torque of the virtual joint is the moment of all that is outboard of the gauge."""
    model = loaded_gauge_model(arm)
    data = model.createData()
    rng = np.random.default_rng(3)
    active = [model.joints[model.getJointId(name)].idx_v for name in arm.active_joints]
    index = model.joints[model.getJointId(gauge)].idx_v
    for _ in range(10):
        state = np.zeros((3, model.nv))
        state[0, active] = rng.uniform(-2, 2, 2)
        if moving:
            state[1:, active] = rng.uniform(-4, 4, (2, 2))
        expected = expected_moment(gauge, *state[:, active])
        assert pin.rnea(model, data, *state)[index] == pytest.approx(expected, abs=2e-6)


def test_stretched_arm_by_hand(arm: Arm) -> None:
    """At q = 0 the static moment is the sum of weights times levers, and positive."""
    model = loaded_gauge_model(arm)
    zero = np.zeros(model.nv)
    tau = pin.rnea(model, model.createData(), zero, zero, zero)
    for gauge, distance in GAUGES.items():
        outboard = PLACES > distance
        if 'link3' in gauge:
            lever = MASSES['joint3'][outboard] @ (PLACES[outboard] - distance)
        else:
            lever = (MASSES['joint2'][outboard] @ (PLACES[outboard] - distance)
                     + MASSES['joint3'] @ (PLACES + LENGTH - distance))
        moment = tau[model.joints[model.getJointId(gauge)].idx_v]
        assert moment == pytest.approx(GRAVITY * lever, rel=1e-9)
        assert moment > 0


def test_gauge_joints_change_nothing_else(arm: Arm, root: Path) -> None:
    """The cut model needs the same joint torques as an uncut one with the same masses."""
    cut = loaded_gauge_model(arm)
    whole = load_arm(root / 'config' / 'tudor.yaml').model
    for joint, masses in MASSES.items():
        total = pin.Inertia.Zero()
        for place, mass in zip(PLACES, masses, strict=True):
            total = total + pin.Inertia(mass, np.array([place, 0.0, 0.0]), np.zeros((3, 3)))
        whole.inertias[whole.getJointId(joint)] = total
    active = [cut.joints[cut.getJointId(name)].idx_v for name in arm.active_joints]
    rng = np.random.default_rng(4)
    for state in rng.uniform(-2, 2, (10, 3, 2)):
        wide = np.zeros((3, cut.nv))
        wide[:, active] = state
        np.testing.assert_allclose(pin.rnea(cut, cut.createData(), *wide)[active],
                                   pin.rnea(whole, whole.createData(), *state), atol=1e-12)


def test_gauge_order_in_file_is_free(content: Any, root: Path) -> None:
    """Gauges are cut from the joint outwards, however they are listed."""
    content['gauges'].reverse()
    arm = arm_from_dict(content, base=root / 'config', source='test')
    assert arm.gauge_names == ('link3_mid', 'link2_mid', 'link3_hub', 'link2_hub')
    names = list(arm.gauge_model.names)
    assert names.index('link2_hub') < names.index('link2_mid') < names.index('joint3')


def test_held_joint(content: Any, root: Path) -> None:
    """A held joint stays where the description says, in both models."""
    content['joints'][1]['hold'] = 0.5
    content['active_joints'] = ['joint3']
    arm = arm_from_dict(content, base=root / 'config', source='test')
    assert arm.active_joints == ('joint3',)
    assert list(arm.model.names)[1:] == ['joint3']
    tau = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), np.array([-0.5]))
    assert tau[0] == pytest.approx(9.81 * 0.185 * 0.1965)
    names = list(arm.gauge_model.names)[1:]
    assert set(names) == {'joint3', *arm.gauge_names}


def test_active_joints_in_their_own_order(content: Any, root: Path) -> None:
    """The order of active_joints is kept, and the index leads into the model's vectors."""
    content['active_joints'] = ['joint3', 'joint2']
    arm = arm_from_dict(content, base=root / 'config', source='test')
    assert [joint.name for joint in arm.joints] == ['joint3', 'joint2']
    assert arm.velocity_index.tolist() == [1, 0]


def test_gravity_direction(content: Any, root: Path) -> None:
    """An arm on a wall carries nothing where gravity is along its links."""
    content['gravity'] = [9.81, 0.0, 0.0]
    arm = arm_from_dict(content, base=root / 'config', source='test')
    tau = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), np.zeros(2))
    np.testing.assert_allclose(tau, 0.0, atol=1e-12)
    assert arm.gauge_model.gravity.linear.tolist() == [9.81, 0.0, 0.0]


def test_digest_of_what_counts(content: Any, root: Path) -> None:
    """Kinematics, gauges and friction make another arm; limits, motors and damper do not."""
    def digest() -> str:
        return arm_from_dict(content, base=root / 'config', source='any').digest

    first = digest()
    assert len(first) == 64
    content['motors'][1]['rotor_inertia'] = 2e-5
    content['sensors'] = []
    del content['damper']
    content['joints'][1]['limits']['velocity'] = 2.0
    assert digest() == first
    seen = {first}
    for change in (
        lambda: content['gauges'][0].update(distance=0.06),
        lambda: content['joints'][1].update(friction=['viscous']),
        lambda: content['joints'][0].update(hold=0.1),
        lambda: content.update(gravity=[0.0, 0.0, -1.62]),
        lambda: content.update(active_joints=['joint3', 'joint2']),
    ):
        change()
        assert digest() not in seen
        seen.add(digest())


def test_digest_of_geometry(content: Any, root: Path, tmp_path: Path) -> None:
    """A copy of the URDF under another name is the same arm, a longer link is another."""
    text = (root / 'config' / 'tudor.urdf').read_text(encoding='utf-8')
    (tmp_path / 'copy.urdf').write_text(text)
    (tmp_path / 'long.urdf').write_text(text.replace('<origin xyz="0.393 0 0"/>',
                                                     '<origin xyz="0.4 0 0"/>'))
    digests = []
    for base, name in ((root / 'config', 'tudor.urdf'), (tmp_path, 'copy.urdf'),
                       (tmp_path, 'long.urdf')):
        content['kinematics'] = {'urdf': name}
        digests.append(arm_from_dict(content, base=base, source='any').digest)
    assert digests[0] == digests[1] != digests[2]


def test_joints_against_urdf(content: Any, root: Path) -> None:
    """A joint that the URDF lacks, or has with another type, is refused."""
    base = root / 'config'
    content['motors'] = []
    content['links'] = []
    content['joints'][0]['name'] = 'shoulder'
    with pytest.raises(ArmError, match=(
            r"any: joint 'shoulder' is not among the joints of the URDF that can move, "
            r"\['joint1', 'joint2', 'joint3'\]; correct joints\[\].name")):
        arm_from_dict(content, base=base, source='any')
    content['joints'][0].update(name='joint1', type='prismatic')
    with pytest.raises(ArmError, match=(
            "any: joint 'joint1' is revolute in the URDF, but its type here is prismatic; "
            r'correct joints\[\].type')):
        arm_from_dict(content, base=base, source='any')


@pytest.mark.parametrize('name', sorted(
    file.name for file in (Path(__file__).parents[2] / 'config').glob('*_arm.yaml')))
def test_other_descriptions(root: Path, name: str) -> None:
    """Every arm that ships can be read, and its models be built."""
    arm = load_arm(root / 'config' / name)
    assert arm.model.nv == len(arm.active_joints)
    assert arm.gauge_model.nv == len(arm.active_joints) + len(arm.gauges)
