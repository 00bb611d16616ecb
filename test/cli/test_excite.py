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

"""``tudor excite``, and the way on: record by the plan, fit beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from printed import unwrapped
import pytest
from robot_making import described_arm, JOINTS

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.trajectory import read_trajectory
from tudor_dynamics.cli.main import main


def excite(root: Path, out: Path, *more: str) -> int:
    """Plan a short motion of the reference arm."""
    return main(['excite', str(root / 'config' / 'tudor.yaml'), '--out', str(out), '--floor', '0',
                 '--seconds', '14', '--steps', '6', *more])


def test_plan_record_fit(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """The whole way: plan, play in simulation, fit, and what was promised beside what came."""
    arm = str(root / 'config' / 'tudor.yaml')
    assert excite(root, tmp_path / 'plan', '--noise', '0.05', '--noise-of', 'link2_hub=3') == 0
    text = capsys.readouterr().out
    said = unwrapped(text)
    assert 'capsules of 0.05 m' in said and 'coulomb+(joint2)' in said
    assert '\nplan:' in text  # on a line of its own
    assert sorted(p.name for p in (tmp_path / 'plan').iterdir()) == [
        'bag', 'motion.png', 'plan.json', 'trajectory.csv']
    head = json.loads((tmp_path / 'plan' / 'plan.json').read_text())
    assert head['noise']['effort'] == {'joint2': 0.05, 'joint3': 0.05}
    assert head['noise']['strain']['link2_hub'] == 3.0 and head['noise_stated']
    assert max(head['part_of_limits']['velocity'].values()) <= 1.0 + 1e-6

    assert main(['record', '--arm', arm, '--trajectory', str(tmp_path / 'plan'), '--stimuli', '1',
                 '--jobs', '1', '--out', str(tmp_path / 'bags')]) == 0
    bag = tmp_path / 'bags' / 'stimulus_01'
    recording = read_recording(bag, load_arm(root / 'config' / 'tudor.yaml'))
    planned = read_trajectory(tmp_path / 'plan' / 'trajectory.csv')
    off = recording.q[:1400] - planned.q[:1400]
    assert np.sqrt(np.mean(off**2)) < 0.1 * planned.q.std()  # it follows, and the damper adds
    capsys.readouterr()

    assert main(['fit', str(bag), '--arm', arm, '--plan', str(tmp_path / 'plan'), '--out',
                 str(tmp_path / 'model'), '--exit-zero', '--json']) == 0
    found = json.loads(capsys.readouterr().out)['plan']
    page = (tmp_path / 'model' / 'report.html').read_text()
    assert 'id="planned"' in page and 'Reached over promised' in page
    assert found['runs'] == pytest.approx(1.0, abs=0.05) and found['noise_stated']
    assert found['median_over_by_noise'] == pytest.approx(1.0, abs=0.3)
    assert {item['output'] for item in found['parameters']} == {'effort', 'strain'}

    # that model says noise and friction of the next plan
    assert excite(root, tmp_path / 'next', '--model', str(tmp_path / 'model')) == 0
    head = json.loads((tmp_path / 'next' / 'plan.json').read_text())
    assert head['noise_of'] == 'residuals' and head['noise_stated']
    assert max(head['part_of_limits']['effort'].values()) > 0.0


def test_moves_for_a_tool(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Moves with rests within the limits; what they do not push is said, and in the plan."""
    described_arm(tmp_path, currents=False)
    arm = tmp_path / 'robot.yaml'
    words = {'name': 'robot', 'kinematics': {'urdf': 'robot.urdf'}, 'joints': [
        {'name': name, 'effort': {'topic': 'joint_states', 'unit': 'N m'},
         'limits': {'acceleration': 6.0}} for name in JOINTS]}
    arm.write_text(json.dumps(words))
    call = ['excite', str(arm), '--for', 'vibration', '--floor', '0', '--seconds', '16', '--steps',
            '4', '--out']
    assert main([*call, str(tmp_path / 'plan')]) == 0
    said = unwrapped(capsys.readouterr().out)
    head = json.loads((tmp_path / 'plan' / 'plan.json').read_text())
    assert head['kind'] == 'moves' and head['expected'] == [] and head['gain_over_random'] is None
    assert 'moves: 3, each with a rest of 3.5 s' in said and 'standard errors' not in said
    assert ('are pushed' in said) == bool(head['hidden'])
    plan = read_trajectory(tmp_path / 'plan' / 'trajectory.csv')
    assert max(head['part_of_limits']['velocity'].values()) <= 1.0 + 1e-6
    for first in (0, 500, 1000):
        assert np.ptp(plan.q[first:first + 150], axis=0).max() > 0.1
        assert not plan.dq[first + 180:first + 500].any()
    for joint in words['joints']:
        joint['effort']['unit'] = 'A'
    arm.write_text(json.dumps(words))
    assert main([*call, str(tmp_path / 'other')]) == 2
    assert ('in A, but the model of vibration needs torques [N m] or forces [N]; record torques '
            'and set joints[].effort.unit to N m, or give --for rigid') in capsys.readouterr().err


