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

"""``tudor info``: text, JSON, exit codes."""

import json

import numpy as np
import pytest

from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main

ARM = """
name: slider
kinematics: {dh: [[0, 0, 0, 0]]}
joints:
  - {name: axis, type: prismatic, effort: {topic: joint_states, unit: N}}
"""


@pytest.fixture
def bag(tmp_path):
    """Make a bag of one axis that moves for three seconds."""
    stamp = 10**18 + 10_000_000 * np.arange(300)
    t = np.arange(300)[:, None] * 0.01
    effort = np.cos(t)
    effort[5] = np.nan
    write_bag(tmp_path / 'bag', [
        joint_signals('/joint_states', stamp, ('axis',), np.sin(t), np.cos(t), effort),
        joint_signals('/link_strains', stamp, ('\x1b[31mgauge',), 100 * np.sin(t))])
    return tmp_path / 'bag'


def test_text_says_what_is_there(bag, capsys):
    """Topics, rates, ranges, oddities and use; nothing in a name steers the terminal."""
    assert main(['info', str(bag)]) == 0
    out = capsys.readouterr().out
    for part in ('/joint_states', '100', '0 .. 1', 'odd: ', "'axis' (in 1 of", '?[31mgauge',
                 'use: effort and strain model'):
        assert part in out
    assert '\x1b' not in out


def test_json_has_the_figures(bag, capsys):
    """One object with a list of bags; counts, rates, NaN and verdict are numbers and words."""
    assert main(['info', str(bag), '--json']) == 0
    report, = json.loads(capsys.readouterr().out)['bags']
    topic = report['topics'][0]
    assert (topic['name'], topic['count'], topic['rate']) == ('/joint_states', 300, 100.0)
    assert topic['jitter'] == 0.0 and topic['fields'] == ['position', 'velocity', 'effort']
    effort = next(item for item in topic['channels'] if item['field'] == 'effort')
    assert effort['not_finite'] == 1 and effort['maximum'] == 1.0
    assert report['effort_model'] and report['strain_model']
    assert report['samples'] == 299 and report['dropped'] == {'not_finite': 1}


def test_arm_decides_what_is_looked_for(bag, tmp_path, capsys):
    """With an arm without gauges there is no strain model; a wrong joint makes it unusable."""
    arm = tmp_path / 'arm.yaml'
    arm.write_text(ARM)
    assert main(['info', str(bag), '--arm', str(arm)]) == 0
    assert 'use: effort model; no strains' in capsys.readouterr().out
    arm.write_text(ARM.replace('axis', 'other'))
    assert main(['info', str(bag), '--arm', str(arm)]) == 0
    assert 'joints other are not in /joint_states' in capsys.readouterr().out


def test_unreadable_bags_give_two_and_the_others_are_described(bag, tmp_path, capsys):
    """One line on the error stream for the missing bag, the report for the other."""
    assert main(['info', str(tmp_path / 'gone')]) == 2
    assert main(['info', str(tmp_path / 'gone'), str(bag)]) == 2
    out, err = capsys.readouterr()
    assert 'use: effort' in out
    lines = err.splitlines()
    assert len(lines) == 2 and all('no such file' in line for line in lines)


def test_tables_are_whole_on_a_narrow_terminal(tmp_path, capsys, monkeypatch):
    """Long names go on in the next line, ranges too; no digit is lost."""
    monkeypatch.setenv('COLUMNS', '80')
    name = 'left_arm_shoulder_pan_joint_of_the_first_robot'
    stamp = 10**18 + 10_000_000 * np.arange(300)
    wave = np.sin(0.01 * np.arange(300))[:, None]
    write_bag(tmp_path / 'bag', [joint_signals(
        '/a_namespace_of_some_length/joint_states', stamp, (name,), wave - 0.12345,
        1.2345e-7 * wave, -9.8765e11 * wave)])
    assert main(['info', str(tmp_path / 'bag')]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80 and '…' not in out
    assert name in ''.join(line.partition(' ')[0] for line in out.splitlines())
    for figure in ('-0.1235', '1.234e-07', '-9.876e+11'):
        assert figure in out


def test_bag_without_joints_is_described(tmp_path, capsys):
    """Nothing to learn from is no error."""
    write_bag(tmp_path / 'bag', [])
    assert main(['info', str(tmp_path / 'bag')]) == 0
    assert 'use: nothing, as the bag has no joint positions' in capsys.readouterr().out
