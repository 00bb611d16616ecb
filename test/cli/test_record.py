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

"""``tudor record``: bags, campaign file, exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.cli.main import main
import yaml


def record(root: Path, out: Path, *more: str) -> int:
    """Run the command for two short stimuli."""
    return main(['record', '--arm', str(root / 'config' / 'tudor.yaml'), '--out', str(out),
                 '--stimuli', '2', '--seconds', '6', '--jobs', '1', *more])


def test_campaign(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two bags that the package reads, and a file that tells what was done."""
    assert record(root, tmp_path / 'out', '--payload', '0.1', '--pushes', '1', '--json') == 0
    said = json.loads(capsys.readouterr().out)
    assert [Path(item['bag']).name for item in said['bags']] == ['stimulus_01', 'stimulus_02']
    arm = load_arm(root / 'config' / 'tudor.yaml')
    recording = read_recording(tmp_path / 'out' / 'stimulus_02', arm)
    assert recording.q.shape == (600, 2) and recording.strain is not None
    assert recording.dt == pytest.approx(0.01)
    campaign = yaml.safe_load((tmp_path / 'out' / 'campaign.yaml').read_text())
    assert campaign['payload'] == 0.1 and campaign['damping'] is True
    assert campaign['stimuli'][0]['pushes'][0]['joint'] in arm.active_joints


def test_processes_do_not_change_the_bytes(root: Path, tmp_path: Path) -> None:
    """One process and two write the same files."""
    assert record(root, tmp_path / 'one') == 0
    assert record(root, tmp_path / 'two', '--jobs', '2') == 0
    files = sorted(p.relative_to(tmp_path / 'one')
                   for p in (tmp_path / 'one').rglob('*') if p.is_file())
    assert len(files) == 5
    for name in files:
        assert (tmp_path / 'one' / name).read_bytes() == (tmp_path / 'two' / name).read_bytes()


@pytest.mark.parametrize(('options', 'said'), [
    (('--stimuli', '0'), 'give 1 to 100000'), (('--rate', '300'), 'divided by a whole number'),
    (('--payload', '-1'), '--payload -1 kg: give 0 or more'), (('--seconds', '1'), 'more than 2'),
    (('--pushes', '9'), 'do not fit')])
def test_wrong_input(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
                     options: tuple[str, ...], said: str) -> None:
    """Impossible orders end with code 2 and one line, and leave no file."""
    assert record(root, tmp_path / 'out', *options) == 2
    err = capsys.readouterr().err
    assert said in err and err.count('\n') == 1
    assert not list(tmp_path.rglob('stimulus*'))


def test_nothing_is_overwritten(root: Path, tmp_path: Path,
                                capsys: pytest.CaptureFixture[str]) -> None:
    """A bag that exists is left alone."""
    (tmp_path / 'stimulus_02').mkdir()
    assert record(root, tmp_path) == 2
    assert 'exists already' in capsys.readouterr().err
    assert not (tmp_path / 'stimulus_01').exists()


def test_an_arm_without_drives(root: Path, tmp_path: Path,
                               capsys: pytest.CaptureFixture[str]) -> None:
    """An arm that lacks the damper section is refused with what is missing."""
    code = main(['record', '--arm', str(root / 'config' / 'l_shape.yaml'), '--out',
                 str(tmp_path / 'out')])
    assert code == 2
    assert "the key 'damper' is missing" in capsys.readouterr().err
