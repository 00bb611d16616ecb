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

"""URDFs that no arm has: endless, deep, closed, with masses that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.arm.kinematics import model_from_urdf
from tudor_dynamics.arm.kinematics import read_urdf
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.errors import ArmError

LINK = ('<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>')
JOINT = ('<joint name="j{1}" type="{2}"><parent link="l{0}"/><child link="l{1}"/>'
         '<origin xyz="1 0 0"/><axis xyz="0 0 1"/>'
         '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>')


def chain(links: int, kind: str = 'revolute') -> str:
    """Describe a chain."""
    parts = [LINK.format(i) for i in range(links)]
    parts += [JOINT.format(i, i + 1, kind) for i in range(links - 1)]
    return f'<robot name="r">{"".join(parts)}</robot>'


def with_joint(ends: str, more: str = '') -> str:
    """Add a joint between some links to a chain of three."""
    return chain(3).replace('</robot>', f'{more}<joint name="back" type="fixed">{ends}</joint>'
                            '</robot>')


def test_what_is_taken_otherwise_is_said(tmp_path: Path) -> None:
    """Mimic joints are fixed; limits of 0 are none; a body that cannot be stays, with a note."""
    text = chain(4).replace('</joint></robot>', '<mimic joint="j1"/></joint></robot>').replace(
        'lower="-1" upper="1"', 'lower="0" upper="0"', 1).replace('ixx="1"', 'ixx="3"', 1)
    (tmp_path / 'r.urdf').write_text(text)
    content = {'name': 'r', 'kinematics': {'urdf': 'r.urdf'},
               'joints': [{'name': 'j1'}, {'name': 'j2'}]}
    arm = arm_from_dict(content, base=tmp_path, source='r.yaml')
    assert arm.movable_joints == ('j1', 'j2')
    assert [note.partition(':')[0] for note in arm.notes] == [
        "joint 'j1' has limits of position from 0 to 0", "joint 'j3' mimics 'j1'",
        "link 'l0' has moments of inertia (1, 1, 3 kg m^2) that no body has"]
    assert hard_limits(arm).lower[0] == -np.inf
    content['joints'].append({'name': 'j3'})
    with pytest.raises(ArmError, match="'j3' is not among the joints of the URDF.*mimic"):
        arm_from_dict(content, base=tmp_path, source='r.yaml')


def test_limits_that_are_none() -> None:
    """Some write a limit that is none as a very large number."""
    text = chain(2).replace('lower="-1" upper="1"', 'lower="-1e16" upper="1e16"')
    assert model_from_urdf(text, 'r.urdf').nq == 1


def test_chains_of_a_size_are_read() -> None:
    """A hundred joints are an arm."""
    assert model_from_urdf(chain(101), 'r.urdf').nq == 100
    assert model_from_urdf(chain(1000, 'fixed'), 'r.urdf').nq == 0


@pytest.mark.parametrize(('text', 'cause'), [
    (chain(1001), '1001 links; at most 1000'),
    (chain(20_000), '100001 elements .* at most 100000 and 50'),
    ('<a>' * 100_000 + '</a>' * 100_000, '51 levels or more'),
    ('<!DOCTYPE r [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>', 'DOCTYPE'),
    (chain(3).replace('mass value="1"', 'mass value="nan"', 1), "'l0' has mass value='nan'"),
    (chain(3).replace('mass value="1"', 'mass value="1e999"', 1), 'expected a mass in kg'),
    (chain(3).replace('mass value="1"', 'mass value="-1"', 1), 'expected a mass in kg'),
    (chain(3).replace('ixx="1"', 'ixx="1_0"', 1), 'expected a finite number'),
    (chain(3).replace('xyz="1 0 0"', 'xyz="1 0 inf"', 1), 'expected 3 finite numbers'),
    (chain(3).replace('xyz="1 0 0"', 'xyz="1 0 1e16"', 1), 'expected 3 finite numbers'),
    (chain(3).replace('xyz="0 0 1"', 'xyz="0 1"', 1), "joint 'j1' has axis xyz='0 1'"),
    (chain(3).replace('"l2"', '"l1"'), "link 'l1' is not unique"),
    (with_joint('<parent link="l0"/><child link="l2"/>'), "the same child 'l2' as joint 'j2'"),
    (with_joint('<parent link="l2"/><child link="l0"/>'), "link 'l0' is in a closed loop"),
    (with_joint('<parent link="l2"/><child link="l2"/>'), 'a URDF must be a tree'),
    (with_joint('<parent link="l2"/><child link="l9"/>'), "child 'l9', which is no link"),
    (with_joint('<parent link="l2"/>'), "child '', which is no link"),
    (chain(3).replace('</robot>', '<link name="m"/></robot>'),
     '2 links have no parent joint .l0, m.'),
    (chain(3).replace('"j2"', '"j1"'), "joint 'j1' is not unique"),
    (chain(3).replace('name="j2"', ''), 'a joint has no name'),
    (chain(3, 'ball'), "'j1' is of type 'ball'; write revolute"),
    (chain(3, 'floating'), "'j1' is floating"),
    (chain(3).replace('0 0 1', '0 0 0', 1), "'j1' has the axis '0 0 0' without length"),
    (chain(3).replace('ixx="1"', 'ixx="-1"', 1), "'l0' has a negative moment of inertia"),
    (chain(3).replace('ixy="0"', 'ixy="2"', 1), "'l0' has a negative moment of inertia"),
    (chain(3).replace('lower="-1"', 'lower="2"', 1), "'j1' has limits from 2 to 1"),
    (chain(3).replace('velocity="1"', 'velocity="-1"', 1), 'a negative limit of velocity'),
    (chain(3).replace('mass value="1"', 'mass value="${m}"', 1), '.m.. is xacro, not URDF'),
    (chain(3).replace('"l2"', '"$(arg p)l2"'), 'is xacro, not URDF; run `xacro IN'),
    (chain(3).replace('<robot name="r">', '<robot name="r" xmlns:xacro="http://ros.org/xacro">'
                      '<xacro:macro name="m"/>'), "'xacro:macro' is xacro, not URDF"),
    (with_joint('<parent link="l2"/><child link="m"/><mimic joint="gone"/>', '<link name="m"/>'),
     "'back' mimics 'gone', which is no other joint"),
    ('<sdf/>', 'begins with <sdf>, expected <robot>'),
    (chain(3).replace('<mass value="1"/>', '', 1), 'Inertial element must have a mass'),
    ('<robot name="r"/>', 'No link'),
    ('', 'no valid XML')])
def test_refused(text: str, cause: str, capfd: pytest.CaptureFixture[str]) -> None:
    """One line names the cause; the parsers that Pinocchio uses add none of their own."""
    with pytest.raises(ArmError, match=cause) as caught:
        model_from_urdf(text, 'r.urdf')
    assert str(caught.value).startswith('r.urdf: ') and len(str(caught.value)) < 300
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize(('path', 'cause'), [
    ('/dev/zero', 'it is a device, .*not a file'), ('.', 'it is a directory'),
    ('gone', 'No such file or directory')])
def test_what_is_no_file(path: str, cause: str) -> None:
    """Devices are not read."""
    with pytest.raises(ArmError, match=f'the URDF cannot be read .{cause}.; check'):
        read_urdf(Path(path))


def test_joint_and_link_of_one_name(tmp_path: Path) -> None:
    """Where Pinocchio cannot hold a joint because a link has its name, the answer says so."""
    (tmp_path / 'r.urdf').write_text(chain(3).replace('"j1"', '"l1"'))
    content = {'name': 'r', 'kinematics': {'urdf': 'r.urdf'}, 'joints': [{'name': 'l1'},
                                                                         {'name': 'j2'}]}
    arm_from_dict(content, base=tmp_path, source='r.yaml').model.createData()
    held = arm_from_dict({**content, 'active_joints': ['j2']}, base=tmp_path, source='r.yaml')
    with pytest.raises(ArmError, match='r.yaml: joints cannot be held .*own names'):
        held.model.createData()
