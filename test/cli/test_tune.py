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

"""``tudor tune``: a schedule, its picture, its figures; what cannot be tuned is one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.cli.main import main
from tudor_dynamics.control.schedule import load_schedule
import tudor_dynamics.models.tuning as module

CONFIG = Path(__file__).parent.parent.parent / 'config'


@pytest.fixture(autouse=True)
def _few_poses(monkeypatch: Any) -> None:
    monkeypatch.setattr(module, 'POSES', 20)


def test_schedule_and_picture(tmp_path: Path, capsys: Any) -> None:
    """The figures of the file are those that are told."""
    out = tmp_path / 'new' / 'schedule.yaml'
    assert main(['tune', str(CONFIG / 'tudor.yaml'), '--payloads', '0', '0.4', '--damping-ratio',
                 '0.5', '--out', str(out), '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    schedule = load_schedule(out, load_arm(CONFIG / 'tudor.yaml'))
    assert schedule.content.damping_ratio == told['asked'] == 0.5
    assert told['missed'] == 0 and told['nodes'] == schedule.column('reached').size
    assert [row['payload'] for row in told['payloads']] == [0.0, 0.4]
    # from the measured ring-downs of the real arm, 3.0 to 3.4 Hz without payload
    assert 2.9 < told['payloads'][0]['frequency'][0] < told['payloads'][0]['frequency'][1] < 3.5
    assert out.with_suffix('.png').read_bytes()[:4] == b'\x89PNG'


def test_what_the_delay_forbids(tmp_path: Path, capsys: Any) -> None:
    """Exit code 1, and the schedule has what can be had."""
    out = tmp_path / 'schedule.yaml'
    assert main(['tune', str(CONFIG / 'tudor.yaml'), '--damping-ratio', '0.8', '--delay', '0.05',
                 '--out', str(out)]) == 1
    assert 'that can be had' in capsys.readouterr().out
    assert load_schedule(out).column('reached').max() < 0.8


@pytest.mark.parametrize('more, cause', [
    (['--out', 'schedule.txt'], 'expected a file that ends in .yaml'),
    (['--out', 'schedule.yaml', '--damping-ratio', '2'], 'give 0.02 to 0.95'),
    (['--out', 'schedule.yaml', '--payloads', '0.2', '0.1'], '--payloads 0.2 0.1: give masses'),
    (['--out', 'schedule.yaml', '--picture', 'picture.bmp'], 'ends in .png or .svg or .pdf'),
    (['--out', 'schedule.yaml', '--model', 'nothing'], 'nothing')])
def test_wrong_input(more: list[str], cause: str, capsys: Any) -> None:
    """One line and exit code 2; nothing is written."""
    assert main(['tune', str(CONFIG / 'tudor.yaml'), *more]) == 2
    error = capsys.readouterr().err.strip()
    assert cause in error and '\n' not in error
    assert not Path(more[1]).exists()


def test_rigid_arm(tmp_path: Path, capsys: Any) -> None:
    """An arm without damper says so."""
    assert main(['tune', str(CONFIG / 'l_shape.yaml'), '--out', str(tmp_path / 's.yaml')]) == 2
    assert "the key 'damper' is missing" in capsys.readouterr().err
