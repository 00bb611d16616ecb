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


"""What every command prints where a terminal has 80 columns, and no terminal is there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fleet_making import write_fleet
import pytest
from rich.console import Console
from rich.table import Table
from tudor_dynamics.cli import console
from tudor_dynamics.cli.main import main, SUBCOMMANDS

BAGS = 'bags/two_blade_'
COMMANDS = {
    'doctor': ['doctor -v'],
    'info': [f'info {BAGS}test', f'info {BAGS}test --arm config/two_blade_arm.yaml -v'],
    'init': [f'init {BAGS}test --out arm.yaml'],
    'excite': ['excite config/tudor.yaml --floor 0 --seconds 10 --steps 1 --out plan'],
    'fit': [f'fit {BAGS}test@0-50% --arm config/two_blade_arm.yaml --out new --filter causal '
            '--estimator ols --friction viscous --currents separate --exit-zero -v'],
    'fleet': ['fleet cells/plan.yaml --no-models --jobs 1 --out fleet'],
    'evaluate': [f'evaluate {BAGS}test --model model --report page.html -v',
                 f'evaluate {BAGS}pushes@5s-20s --model model --collisions -v'],
    'watch': [f'watch {BAGS}pushes --model model'],
    'why': [f'why {BAGS}pushes --model model -v'],
    'payload': [f'payload {BAGS}test@0-50% --model model'],
    'compare': ['compare model model', f'compare model model {BAGS}test'],
    'export': ['export model --to urdf --out arm.urdf', 'export model --to csv --out table.csv'],
    'feedforward': ['feedforward path.csv --model model --out with.csv'],
    'shape': ['shape path.csv --frequency 2.9 --out still.csv'],
    'tune': ['tune config/tudor.yaml --payloads 0 --out gains.yaml'],
    'record': ['record --arm config/tudor.yaml --stimuli 1 --seconds 3 --jobs 1 --out recorded'],
    'simulate': ['simulate config/single_flexible_link.yaml --modes 4',
                 'simulate config/single_flexible_link.yaml --torque 0 --seconds 0.1 --out run'],
}
TABLE = 't,joint2,joint3\n0,0.5,0\n0.5,0.55,0.05\n1,0.6,0.1\n1.5,0.6,0.1\n'


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Note the words that are given to be laid out, as lines and as cells of tables."""
    words: list[str] = []
    wrapped, draw = console.wrapped, Console.print

    def line(text: str, width: int) -> str:
        words.extend(text.split())
        return wrapped(text, width)

    def printed(self: Console, *objects: Any, **more: Any) -> None:
        words.extend(word for table in objects if isinstance(table, Table)
                     for column in table.columns for cell in (column.header, *column.cells)
                     for word in str(cell).split())
        draw(self, *objects, **more)

    monkeypatch.setattr(console, 'wrapped', line)
    monkeypatch.setattr(Console, 'print', printed)
    return words


def faults(text: str, words: list[str]) -> Iterator[str]:
    """Name lines that are too long or end in blanks, and words that are not whole."""
    for line in text.splitlines():
        if len(line) > 80:
            yield f'{len(line)} columns: {line}'
        if line != line.rstrip():
            yield f'blanks at the end: {line!r}'
    whole = set(text.split())
    yield from (f'{word!r} is cut or left out' for word in words if word not in whole)


@pytest.mark.parametrize('name', SUBCOMMANDS)
def test_eighty_columns(
    name: str, root: Path, model: Path, tmp_path: Path, given: list[str],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """No line is longer, none ends in a blank, no word and no number is broken."""
    for path in (root / 'bags', root / 'config', model):
        (tmp_path / ('model' if path == model else path.name)).symlink_to(path)
    (tmp_path / 'path.csv').write_text(TABLE)
    if name == 'fleet':
        write_fleet(tmp_path / 'cells', 4, lambda number, date: 1.0 + 0.5 * number * date, 3)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('COLUMNS', '80')
    monkeypatch.setattr('tudor_dynamics.models.tuning.POSES', 3)
    for command in COMMANDS[name]:
        given.clear()
        assert main(command.split()) in (0, 1), capsys.readouterr().err
        text = capsys.readouterr().out
        assert text.strip() and not list(faults(text, given)), '\n'.join(faults(text, given))


def test_faults_are_seen() -> None:
    """A word that is cut, a line that is too long, a blank at the end."""
    assert list(faults('a word\n  that\n', ['a', 'word', 'that'])) == []
    assert len(list(faults('a wo\n  rd \n' + 90 * '-', ['a', 'word']))) == 3
