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

"""Docstrings: ament_pep257 where ROS has it, otherwise pydocstyle with its settings."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import subprocess
import sys

import pytest

PLACES = ('tudor_dynamics', 'test', 'bench', 'examples', 'setup.py')


@pytest.mark.pep257
@pytest.mark.linter
def test_pep257(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No docstring breaks ROS 2's conventions."""
    monkeypatch.chdir(root)
    places = [place for place in PLACES if Path(place).exists()]
    if importlib.util.find_spec('ament_pep257'):
        from ament_pep257.main import main
        assert main(argv=places) == 0, 'see the errors printed above'
        return
    run = subprocess.run([sys.executable, '-m', 'pydocstyle', '--config', 'setup.cfg', *places],
                         capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