@pytest.mark.parametrize(('options', 'said'), [
    (('--seconds', '3'), 'give 10 to 3600'),
    (('--noise-of', 'joint2=-1'), 'the standard deviation of the noise, a number above 0'),
    (('--noise-of', 'nobody=1'), 'a NAME of joint2, joint3'),
    (('--highest', '0.01'), 'raise --seconds or raise --highest above 0.0833 Hz'),
    (('--noise', '0'), '--noise 0: give'),
    (('--model', 'none'), 'none'), (('--srdf', 'none.srdf'), 'SRDF cannot be read'),
    (('--model', 'm', '--noise', '1'), 'leave out --noise')])
def test_wrong_input(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
                     options: tuple[str, ...], said: str) -> None:
    """One line, exit code 2, no file is left."""
    assert excite(root, tmp_path / 'plan', *options) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(('walls', 'inside'), [
    (('--floor', '0.1'), lambda x: x[:, 2].min() > 0.14),
    (('--box', '-0.4', '9', '-0.3', '0.6', '0', '9'), lambda x: (
        x[:, 0].min() > -0.36 and x[:, 1].min() > -0.26 and x[:, 1].max() < 0.56))])
def test_walls_and_efforts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], walls: tuple[str, ...], inside: Any,
) -> None:
    """An arm without meshes stays within walls, and below the efforts of its URDF."""
    described_arm(tmp_path, currents=True)
    arm = tmp_path / 'robot.yaml'
    limits = {'acceleration': 6.0}
    arm.write_text(json.dumps({
        'name': 'robot', 'kinematics': {'urdf': 'robot.urdf'}, 'joints': [
            {'name': name, 'effort': {'topic': 'joint_states', 'unit': 'A'}, 'limits': limits}
            for name in JOINTS]}))
    words = ['excite', str(arm), '--out', str(tmp_path / 'plan'), '--seconds', '14',
             '--steps', '6']
    assert main(words) == 2
    assert 'no option says where the arm may move; give --floor Z' in capsys.readouterr().err
    assert main([*words, '--box', '1', '0', '0', '1', '0', '1']) == 2
    assert '--box 1 0 0 1 0 1: give XMIN XMAX YMIN' in capsys.readouterr().err
    assert main([*words, *walls]) == 0
    said = unwrapped(capsys.readouterr().out)
    assert 'by 0 shapes and 5 capsules of 0.05 m' in said and 'efforts are not looked' not in said
    head = json.loads((tmp_path / 'plan' / 'plan.json').read_text())
    assert 0.0 < max(head['part_of_limits']['effort'].values()) <= 1.0 + 1e-6
    model = load_arm(arm).model
    data, tips = model.createData(), []
    for q in read_trajectory(tmp_path / 'plan' / 'trajectory.csv').q:
        pin.framesForwardKinematics(model, data, q)
        tips.append(data.oMf[model.getFrameId('tool')].translation.copy())
    assert inside(np.array(tips))


def test_limits_are_needed(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without speeds nothing is planned, and nothing that is there is overwritten."""
    assert main(['excite', str(root / 'config' / 'two_blade_arm.yaml'), '--floor', '0', '--out',
                 str(tmp_path / 'plan')]) == 2
    assert 'lacks a limit of velocity or acceleration' in capsys.readouterr().err
    assert excite(root, tmp_path) == 2
    assert 'exists already' in capsys.readouterr().err


def test_plans_that_are_none(root: Path, tmp_path: Path,
                             capsys: pytest.CaptureFixture[str]) -> None:
    """Fit and record refuse folders and tables that are no plan, or one of another arm."""
    arm = str(root / 'config' / 'tudor.yaml')
    bag = str(root / 'bags' / 'two_blade_test')
    folder = tmp_path / 'plan'
    folder.mkdir()

    def refused(*words: str) -> str:
        assert main([*words]) == 2
        err = capsys.readouterr().err
        assert err.count('\n') == 1
        return err
    fit = ('fit', bag, '--arm', arm, '--out', str(tmp_path / 'm'), '--plan', str(folder))
    assert 'plan.json: the plan cannot be read' in refused(*fit)
    (folder / 'plan.json').write_text('{"format": "x"}')
    assert 'the plan is not valid' in refused(*fit)
    (folder / 'plan.json').write_text(json.dumps({
        'format': 'tudor_dynamics/excitation', 'version': 1, 'noise_of': 'samples',
        'noise_stated': True, 'noise': {'effort': {'joint2': 1e-300, 'joint3': 1.0}}}))
    assert 'noise.effort.joint2 must be at least 1e-12, found 1e-300' in refused(*fit)
    record = ('record', '--arm', arm, '--out', str(tmp_path / 'r'), '--trajectory', str(folder))
    assert 'cannot be read' in refused(*record)
    (folder / 'trajectory.csv').write_text('t,a,a_velocity,a_acceleration\n0,0,0,0\n1,0,0,0\n')
    assert "the trajectory moves 'a', but arm 'tudor' has" in refused(*record)
    head = 't,' + ','.join(f'{name}{end}' for name in ('joint3', 'joint2') for end in (
        '', '_velocity', '_acceleration'))
    (folder / 'trajectory.csv').write_text(f'{head}\n0,9,0,0,0,0,0\n1,9,0,0,0,0,0\n')
    assert "at 0 s the trajectory has 'joint2' at 0 rad, but its limits are" in refused(*record)
