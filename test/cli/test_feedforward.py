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

"""The command that puts efforts beside a wanted motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from rosbags.highlevel import AnyReader
from sample_arms import random_states
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import read_trajectories, Sent, write_trajectories
from tudor_dynamics.cli.main import main
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.signals.motion_profile import denser

TABLE = 't,j1,j2\n0,0.1,0.2\n1,0.5,-0.2\n2,0.9,0.4\n'


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Save a model without payload."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    fitted = AnalyticalModel(EffortRegressor(arm), 2).fit(
        motion, true_outputs(arm, motion, 0.0)['effort'])
    path = tmp_path_factory.mktemp('feedforward') / 'model'
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}}), path)
    return path


def test_a_table_gets_efforts(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Columns are added, and what is asked of each joint is printed."""
    (tmp_path / 'path.csv').write_text(TABLE)
    out = tmp_path / 'out.csv'
    command = ['feedforward', str(tmp_path / 'path.csv'), '--model', str(model), '--out', str(out)]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert '3 points, load 0 kg' in told and 'N m' in told
    rows = np.loadtxt(out, delimiter=',', skiprows=1)
    motion = np.zeros((3, 6))
    motion[:, :2] = rows[:, [1, 3]]
    motion[1, 2:4] = 0.4, 0.1  # the mean of both slopes; at rest before and after
    truth = true_outputs(two_gauge_arm(), motion, 0.0)['effort']
    assert rows[:, [2, 4]] == pytest.approx(truth, rel=1e-6)
    assert main(command) == 2 and 'add --overwrite' in capsys.readouterr().err
    assert main([*command, '--overwrite', '--rate', '10', '--payload', '0.1']) == 0
    assert len(np.loadtxt(out, delimiter=',', skiprows=1)) == 21
    assert main([*command[:-1], str(tmp_path / 'bag')]) == 2
    assert 'one is a CSV table, the other a bag' in capsys.readouterr().err


def test_a_bag_gets_efforts(model: Path, tmp_path: Path) -> None:
    """Each trajectory of the bag, on its topic, the same as from a table."""
    (tmp_path / 'path.csv').write_text(TABLE)
    path = read_trajectories(tmp_path / 'path.csv')[0].trajectory
    write_trajectories(tmp_path / 'bag', [
        Sent(path, '/plan', 5), Sent(denser(path, 5.0), '/plan', 9)])
    for source, out in (('path.csv', 'out.csv'), ('bag', 'out')):
        assert main(['feedforward', str(tmp_path / source), '--model', str(model), '--out',
                     str(tmp_path / out)]) == 0
    with AnyReader([tmp_path / 'out']) as reader:
        found = [reader.deserialize(data, connection.msgtype)
                 for connection, _, data in reader.messages()]
    assert [len(message.points) for message in found] == [3, 11]
    rows = np.loadtxt(tmp_path / 'out.csv', delimiter=',', skiprows=1)
    assert np.array_equal([point.effort for point in found[0].points], rows[:, [2, 4]])
    assert not len(found[0].points[0].velocities) and len(found[1].points[0].velocities) == 2


@pytest.mark.parametrize(('text', 'options', 'words'), [
    ('t,j1,j3\n0,0,0\n1,0,0\n', [], 'the joint'),
    ('t,j1\n0,0\n1,0\n', [], 'is missing'),
    (TABLE, ['--unit', 'current'], 'torque constant'),
    (TABLE, ['--kind', 'elm'], 'for efforts the model has the kinds analytical'),
    (TABLE, ['--rate', '-1'], 'give more than 0'),
    (TABLE, ['--payload', '-1'], '--payload -1 kg: give 0 or more'),
    (TABLE, ['--positions', 'motor'], 'elastic model cannot be used')])
def test_wrong_input_is_one_line(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str,
    options: list[str], words: str,
) -> None:
    """Exit code 2, and nothing is written."""
    (tmp_path / 'path.csv').write_text(text)
    assert main(['feedforward', str(tmp_path / 'path.csv'), '--model', str(model), '--out',
                 str(tmp_path / 'out.csv'), *options]) == 2
    told = capsys.readouterr().err
    assert words in told and told.count('\n') == 1
    assert not (tmp_path / 'out.csv').exists()


def test_help_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    """80 columns, with examples."""
    with pytest.raises(SystemExit):
        main(['feedforward', '--help'])
    told = capsys.readouterr().out
    assert 'examples:' in told and max(len(line) for line in told.splitlines()) <= 80
