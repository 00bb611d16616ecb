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

"""Rounded angles become exact, and open question marks are refused by name."""

from __future__ import annotations

import math
from pathlib import Path
import warnings

from hypothesis import given, strategies as st
import pytest

from tudor_dynamics.arm.description import arm_from_dict, load_arm, open_values, spelled
from tudor_dynamics.arm.kinematics import exact, ExactAngles, NEAR, STEP
from tudor_dynamics.errors import ArmError, TudorWarning
from tudor_dynamics.models.regressor import base_sets, EffortRegressor

ROUNDED = """
name: pair
kinematics: {dh: [[0, 1.5708, 0.3, 0], [0.4, 0, 0, 0.7853], [0, 1.5708, 0, 0],
                  [0, -1.5708, 0.3, 0], [0, 1.5708, 0, 0], [0, 0, 0.1, 0]]}
joints: [{name: a}, {name: b}, {name: c}, {name: d}, {name: e}, {name: f}]
"""


@given(st.integers(-8, 8), st.floats(-0.5, 0.5))
def test_what_is_near_is_exact(number: int, off: float) -> None:
    """Within a milliradian the multiple, elsewhere the angle; doing it twice changes nothing."""
    angle = number * STEP + off
    found = exact(angle)
    assert exact(found) == found
    if abs(off) < 0.99 * NEAR:
        assert found == number * STEP
    elif abs(off) > 1.01 * NEAR and abs(off) < STEP - 1.01 * NEAR:
        assert found == angle


def test_notes_say_what_was_changed() -> None:
    """Printed digits alone are not worth a word; many angles do not make a long note."""
    snapped = ExactAngles()
    assert snapped.take(1.57079632679, 'a') == math.pi / 2 and not snapped.note()
    for number in range(5):
        snapped.take(1.5708, f'joint {number}')
    assert 'joint 0 1.5708 becomes 1.570796, ' in snapped.note()
    assert ' and 2 more' in snapped.note()


def test_rounded_tables_are_those_of_the_drawing(tmp_path: Path) -> None:
    """A table with 1.5708 has the base parameters of the exact one, and a warning says so."""
    (tmp_path / 'arm.yaml').write_text(ROUNDED)
    with pytest.warns(TudorWarning, match=r'.*: alpha of row 1 1.5708 becomes 1.5707'):
        arm = load_arm(tmp_path / 'arm.yaml')
    exactly = ROUNDED.replace('1.5708', repr(math.pi / 2)).replace('0.7853', repr(math.pi / 4))
    (tmp_path / 'arm.yaml').write_text(exactly)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        other = load_arm(tmp_path / 'arm.yaml')
    assert arm.digest == other.digest and arm.notes and not other.notes
    found, = base_sets(EffortRegressor(arm), 6)
    same, = base_sets(EffortRegressor(other), 6)
    assert found.names == same.names


URDF = """
<robot name="pair"><link name="base"/><link name="l1"/><link name="l2"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="j2" type="revolute"><origin xyz="0 0 0.3" rpy="ANGLE 0 0.3"/><parent link="l1"/>
  <child link="l2"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>
"""


def test_rounded_urdf(tmp_path: Path) -> None:
    """The same for the angles between the joints of a URDF."""
    (tmp_path / 'arm.yaml').write_text(
        'name: t\nkinematics: {urdf: arm.urdf}\njoints: [{name: j1}, {name: j2}]\n')
    (tmp_path / 'arm.urdf').write_text(URDF.replace('ANGLE', '-1.5708'))
    with pytest.warns(TudorWarning, match='j2 rpy -1.5708 becomes -1.570796'):
        arm = load_arm(tmp_path / 'arm.yaml')
    (tmp_path / 'arm.urdf').write_text(URDF.replace('ANGLE', repr(-math.pi / 2)))
    assert load_arm(tmp_path / 'arm.yaml').digest == arm.digest
    (tmp_path / 'arm.urdf').write_text(URDF.replace('ANGLE', '-1.5608'))
    assert load_arm(tmp_path / 'arm.yaml').digest != arm.digest


OPEN = {'name': 'pair', 'kinematics': {'dh': '?'},
        'joints': [{'name': 'a', 'effort': {'unit': ' ? '}}, {'name': '?'}],
        'gauges': [{'name': 'hub', 'joint': 'a', 'distance': '?'}]}


def test_open_values_are_named() -> None:
    """Each by its keys, entries of lists by their names where they have one."""
    names = [spelled(OPEN, path) for path in open_values(OPEN)]
    assert names == ['kinematics.dh', 'joints[a].effort.unit', 'joints[1].name',
                     'gauges[hub].distance']
    with pytest.raises(ArmError) as caught:
        arm_from_dict(OPEN, base=Path(), source='my.yaml')
    text = str(caught.value)
    assert text.startswith("my.yaml: still '?': kinematics.dh, joints[a].effort.unit, ")
    assert "replace each '?' by a value" in text


def test_question_marks_within_text_are_text() -> None:
    """Only a value that is nothing else is open."""
    assert not list(open_values({'name': 'what?', 'list': [1, None, '??']}))


@pytest.mark.parametrize('unit', ['Nm', 'N*m', 'N·m', 'N m'])
def test_one_unit_of_many_spellings(unit: str) -> None:
    """All of them are the same arm."""
    content = {'name': 'one', 'kinematics': {'dh': [[0.4, 0, 0, 0]]},
               'joints': [{'name': 'a', 'effort': {'unit': unit}}],
               'gauges': [{'name': 'g', 'joint': 'a', 'distance': 0.1, 'unit': unit}]}
    arm = arm_from_dict(content, base=Path(), source='test')
    assert arm.joints[0].effort.unit == arm.gauges[0].unit == 'N m'
