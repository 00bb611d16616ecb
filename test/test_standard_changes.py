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

"""
Standard changes are replayed on a copy: each touches few files, and does what it is for.

A change is a patch in ``test/changes/``; its head says in words what it adds and with which test
that is seen. Where one no longer applies, write it again: its size is what is tested.
"""

from __future__ import annotations

import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHANGES = sorted((ROOT / 'test' / 'changes').glob('*.patch'))
MOST = 5
"""Files that a standard change touches, tests and reference included (CONTRIBUTING)."""
FOLDERS = ('tudor_dynamics', 'test', 'docs', 'config', 'tools', 'bags')


@pytest.mark.parametrize('change', CHANGES, ids=[file.stem for file in CHANGES])
def test_a_standard_change(change: Path, tmp_path: Path) -> None:
    """It touches five files at most, and its own test passes; nothing is compiled for it."""
    text = change.read_text(encoding='utf-8')
    touched = set(re.findall(r'^\+\+\+ b/(\S+)', text, re.M))
    selected = re.findall(r'^test: (\S+)', text, re.M)
    assert selected and len(touched) <= MOST, touched
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns(
            '__pycache__', 'tudor_damped', 'tudor_undamped'))
    for name in ('setup.cfg', 'CHANGELOG.rst', 'README.md'):
        shutil.copy(ROOT / name, tmp_path)
    subprocess.run(['git', 'apply', '--whitespace=nowarn', str(change)], cwd=tmp_path, check=True,
                   env={**os.environ, 'GIT_CEILING_DIRECTORIES': str(tmp_path.parent)})
    run = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *selected], cwd=tmp_path,
        env={**os.environ, 'PYTHONPATH': str(tmp_path), 'NUMBA_DISABLE_JIT': '1'},
        capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr


def test_kinds_of_changes() -> None:
    """A figure in diagnostics, an estimator, a friction term with a state, a key of a joint."""
    assert [file.stem for file in CHANGES] == ['diagnostics', 'estimator', 'friction', 'joint_key']
