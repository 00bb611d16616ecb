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

"""Efforts and the masses of a URDF: another unit, gravity turned round, limits, held joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from draft_making import JOINTS, motion, torques, urdf
import pytest
from sample_arms import recording_of

from tudor_dynamics.arm.description import Arm, arm_from_dict
from tudor_dynamics.bags.recording import Oddities, Recording
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.typing import FloatArray


def _arm(folder: Path, *, unit: str = 'N m', effort: float = 60.0, masses: bool = True,
         **more: Any) -> Arm:
    """Describe the arm of `draft_making`, its torques in a unit."""
    file = folder / 'pair.urdf'
    file.write_text(urdf(effort=effort, masses=masses, finger=True))
    joints = [{'name': name, 'friction': ['viscous', 'coulomb'],
               'effort': {'topic': 'joint_states', 'unit': unit}} for name in JOINTS]
    return arm_from_dict({'name': 'pair', 'kinematics': {'urdf': file.name}, 'joints': joints,
                          'active_joints': list(JOINTS), **more}, base=folder,
                         source=str(folder / 'arm.yaml'))


def _recording(effort: FloatArray | None = None, *, oddities: Oddities | None = None) -> Recording:
    _, q = motion(seconds=24.0)
    recording = recording_of(q, 100.0, effort=torques(q) if effort is None else effort, path='run')
    return recording if oddities is None else type(recording)(
        **{**vars(recording), 'oddities': oddities})


def _torques() -> FloatArray:
    return torques(motion(seconds=24.0)[1])


def _one(arm: Arm, effort: FloatArray) -> Finding:
    finding, = examine(arm, _recording(effort)).findings
    return finding


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_torques_of_the_masses_are_no_fault(tmp_path: Path) -> None:
    """Masses that are a half too light are no other unit."""
    assert examine(_arm(tmp_path), _recording()).findings == ()
    assert examine(_arm(tmp_path), _recording(1.5 * _torques())).findings == ()


@pytest.mark.filterwarnings('ignore:.*1.5708')
@pytest.mark.parametrize(('scale', 'size', 'words'), [
    (1e-3, 1e-3, 'they look like kN m, not N m'), (0.1, 0.1, 'they look like currents in A')])
def test_all_efforts_in_another_unit(
    tmp_path: Path, scale: float, size: float, words: str,
) -> None:
    """What the masses of the URDF need says it, where no joint differs from the others."""
    finding = _one(_arm(tmp_path), scale * _torques())
    assert (finding.kind, finding.channels) == ('effort_unit', JOINTS)
    assert finding.size == pytest.approx(size, rel=0.1) and words in finding.what
    assert finding.measure == 'ratio of measured efforts to those of the masses in the URDF'
    assert finding.otherwise == pytest.approx(1.0, rel=0.1)


@pytest.mark.filterwarnings('ignore:.*1.5708')
@pytest.mark.parametrize(('factors', 'masses', 'channels'), [
    ([1e3, 1e3], True, JOINTS), ([1.0, 1e3], False, JOINTS[1:])])
def test_more_than_the_joints_can_give(
    tmp_path: Path, factors: list[float], masses: bool, channels: tuple[str, ...],
) -> None:
    """Ten times the limit of the URDF is a thousandth of the unit, of all joints or of one."""
    finding = _one(_arm(tmp_path, masses=masses), _torques() * factors)
    assert (finding.kind, finding.channels, finding.size) == ('effort_unit', channels, 1e3)
    assert finding.measure == 'largest effort' and 'it looks like mN m' in finding.what


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_without_a_limit_size_alone_says_it(tmp_path: Path) -> None:
    """No joint of an arm has 3 kN m; 200 N m are no fault where no limit is known."""
    arm = _arm(tmp_path, effort=0.0, masses=False)
    assert examine(arm, _recording(3.0 * _torques())).findings == ()
    assert _one(arm, 1e3 * _torques()).size == 1e3


@pytest.mark.filterwarnings('ignore:.*1.5708')
@pytest.mark.parametrize(('unit', 'scale'), [('N m', 1.0), ('A', 0.1)])
def test_gravity_turned_round(tmp_path: Path, unit: str, scale: float) -> None:
    """Centres of mass that carry one way accelerate another way: that is no arm."""
    finding = _one(_arm(tmp_path, unit=unit, gravity=[0.0, 0.0, 9.81]), scale * _torques())
    assert (finding.kind, finding.size, finding.unit) == ('gravity_axis', 180.0, 'deg')
    assert 'the data fit gravity along -z' in finding.what
    assert finding.remedy.startswith('set gravity: [0.0, 0.0, -9.81] in')


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_gravity_turned_round_in_slow_motion(tmp_path: Path) -> None:
    """Nothing accelerates, so that no residual shows it; the masses of the URDF do."""
    _, q = motion(seconds=24.0)
    slow = recording_of(q, 10.0, effort=torques(q, rate=10.0), path='run')
    finding, = examine(_arm(tmp_path, gravity=[0.0, 0.0, 9.81]), slow).findings
    assert (finding.kind, finding.size) == ('gravity_axis', 180.0)
    assert finding.remedy == 'set gravity: [0.0, 0.0, -9.81] in the arm description'
    assert finding.measure == 'ratio of measured efforts to those of the masses in the URDF'
    assert finding.now == pytest.approx(-1.0, rel=0.1)


@pytest.mark.filterwarnings('ignore:.*1.5708')
@pytest.mark.parametrize(('span', 'named'), [(0.3, True), (0.01, False)])
def test_a_held_joint_that_moves(tmp_path: Path, span: float, named: bool) -> None:
    """The description takes the finger as held; how far it goes is said in its unit."""
    recording = _recording(oddities=Oddities(others={'finger': span, 'nobody': 1.0}))
    findings = examine(_arm(tmp_path), recording).findings
    assert [item.kind for item in findings] == ['joint_not_listed'] * named
    for item in findings:
        assert (item.channels, item.size, item.unit) == (('finger',), span, 'm')


@pytest.mark.filterwarnings('ignore:.*1.5708')
def test_lengths_of_a_urdf_in_millimetres(tmp_path: Path) -> None:
    """The reach of the arm says it; what to do is scaling the file, which nobody does here."""
    arm = _arm(tmp_path)
    text = (tmp_path / 'pair.urdf').read_text().replace('xyz="0.4 0 0"', 'xyz="400 0 0"')
    (tmp_path / 'long.urdf').write_text(text)
    content = arm.spec.model_dump(mode='json') | {'kinematics': {'urdf': 'long.urdf'}}
    long = arm_from_dict(content, base=tmp_path, source=arm.source)
    finding = examine(long, _recording()).findings[0]
    assert (finding.kind, finding.remedy) == (
        'dh_in_millimetres', 'scale the origins in the URDF by 0.001')
    assert finding.size == pytest.approx(800.0) and finding.bag == 'run'
