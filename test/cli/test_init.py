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

"""``tudor init``: what it writes, what it leaves open, what it refuses, what it asks."""

from __future__ import annotations

from pathlib import Path
import re
import tempfile

from carrier_making import (
    ARRAY, array, DYNAMIC, dynamic, Topic, topic_of, write as write_topics)
from draft_making import JOINTS, motion, torques, urdf, write
from hypothesis import example, given, settings, strategies as st
import numpy as np
from printed import unwrapped
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import ArmError
from tudor_dynamics.identification.drafting.draft import draft_of, text_of
import yaml


@pytest.fixture(scope='module')
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write bags of one motion in several units, and URDFs."""
    folder = tmp_path_factory.mktemp('init')
    (folder / 'pair.urdf').write_text(urdf())
    (folder / 'finger.urdf').write_text(urdf(finger=True))
    (folder / 'bare.urdf').write_text(urdf(masses=False))
    _, q = motion()
    tau = torques(q)
    write(folder / 'torque', effort=tau)
    write(folder / 'ampere', effort=tau / np.array([9.0, 7.0]))
    write(folder / 'milli', effort=1e3 * tau)
    write(folder / 'named', effort=tau / 9.0, topic='/motor_currents')
    write(folder / 'still', effort=np.column_stack([tau, np.zeros(len(tau))]),
          names=(*JOINTS, 'finger'))
    write(folder / 'gauges', effort=tau, strains={
        'outer': 20 * tau[:, 1] + 3.0, 'inner': 9 * tau[:, 0] - 50.0})
    return folder


def run(place: Path, *words: str, code: int = 0) -> dict[str, object]:
    """Run the command in a folder and read what it wrote."""
    out = place / 'arm.yaml'
    paths = [word if word.startswith('--') else str(place / word) for word in words]
    assert main(['init', *paths, '--out', str(out), '--overwrite']) == code
    return dict(yaml.safe_load(out.read_text()))


@pytest.mark.parametrize(('bag', 'unit', 'evidence'), [
    ('torque', 'N m', r'1(\.0\d)? times the gravity moments'),
    ('ampere', 'A', r'0\.1\d* times .* currents'), ('named', 'A', r'0\.1\d* times')])
def test_units_show_in_what_the_arm_carries(
    place: Path, capsys: pytest.CaptureFixture[str], bag: str, unit: str, evidence: str,
) -> None:
    """Efforts are compared with the gravity moments of the URDF; the file can be used as it is."""
    content = run(place, bag, '--urdf', 'pair.urdf')
    assert [joint['effort']['unit'] for joint in content['joints']] == [unit] * 2
    said = unwrapped(capsys.readouterr().out)
    assert re.search(evidence, said) and 'next: tudor fit ' in said
    assert '1.5708 becomes 1.570796' in said  # rounded in the URDF
    with pytest.warns(match='1.5708'):
        arm = load_arm(place / 'arm.yaml')
    assert arm.active_joints == JOINTS and arm.name == 'pair'
    text = (place / 'arm.yaml').read_text()
    assert 'friction:' not in yaml.safe_load(text) and '#   friction: ' in text
    assert not any('friction' in joint for joint in content['joints'])


def test_thousandths_are_not_taken_for_anything(
    place: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Efforts in mN m are neither of the units; the file is refused by the name of the key."""
    content = run(place, 'milli', '--urdf', 'pair.urdf')
    assert content['joints'][0]['effort']['unit'] == '?'
    assert 'N m in thousandths' in unwrapped(capsys.readouterr().out)
    with pytest.raises(ArmError, match=r"still '\?': joints\[shoulder\].effort.unit, joints\[el"):
        load_arm(place / 'arm.yaml')
    assert main(['fit', str(place / 'milli'), '--arm', str(place / 'arm.yaml'), '--out',
                 str(place / 'model')]) == 2
    assert 'joints[elbow].effort.unit' in capsys.readouterr().err


def test_without_masses_the_limits_of_the_urdf_judge(place: Path) -> None:
    """Torques are below the limits, but not far."""
    assert run(place, 'torque', '--urdf', 'bare.urdf')['joints'][0]['effort']['unit'] == 'N m'
    assert run(place, 'ampere', '--urdf', 'bare.urdf')['joints'][0]['effort']['unit'] in (
        '?', 'N m')


def test_what_stiction_holds_says_nothing_of_gravity(place: Path) -> None:
    """A joint that does not move, with an effort that no gravity explains."""
    _, q = motion()
    held = 3.0 + np.random.default_rng(1).normal(0.0, 0.01, len(q))
    if not (place / 'held').exists():
        write(place / 'held', effort=np.column_stack([torques(q), held]),
              names=(*JOINTS, 'finger'))
    content = run(place, 'held', '--urdf', 'finger.urdf')
    assert content['gravity'] == [0.0, 0.0, -9.81]
    assert content['joints'][0]['effort']['unit'] == 'N m'


