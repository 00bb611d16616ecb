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

"""What an arm description may say, and how each mistake is refused."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

from hypothesis import given, strategies as st
import pytest

from tudor_dynamics.arm.description import arm_from_dict, load_arm
from tudor_dynamics.errors import ArmError, TudorError

ARM: dict[str, Any] = {
    'name': 'arm',
    'kinematics': {'dh': [[0.0, 1.5707963267948966, 0.3, 0.0], [0.4, 0.0, 0.0, 0.0]]},
    'joints': [{'name': 'one'}, {'name': 'two', 'effort': {'unit': 'A'}}],
    'gauges': [{'name': 'hub', 'joint': 'two', 'distance': 0.05}],
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """Give the description with another value at a path such as ``joints.0.name``."""
    content = deepcopy(ARM)
    *parents, last = [int(key) if key.isdigit() else key for key in path.split('.')]
    place: Any = content
    for key in parents:
        place = place[key]
    place[last] = value
    return content


def refusal(content: Any) -> str:
    """Give the message with which a description is refused."""
    with pytest.raises(ArmError) as caught:
        arm_from_dict(content, base=Path(), source='arm.yaml')
    message = str(caught.value)
    assert message.startswith('arm.yaml: ')
    assert '\n' not in message
    return message


def test_defaults() -> None:
    """A short description gets the documented defaults."""
    arm = arm_from_dict(ARM, base=Path(), source='arm.yaml')
    assert arm.active_joints == ('one', 'two')
    assert arm.joints[0].effort.topic == 'joint_states'
    assert arm.joints[0].effort.unit == 'N m'
    assert arm.joints[0].friction == ('viscous', 'coulomb')
    assert arm.spec.gravity == (0.0, 0.0, -9.81)
    assert arm.gauge_names == ('hub',)


@pytest.mark.parametrize(('path', 'value', 'parts'), [
    ('jionts', [], ['jionts', 'is an unknown key; correct or remove it']),
    ('joints.0.limts', {}, ['joints[0].limts', 'is an unknown key; correct or remove it']),
    ('gauges.0.xs', 0.1, ['gauges[0].xs', 'is an unknown key; correct or remove it']),
    ('joints.0.name', '', ['joints[0].name', 'at least 1 character']),
    ('joints', [], ['joints', 'at least 1 item']),
    ('joints.0.effort', {'unit': 'mA'}, ['joints[0].effort.unit', "'A', 'N m' or 'N'", "'mA'"]),
    ('joints.0.effort', {'unit': 'N m', 'torque_constant': 1.0},
     ['joints[0].effort', 'torque_constant needs unit: A, but unit is N m']),
    ('joints.0.effort', {'unit': 'A', 'torque_constant': -1.0},
     ['joints[0].effort.torque_constant', 'above 0', '-1.0']),
    ('joints.0.type', 'spherical', ['joints[0].type', "'revolute', 'continuous' or 'prismatic'"]),
    ('joints.0.friction', ['viscous', 'viscous'],
     ['joints[0].friction', 'has an entry twice; list each once']),
    ('joints.0.friction', ['dry'], ['joints[0].friction[0]', "'viscous'", "'dry'"]),
    ('joints.0.limits', {'lower': 1.0, 'upper': 0.5},
     ['joints[0].limits', 'lower 1.0 is not below upper 0.5']),
    ('joints.0.limits', {'velocity': 0.0}, ['joints[0].limits.velocity', 'above 0']),
    ('joints.0.hold', float('nan'), ['joints[0].hold', 'finite number', 'nan']),
    ('joints.1.name', 'one', ["arm.yaml: joint 'one' has two entries"]),
    ('gravity', [0.0, -9.81], ['gravity[2]', 'is missing; add it']),
    ('gravity', [0.0, 0.0, float('inf')], ['gravity[2]', 'finite number', 'inf']),
    ('gravity', [0.0, 0.0, -1e300], ['gravity[2]', 'at least', '-1e+300']),
    ('active_joints', ['three'],
     ["active joint 'three' is not a joint; use one of one, two"]),
    ('active_joints', ['two', 'two'], ["active joint 'two' has two entries"]),
    ('active_joints', [], ['active_joints is empty', 'name at least one joint']),
    ('gauges.0.joint', 'three',
     ["gauge 'hub' names the joint 'three'", 'not among the joints one, two']),
    ('gauges.0.distance', -0.1, ['gauges[0].distance', 'at least 0', '-0.1']),
    ('gauges.0.unit', 'kg', ['gauges[0].unit', "'um/m'", "'kg'"]),
    ('gauges.0.axis', [0.0, 0.0, 0.0], ['gauges[0].axis', 'length 0', 'give x, y, z']),
    ('gauges.0.direction', 'w', ['gauges[0].direction', "'x', 'y' or 'z'", "'w'"]),
    ('kinematics', {}, ['kinematics', 'give either urdf: FILE or dh:']),
    ('kinematics', {'urdf': 'a.urdf', 'dh': []}, ['kinematics', 'give either urdf: FILE or dh:']),
    ('kinematics', {'dh': [[0.0, 0.0, 0.0, 0.0]]},
     ['1 D-H rows for 2 joints', 'give one row for each joint']),
    ('kinematics', {'dh': 3 * [[0.0, 0.0, 0.0, 0.0]]},
     ['3 D-H rows for 2 joints', 'give one row for each joint']),
    ('kinematics', {'dh': 4 * [[0.0, 0.0, 0.0, 0.0]], 'convention': 'modified'},
     ['4 D-H rows for 2 joints', 'at most one more, for a flange']),
    ('kinematics', {'dh': 2 * [[0.0, 0.0, 0.0, 0.0]], 'convention': 'craig'},
     ['kinematics.convention', "'standard' or 'modified'", "'craig'"]),
    ('kinematics', {'urdf': 'a.urdf', 'convention': 'modified'},
     ['kinematics', 'remove it, or give dh, not urdf']),
    ('kinematics.dh.0', [0.0, 0.0, 0.0], ['kinematics.dh[0][3]', 'is missing; add it']),
    ('kinematics', {'urdf': 'nowhere.urdf'}, ['nowhere.urdf', 'check kinematics.urdf']),
    # positive, and no moment about an axis is too large; the principal ones are 1.9, 1 and 0.1
    ('payload', {'mass': 1.0, 'inertia': [1.0, 1.0, 1.0, 0.9, 0.0, 0.0]},
     ['payload', 'no rigid body has the principal moments of inertia']),
])
def test_mistakes(path: str, value: Any, parts: list[str]) -> None:
    """Each mistake is refused with the key, what was found and what was expected."""
    if path == 'kinematics' and value.get('urdf') == 'nowhere.urdf':
        with pytest.raises(ArmError) as caught:  # here the file that is wrong is the URDF
            arm_from_dict(changed(path, value), base=Path(), source='arm.yaml')
        message = str(caught.value)
    else:
        message = refusal(changed(path, value))
    for part in parts:
        assert part in message


@pytest.mark.parametrize('content', [None, [], 'text', 3])
def test_no_mapping(content: Any) -> None:
    """A file that holds something else than keys is refused."""
    assert 'expected a YAML mapping with name, kinematics and joints' in refusal(content)


def test_several_mistakes_at_once() -> None:
    """All mistakes stand in one message, so that one run finds them all."""
    content = changed('gauges.0.distance', 'far')
    del content['name']
    message = refusal(content)
    assert 'name is missing; add it' in message
    assert 'gauges[0].distance must be a valid number' in message
    assert "found 'far'" in message


def test_unit_against_joint_type() -> None:
    """A force at a revolute joint and a torque at a prismatic one are refused."""
    message = refusal(changed('joints.0.effort', {'unit': 'N'}))
    assert "joint 'one' is revolute, but its effort.unit is 'N'; give 'N m' or A" in message
    message = refusal(changed('joints.0.type', 'prismatic'))
    assert "joint 'one' is prismatic, but its effort.unit is 'N m'; give 'N' or A" in message


def test_gauge_behind_prismatic_joint() -> None:
    """A gauge after a slider needs an axis: nothing bends about the direction of travel."""
    content = changed('joints.1', {'name': 'two', 'type': 'prismatic', 'effort': {'unit': 'A'}})
    assert "gauge 'hub' is after the prismatic joint 'two'" in refusal(content)
    content['gauges'][0]['axis'] = 'x'
    assert arm_from_dict(content, base=Path(), source='arm.yaml').gauge_names == ('hub',)


@pytest.mark.parametrize(('text', 'parts'), [
    ('name: [unclosed', ['arm.yaml: no valid YAML in line']),
    ('name: !!python/object:os.system {}', ['arm.yaml: no valid YAML in line 1']),
    ('[' * 5000, ['arm.yaml: ']),
    ('\x00', ['arm.yaml: no valid YAML']),
    ('', ['arm.yaml: expected a YAML mapping']),
])
def test_files_that_are_no_yaml(tmp_path: Path, text: str, parts: list[str]) -> None:
    """A file that is no plain YAML is refused with its name and line."""
    file = tmp_path / 'arm.yaml'
    file.write_text(text, encoding='utf-8')
    with pytest.raises(ArmError) as caught:
        load_arm(file)
    for part in parts:
        assert part in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """A missing file, a directory, binary content and a huge file are refused."""
    for path in (tmp_path / 'none.yaml', tmp_path):
        with pytest.raises(ArmError, match='cannot be read .*check the path'):
            load_arm(path)
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe\xfa')
    with pytest.raises(ArmError, match='binary.yaml: the arm description cannot be read'):
        load_arm(tmp_path / 'binary.yaml')
    (tmp_path / 'big.yaml').write_bytes(b'#' * 2_000_001)
    with pytest.raises(ArmError, match='big.yaml: .*larger than 2000000 bytes'):
        load_arm(tmp_path / 'big.yaml')


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(['name', 'joint', 'dh', 'unit', 'x']), inner, max_size=3),
    max_leaves=8)
PATHS = ['name', 'kinematics', 'kinematics.dh', 'kinematics.dh.0', 'joints', 'joints.0',
         'joints.1.effort', 'gauges', 'gauges.0', 'gauges.0.axis', 'active_joints', 'motors',
         'sensors', 'damper', 'gravity']


@given(path=st.sampled_from(PATHS), value=VALUES)
def test_any_value_is_accepted_or_refused(path: str, value: Any) -> None:
    """Whatever stands at a key, the answer is an arm or one line of this package."""
    try:
        arm_from_dict(changed(path, value), base=Path('/nonexistent'), source='arm.yaml')
    except TudorError as err:
        assert str(err)


def test_keys_that_are_missing_stand_together() -> None:
    """One sentence names them, with one remedy."""
    content = {key: value for key, value in ARM.items() if key not in ('name', 'kinematics')}
    assert 'name, kinematics are missing; add them' in refusal(content)
