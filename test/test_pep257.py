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

"""Docstrings: ament_pep257 where ROS has it, otherwise the same rules by ruff."""

from __future__ import annotations

import importlib.util
from pathlib import Path
import re

import pytest
from test_flake8 import PLACES, ruff

PROPERTY = re.compile(r'@(cached_)?property\b')


def docstrings(root: Path, folder: Path, *places: Path) -> str:
    """Give what is wrong with docstrings below places; a copy of files is made in the folder."""
    found = ruff(root, '--extend-ignore', 'A,C4,E,F,Q,W', *places)
    # A property is a method like any other for ament_pep257; ruff asks it for no imperative.
    for place in places:
        for file in [place] if place.is_file() else place.rglob('*.py'):
            plain, count = PROPERTY.subn('@method', file.read_text(encoding='utf-8'))
            if count:
                copy = folder / file.relative_to(place.parent)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_text(plain, encoding='utf-8')
    return found + ruff(root, '--select', 'D401', folder)


@pytest.mark.pep257
@pytest.mark.linter
def test_pep257(root: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No docstring breaks ROS 2's conventions."""
    monkeypatch.chdir(root)
    places = [place for place in PLACES if Path(place).exists()]
    if importlib.util.find_spec('ament_pep257'):
        from ament_pep257.main import main
        assert main(argv=places) == 0, 'see the errors printed above'
        return
    found = docstrings(root, tmp_path, *map(Path, places))
    assert len([*tmp_path.rglob('*.py')]) > 50
    assert not found, found


@pytest.mark.skipif(not importlib.util.find_spec('ruff'), reason='ament_pep257 does without')
@pytest.mark.parametrize(('text', 'wrong'), [
    ('Give a number.', ''),
    ('', 'empty-docstring'),
    ('Give a number', 'missing-trailing-period'),
    ('Gives a number.', 'non-imperative-mood'),
    ('give a number.', 'first-word-uncapitalized'),
    (' Give a number.', 'surrounding-whitespace'),
    ('Give a number.\n    And more.\n    ', 'missing-blank-line-after-summary'),
    ('Give a number.\n\n    And more.\n    ', 'multi-line-summary-second-line'),
    ('\n    Give a number.\n\n    And more.\n    ', ''),
    ('\n    Give a number.\n\n  And more.\n    ', 'under-indentation'),
    ('\n    Give a number.\n\n    Returns\n    -----\n    float\n    ',
     'mismatched-section-underline-length'),
])
@pytest.mark.parametrize('decorator', ['method', 'property'])
def test_what_breaks_conventions_is_found(
    root: Path, tmp_path: Path, decorator: str, text: str, wrong: str,
) -> None:
    """A docstring with a fault is found, of a property as well as of a function."""
    file = tmp_path / 'code.py'
    file.write_text(f'@{decorator}\ndef number() -> float:\n    """{text}"""\n    return 1.0\n')
    (folder := tmp_path / 'copies').mkdir()
    found = docstrings(root, folder, file).splitlines()
    assert bool(found) == bool(wrong) and wrong in ''.join(found), found
