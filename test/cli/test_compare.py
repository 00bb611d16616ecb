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

"""Models and descriptions side by side."""

from __future__ import annotations

import json

import numpy as np
import pytest
from robot_making import described_arm, efforts_of, fitted, JOINTS, motion_of
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
import yaml


@pytest.fixture(scope='module')
def sides(tmp_path_factory):
    """Give a folder with a description, a model, and a recording of the true arm."""
    path = tmp_path_factory.mktemp('compare')
    arm = described_arm(path)
    content = arm.spec.model_dump(mode='json', exclude_defaults=True)
    content['kinematics'] = {'urdf': 'robot.urdf'}
    (path / 'robot.yaml').write_text(yaml.safe_dump(content))
    spec = PreprocessingSpec(filter='zero_phase')
    save_bundle(ModelBundle(arm, spec, {'effort': {'analytical': fitted(arm)}}), path / 'model')
    motion = motion_of(20.0, 9, rate=100.0)
    stamps = (1e9 + np.arange(len(motion)) * 1e7).astype(np.int64)
    n = len(JOINTS)
    write_bag(path / 'bag', [joint_signals(
        topic='/joint_states', stamp=stamps, names=JOINTS, position=motion[:, :n],
        velocity=motion[:, n:2 * n], effort=efforts_of(arm, motion))])
    return path


def test_a_model_beside_the_description(sides, capsys):
    assert main(['compare', str(sides / 'robot.yaml'), str(sides / 'model'), str(sides / 'bag'),
                 '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert [row['joint'] for row in found['bodies']] == list(JOINTS)
    before, after = found['relative_error']['one'], found['relative_error']['other']
    assert max(after) < 0.02
    assert before[1] > 5.0 * after[1], 'the upper arm is not as heavy as described'
    assert found['bodies'][0]['mass'][0] == pytest.approx(6.0)


def test_the_table_fits_a_terminal(sides, capsys):
    assert main(['compare', str(sides / 'robot.yaml'), str(sides / 'model')]) == 0
    told = capsys.readouterr().out
    assert 'centres apart' in told
    assert all(len(line) <= 80 for line in told.splitlines()[2:])


def test_what_cannot_be_compared_is_said(sides, root, capsys):
    arm = str(sides / 'robot.yaml')
    assert main(['compare', arm, arm, str(sides / 'bag')]) == 2
    assert 'with a model, but A and B are arm descriptions' in capsys.readouterr().err
    assert main(['compare', str(root / 'config' / 'ur10.yaml'), arm]) == 2
    assert 'the description has no masses' in capsys.readouterr().err
    assert main(['compare', str(root / 'config' / 'tudor.yaml'), arm]) == 2
    assert 'compare models of the same arm' in capsys.readouterr().err


@pytest.mark.parametrize('words', [
    ('{arm}', '--model', '{model}'), ('--arm', '{arm}', '--model={model}'),
    ('--arm={arm}', '{model}')])
def test_the_names_of_other_commands(sides, capsys, words):
    """--arm and --model name a side each, in the order in which they are given."""
    places = {'arm': sides / 'robot.yaml', 'model': sides / 'model'}
    assert main(['compare', *(word.format_map(places) for word in words), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert main(['compare', *map(str, places.values()), '--json']) == 0
    assert json.loads(capsys.readouterr().out) == found
