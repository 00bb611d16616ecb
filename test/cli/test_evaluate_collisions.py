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

"""``tudor evaluate --collisions``: figures on recorded pushes, plot, wrong input."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tudor_dynamics.cli.main import main


@pytest.mark.shared
def test_recorded_pushes(
    root: Path, shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    """Six of seven pushes within 80 ms (median), no false alarm; all methods side by side."""
    bags = shared_data / 'bags'
    assert main(['fit', *(str(bags / f'arm_200g_free_{i}') for i in (1, 2, 3)), '--models',
                 'analytical', '--arm', str(root / 'config/two_blade_arm.yaml'), '--out',
                 str(tmp_path / 'm')]) == 0
    capsys.readouterr()
    assert main(['evaluate', '--model', str(tmp_path / 'm'), str(bags / 'arm_200g_pushes'),
                 str(bags / 'arm_200g_free_4'), '--collisions', '--report',
                 str(tmp_path / 'r.html'), '--json']) == 0
    found = json.loads(capsys.readouterr().out)['collisions']
    assert set(found) == {'strain', 'effort', 'momentum'}
    strain = found['strain']
    assert strain['pushes'] == 7 and strain['found'] >= 6
    assert strain['latency_median'] <= 0.08
    assert all(item['false_alarms'] == 0 for item in found.values())
    assert found['effort']['found'] >= 5 and found['momentum']['found'] >= 5
    assert 'pushes found of 7' in (tmp_path / 'r.html').read_text()