def test_all_joints_of_the_urdf_are_listed(place: Path) -> None:
    """One that does not move, or is not in the bag, is held where it is."""
    for bag in ('still', 'torque'):
        content = run(place, bag, '--urdf', 'finger.urdf')
        assert [joint['name'] for joint in content['joints']] == [*JOINTS, 'finger']
        assert content['active_joints'] == list(JOINTS)
    with pytest.warns(match='1.5708'):
        assert load_arm(place / 'arm.yaml').held_joints == {'finger': 0.0}


def test_gauges_sit_behind_the_joint_whose_moment_they_follow(
    place: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Topic, unit and joint are told by the readings; the distance is not."""
    content = run(place, 'gauges', '--urdf', 'pair.urdf')
    assert content['gauges'] == [
        {'name': 'outer', 'joint': 'elbow', 'distance': '?', 'topic': 'link_strains',
         'unit': 'um/m'},
        {'name': 'inner', 'joint': 'shoulder', 'distance': '?', 'topic': 'link_strains',
         'unit': 'um/m'}]
    assert 'gauges[outer].distance, gauges[inner].distance' in capsys.readouterr().out


def test_arrays_and_interfaces(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An interface is found by its name; of an array it is not known which value is whose."""
    stamp, q = motion()
    tau = torques(q)
    states = topic_of(joint_signals('/joint_states', stamp, JOINTS, q))
    if not (place / 'carriers').exists():
        interfaces = [dynamic(int(s), {name: {'current': row[i] / 8, 'temperature': 40.0}
                                       for i, name in enumerate(JOINTS)})
                      for s, row in zip(stamp, tau, strict=True)]
        write_topics(place / 'carriers', states,
                     Topic('/dynamic_joint_states', DYNAMIC, states.log_time, interfaces),
                     Topic('/strain_bridge', ARRAY, states.log_time,
                           [array(9 * row) for row in tau]))
        write_topics(place / 'array', states, Topic('/drive/torques', ARRAY, states.log_time,
                                                    [array(row) for row in tau]))
    content = run(place, 'carriers', '--urdf', 'pair.urdf')
    assert content['joints'][1]['effort'] == {
        'topic': 'dynamic_joint_states', 'interface': 'current', 'unit': 'A'}
    assert [(gauge['name'], gauge['joint'], gauge['index']) for gauge in content['gauges']] == [
        ('strain_bridge_0', 'shoulder', 0), ('strain_bridge_1', 'elbow', 1)]
    content = run(place, 'array', '--urdf', 'pair.urdf')
    assert content['joints'][0]['effort'] == {
        'topic': '/drive/torques', 'index': '?', 'unit': '?'}
    assert 'joints[elbow].effort.index' in capsys.readouterr().out


def test_rows_in_a_file(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Text with names, or YAML without; pi is known, degrees are refused with their line."""
    (place / 'rows.txt').write_text(
        'joint a alpha d theta\nshoulder 0, pi/2, 0.3, 0\nelbow 0.4 0 0 -pi/4  # outer\n')
    content = run(place, 'named', '--dh', 'rows.txt')
    assert content['kinematics']['dh'][0] == [0.0, np.pi / 2, 0.3, 0.0]
    assert content['kinematics']['dh'][1][3] == -np.pi / 4
    assert load_arm(place / 'arm.yaml').joints[0].effort.topic == 'motor_currents'
    assert 'taken as those of' not in capsys.readouterr().out
    (place / 'rows.yaml').write_text('dh: [[0.0, 1.5708, 0.3, 0.0], [0.4, 0, 0, 0]]\n')
    run(place, 'named', '--dh', 'rows.yaml')
    assert 'taken as those of shoulder, elbow' in unwrapped(capsys.readouterr().out)
    for text, part in (('elbow 0 90 0 0', 'line 1: an angle of 90 looks like degrees'),
                       ('elbow 0 0 0', 'line 1: '), ('', '0 rows, not 1 to'),
                       ('a 0 0 0 0\nb 0 0 0 0', "the 2 rows are of 'a', 'b', but"),
                       ('0 0 nan 0', 'line 1: ')):
        (place / 'wrong.txt').write_text(text)
        assert main(['init', str(place / 'named'), '--dh', str(place / 'wrong.txt'), '--out',
                     str(place / 'wrong.yaml')]) == 2
        err = capsys.readouterr().err
        assert part in err and len(err.splitlines()) == 1
    assert not (place / 'wrong.yaml').exists()


def test_a_prismatic_joint_and_a_large_effort(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """More than drives take in ampere is a force, where the rows say that the joint slides."""
    stamp, q = motion()
    write_bag(tmp_path / 'bag', [joint_signals('/joint_states', stamp, ['axis'], q[:, :1],
                                               effort=200 * q[:, :1])])
    (tmp_path / 'rows').write_text('axis 0 0 0 0 prismatic')
    content = run(tmp_path, 'bag', '--dh', 'rows')
    joint, = content['joints']
    assert {*joint.pop('limits')} == {'lower', 'upper', 'velocity', 'acceleration'}
    assert joint == {'name': 'axis', 'type': 'prismatic',
                     'effort': {'topic': 'joint_states', 'unit': 'N'}}
    assert load_arm(tmp_path / 'arm.yaml').is_prismatic('axis')


def test_without_kinematics_they_are_left_open(place: Path) -> None:
    """Joints and topics are there, rows are not."""
    content = run(place, 'named')
    assert content['kinematics'] == {'dh': '?'} and len(content['joints']) == 2


LYING = urdf().replace('rpy="1.5708', 'rpy="0')
"""The same arm with its axes along z of the base."""


@pytest.mark.parametrize('gravity', [
    (0.0, 9.81, 0.0), (0.0, -9.81, 0.0), (-9.81, 0.0, 0.0), (0.0, 0.0, -9.81)])
def test_down_is_where_the_efforts_say(
    place: Path, capsys: pytest.CaptureFixture[str], gravity: tuple[float, float, float],
) -> None:
    """A base on a wall: masses of the URDF say which axis it is, and which way."""
    bag = place / f'leaning_{gravity}'
    (place / 'lying.urdf').write_text(LYING)
    _, q = motion()
    write(bag, effort=torques(q, gravity=gravity, text=LYING))
    assert run(place, bag.name, '--urdf', 'lying.urdf')['gravity'] == list(gravity)
    said = ' '.join(capsys.readouterr().out.split())  # where lines end depends on the path
    assert ('gravity is not along -z of the base: ' in said) == (gravity[2] == 0.0)
    assert 'make sure' not in said
    if gravity[2] == 0.0:
        assert '[N m] on joint_states' in said
        (place / 'rows').write_text('shoulder 0.4 0 0 0\nelbow 0.4 0 0 0')
        found = run(place, bag.name, '--dh', 'rows')['gravity']
        assert found == list(gravity) or 'make sure of axis and sign' in ' '.join(
            capsys.readouterr().out.split())


def test_positions_alone(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The arm is described, and it is said that this is not enough to learn from."""
    if not (place / 'alone').exists():
        write(place / 'alone', effort=None)
    assert len(run(place, 'alone', '--urdf', 'pair.urdf')['joints']) == 2
    assert 'neither efforts nor strains are in the bags' in capsys.readouterr().out


def test_nothing_is_written_over(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that is there stays, unless asked."""
    out = place / 'mine.yaml'
    out.write_text('mine')
    assert main(['init', str(place / 'torque'), '--out', str(out)]) == 2
    assert '--overwrite' in capsys.readouterr().err and out.read_text() == 'mine'


def test_a_urdf_of_another_arm(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line with both lists of joints."""
    (place / 'other.urdf').write_text(urdf().replace('"shoulder"', '"j1"').replace(
        '"elbow"', '"j2"'))
    assert main(['init', str(place / 'torque'), '--urdf', str(place / 'other.urdf'), '--out',
                 str(place / 'x.yaml')]) == 2
    err = capsys.readouterr().err
    assert 'j1, j2' in err and 'shoulder, elbow' in err and len(err.splitlines()) == 1


@settings(deadline=None, max_examples=25)
@example(['0', '\x85'])
@example(['?', 'null'])
@given(st.lists(st.text(min_size=1, max_size=12).filter(lambda text: '\0' not in text and (
    text.encode(errors='ignore').decode() == text)), min_size=2, max_size=2, unique=True))
def test_any_names_are_written_so_that_they_read_the_same(names: list[str]) -> None:
    """Names that YAML takes for something else, or that would end a line."""
    with tempfile.TemporaryDirectory() as folder:
        bag = write(Path(folder) / 'bag', effort=200 * motion()[1], names=names)
        draft = draft_of([str(bag)], out=Path(folder) / 'arm.yaml')
        assert [joint['name'] for joint in yaml.safe_load(text_of(draft))['joints']] == names


def test_answers_take_the_place_of_question_marks(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """On a terminal it asks, once for all joints of a topic; the end of the input ends that."""
    answers = iter(['mA', 'N*m', '0.05'])
    asked = []

    def say(text: str) -> str:
        asked.append(text)
        try:
            return next(answers)
        except StopIteration:
            raise EOFError from None
    for stream in ('stdin', 'stdout'):
        monkeypatch.setattr(f'sys.{stream}.isatty', lambda: True)
    monkeypatch.setattr('builtins.input', say)
    stamp_free = place / 'asked'
    if not stamp_free.exists():
        _, q = motion()
        tau = torques(q)
        write(stamp_free, effort=1e3 * tau, strains={'a': 9 * tau[:, 0], 'b': 9 * tau[:, 1]})
    content = run(place, 'asked', '--urdf', 'pair.urdf')
    assert [joint['effort']['unit'] for joint in content['joints']] == ['N m', 'N m']
    assert [gauge['distance'] for gauge in content['gauges']] == [0.05, '?']
    assert len(asked) == 4 and asked[0].startswith('joints[shoulder].effort.unit: unit (A, N m')
    assert 'one of A, N m, N' in capsys.readouterr().out
