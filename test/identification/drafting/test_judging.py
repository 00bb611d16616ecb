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

"""What `tudor init` concludes from readings, limits, names and tables of rows."""

from __future__ import annotations

import math
from pathlib import Path

from draft_making import JOINTS, motion, torques, urdf, write
import pytest

from tudor_dynamics.errors import ArmError
from tudor_dynamics.identification.drafting.draft import chain_of_table, draft_of, read_table
from tudor_dynamics.identification.drafting.judging import effort_unit, strain_unit


@pytest.mark.parametrize(('low', 'high', 'unit'), [
    (-120.0, 300.0, 'um/m'), (-1e-4, 3e-4, 'm/m'), (-1.0, 1.0, '?'), (2.0, 2.0, '?')])
def test_the_unit_of_a_gauge_by_its_range(low: float, high: float, unit: str) -> None:
    """Strains of an arm are some hundred um/m; what lies between may be the unit of a bridge."""
    judged = strain_unit(low, high)
    assert judged.value == unit and f'readings span {high - low:.3g}' in judged.reason


@pytest.mark.parametrize(('slopes', 'name', 'unit', 'reason'), [
    ([1.02, 0.97], '/joint_states', 'N m', 'times the gravity moments of the URDF'),
    ([1.9], '/joint_states', 'N m', 'times the gravity moments'),
    ([1.02], '/motor_currents', 'A', 'currents'),
    ([-0.09, 0.12], '/joint_states', 'A', '0.105 times the gravity moments of the URDF: currents'),
    ([980.0], '/joint_states', '?', 'N m in thousandths? publish A or N m'),
    ([30.0], '/joint_states', '?', 'neither A nor N m'),
    ([0.001], '/joint_states', '?', 'neither A nor N m')])
def test_the_unit_of_efforts_by_what_the_arm_carries(
    slopes: list[float], name: str, unit: str, reason: str,
) -> None:
    """The median of the joints that carry something, whatever the sign."""
    judged = effort_unit(slopes, [10.0], [60.0], name, 'N m')
    assert judged.value == unit and reason in judged.reason


@pytest.mark.parametrize(('peaks', 'limits', 'name', 'unit', 'reason'), [
    ([3.0], [0.0], '/drive/current', 'A', 'by the name /drive/current'),
    ([150.0, 1.0], [0.0, 0.0], '/efforts', 'N m', 'more than drives take in ampere'),
    ([30.0, 5.0], [60.0, 60.0], '/efforts', 'N m', '0.083 to 0.5 of the limits'),
    ([30.0, 0.1], [60.0, 60.0], '/efforts', '?', 'between 0.0017 and 0.5 of the limits'),
    ([30.0], [math.inf], '/efforts', '?', 'No masses or limits of a URDF to judge by')])
def test_the_unit_of_efforts_without_masses(
    peaks: list[float], limits: list[float], name: str, unit: str, reason: str,
) -> None:
    """The name of the topic, the size, or the limits of the URDF; else it is asked for."""
    judged = effort_unit([], peaks, limits, name, 'N m')
    assert judged.value == unit and reason in judged.reason


def test_rows_in_the_form_of_a_description(tmp_path: Path) -> None:
    """YAML may be the rows, or a description with them; modified rows may end in a flange."""
    file = tmp_path / 'rows.yaml'
    rows = '[[0, 0, 0.3, 0], [0.4, pi/2, 0, 0], [0.3, 0, 0, 0]]'
    for text in (rows, f'dh: {rows}', f'kinematics: {{dh: {rows}}}'):
        file.write_text(text)
        found, convention = read_table(file)
        assert [row.values[0] for row in found] == [0.0, 0.4, 0.3] and convention == 'standard'
        assert found[1].values[1] == pytest.approx(math.pi / 2)
    file.write_text(f'kinematics: {{dh: {rows}, convention: modified}}')
    chain = chain_of_table(file, ('a', 'b'))
    assert chain.joints == ('a', 'b') and chain.content['convention'] == 'modified'
    assert 'taken as those of a, b' in chain.note


@pytest.mark.parametrize(('name', 'text', 'part'), [
    ('rows.yaml', 'convention: other\ndh: []', "convention is 'other'; give"),
    ('rows.yaml', '7', 'no D-H rows'), ('rows.yaml', 'dh: [5]', 'row 1'),
    ('rows.yaml', 'dh: [[0, 0', 'rows.yaml'),
    ('rows.txt', '0 0 0 2*pi/3\n0 0 0 -4*pi', 'line 2: an angle of -12.5664 looks like degrees'),
    ('rows.txt', 'a b 0 0 0 0', 'line 1'), ('rows.txt', '0 0 0 0\n' * 102, '102 rows')])
def test_rows_that_are_none(tmp_path: Path, name: str, text: str, part: str) -> None:
    """The file, and the line or row that is wrong, stand in the message."""
    (tmp_path / name).write_text(text)
    with pytest.raises(ArmError, match=part):
        read_table(tmp_path / name)
    with pytest.raises(ArmError, match='cannot be read'):
        read_table(tmp_path / 'nothing.txt')


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_a_gauge_before_a_joint_that_never_moved(tmp_path: Path) -> None:
    """It may as well sit after that joint: nothing is guessed."""
    (tmp_path / 'finger.urdf').write_text(urdf(finger=True))
    tau = torques(motion()[1])
    bag = write(tmp_path / 'bag', effort=None, names=(*JOINTS, 'finger'),
                strains={'outer': 20.0 * tau[:, 1]})
    draft = draft_of([str(bag)], urdf=tmp_path / 'finger.urdf', out=tmp_path / 'arm.yaml')
    assert draft.content['gauges'][0]['joint'] == '?'
    assert 'or sits after finger, which never moved?' in draft.remarks['gauges.outer']


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_a_gauge_that_follows_nothing(tmp_path: Path) -> None:
    """A reading of another machine is no evidence of a place."""
    (tmp_path / 'pair.urdf').write_text(urdf())
    stamp, _ = motion()
    seconds = (stamp - stamp[0]) * 1e-9
    bag = write(tmp_path / 'bag', effort=None, strains={'other': 90.0 * (seconds * 7.7 % 1.0)})
    draft = draft_of([str(bag)], urdf=tmp_path / 'pair.urdf', out=tmp_path / 'arm.yaml')
    assert draft.content['gauges'][0]['joint'] == '?'
    assert 'follows the moment of no joint' in draft.remarks['gauges.other']
