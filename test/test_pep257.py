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
import sys

from pydocstyle import check
from pydocstyle.config import ConfigurationParser
import pytest

PLACES = ('tudor_dynamics', 'papers', 'test', 'bench', 'examples', 'setup.py')
IGNORED = ('D100', 'D101', 'D102', 'D103', 'D104', 'D105', 'D106', 'D107', 'D203', 'D212', 'D404')
"""What ament_pep257 does not ask for."""


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
    # As ament_pep257 does it: from its own settings, where a property is a method like any other.
    parser = ConfigurationParser()
    monkeypatch.setattr(sys, 'argv', ['pydocstyle', f'--ignore={",".join(IGNORED)}', '--match',
                                      r'.*\.py', '--match-dir', r'[^\._].*', *places])
    parser.parse()
    errors = [str(error) for name, codes, *_ in parser.get_files_to_check()
              for error in check([name], select=codes)]
    assert not errors, '\n'.join(errors)
