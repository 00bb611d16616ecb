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

"""Style of the code: ament_flake8 where ROS has it, otherwise flake8 with the same plugins."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import subprocess
import sys

import pytest

PLACES = ('tudor_dynamics', 'papers', 'test', 'bench', 'setup.py')
PROGRAM = ('import gc, sys; gc.set_threshold(20_000, 50, 1000); '
           'from flake8.main.cli import main; sys.exit(main())')
"""``-m flake8``, where garbage is looked for in the trees of files less often."""
PLUGINS = ('flake8-builtins', 'flake8-comprehensions', 'flake8-quotes', 'flake8_import_order')


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file breaks ROS 2's code style, with the settings of setup.cfg."""
    monkeypatch.chdir(root)
    places = [place for place in PLACES if Path(place).exists()]
    if importlib.util.find_spec('ament_flake8'):
        from ament_flake8.main import main_with_errors
        code, errors = main_with_errors(argv=['--config', 'setup.cfg', *places])
        assert code == 0, '\n'.join(errors)
        return
    flake8 = [sys.executable, '-c', PROGRAM]
    version = subprocess.run([*flake8, '--version'], capture_output=True, text=True, check=True)
    # Names are broken across lines in that output. Without the plugins the check is half a check.
    loaded = version.stdout.replace('\n', ' ')
    missing = [plugin for plugin in PLUGINS if plugin not in loaded]
    assert not missing, f'flake8 runs without {missing}: pip install -e .[test]'
    run = subprocess.run([*flake8, '--config', 'setup.cfg', *places],
                         capture_output=True, text=True)
    assert run.returncode == 0, run.stdout + run.stderr
