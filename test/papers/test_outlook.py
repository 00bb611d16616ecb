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

"""The frame of ``python -m papers outlook``: parts by name, a page, numbers for programs."""

from __future__ import annotations

from collections.abc import Callable
import json
from pathlib import Path
from types import ModuleType

from matplotlib.figure import Figure
from papers import outlook
from papers.__main__ import main
from papers.look import Picture
from papers.outlook import compute_of, Floor, PARTS, Section, Setting
import pytest


def small(setting: Setting) -> Section:
    """Compute a section that tells what it was given."""
    figure = Figure()
    figure.subplots().plot([0.0, 1.0])
    return Section(
        (f'<b>{setting.name}</b>',),
        (Floor('one', '< 1 g', '0.5 g', met=True), Floor('two', '< 1 g', '2 g', met=False),
         Floor('three', '< 1 g', 'no recordings', met=None)),
        (Picture(f'{setting.name}_figure', setting.name, 'A line', 'It rises.', lambda: figure),),
        {'quick': setting.quick}, (('place', 'n'), ('all', '3')))


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Let every part be the small one."""
    def module(name: str) -> ModuleType:
        made = ModuleType(name)
        made.section = small  # type: ignore[attr-defined]
        return made
    monkeypatch.setattr(outlook, 'import_module', module)
    return module


@pytest.mark.usefixtures('computed')
def test_page_and_numbers(tmp_path: Path, root: Path, capsys) -> None:
    """What must be reached stands above the figures, escaped."""
    out = tmp_path / 'out'
    assert main(['outlook', '--quick', '--arm', str(root / 'config/tudor.yaml'),
                 '--only', 'payload', '--out', str(out)]) == 0
    printed = capsys.readouterr().out
    assert 'no recordings' in printed and '--quick' in printed
    page = (out / 'outlook.html').read_text()
    assert '&lt;b&gt;payload' in page and page.count('<figure') == 1 and 'http:' not in page
    assert page.count('class="yes"') == 1 and page.count('class="no"') == 1
    assert (out / 'payload_figure.svg').is_file() and (out / 'payload_figure.png').is_file()
    tables = (out / 'outlook.md').read_text()
    assert '| two | < 1 g | 2 g |' in tables and '| all | 3 |' in tables
    content = json.loads((out / 'outlook.json').read_text())
    assert [floor['met'] for floor in content['payload']['floors']] == [True, False, None]
    assert content['payload']['data'] == {'quick': True}


@pytest.mark.parametrize('name', PARTS)
def test_every_part_has_its_module(name: str) -> None:
    """An entry names a module with a section."""
    assert callable(compute_of(name))
