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

"""A short run of ``bench/doctor.py``, the long one of which takes minutes."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
import subprocess
import sys

import pytest

from tudor_dynamics.identification.doctor.findings import CHECKS


def test_injected_faults(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nearly all faults in one bag are named, with place and size, and the bag stays clean."""
    done = subprocess.run(
        [sys.executable, 'bench/doctor.py', '--own', '--bags', 'two_blade_test', '--jobs', '1',
         '--json'],
        cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    content = json.loads(done.stdout)['all']
    assert content['put_in'] > 30
    assert content['named'] >= content['placed'] >= content['sized'] >= 0.95
    assert content['false'] == []
    # the document has what the command prints
    monkeypatch.syspath_prepend(str(root / 'bench'))
    table = importlib.import_module('doctor').table
    head, _, *lines = table({'all': content})
    for name in ('doctor_own', 'doctor_all'):  # bags of the repository, and all
        found = json.loads((root / f'docs/figures/{name}.json').read_text(encoding='utf-8'))
        assert [cell.strip() for cell in head.strip('|').split('|')] == found['head']
        kinds = [row[0].strip('`') for row in found['rows']]
        assert kinds == [kind for kind in CHECKS if kind in kinds]
        assert {line.split('`')[1] for line in lines} <= set(kinds)
        for row in found['rows']:
            put_in, named, placed, sized = (int(cell) for cell in row[1:5])
            assert put_in >= named >= placed >= sized
