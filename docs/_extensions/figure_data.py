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
Figures that benches measured, as data: ``docs/figures/NAME.json``.

A page shows the table with the directive ``figures`` (MyST: three backticks, ``{figures} NAME``).
Below it stand the command, the commit that the figures are of, and how many commits have changed
the files in ``paths`` since. The build says which figures are older than their code; this is no
warning, so that it does not fail.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
import json
from pathlib import Path
import re
import subprocess
from typing import Any

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from sphinx.util import logging

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / 'docs' / 'figures'
LOGGER = logging.getLogger(__name__)
UNIT = re.compile(r'(?<=\d) (?=(?:%|[µmk]?s|min|h|k?Hz|[µmc]?m|m?N|k?g|deg|rad|[KMG]i?B)\b|%)'
                  r'|(?<=[≥≤±]) (?=\d)')
"""Blank between a number and its unit or its bound, which stay in one line."""


@dataclass(frozen=True)
class Figures:
    """A table that a command measured."""

    command: str
    commit: str  # that the figures are of
    date: str
    paths: list[str]  # of the code that they depend on
    head: list[str]
    rows: list[list[str]]
    measured: bool = False  # written by `tools/figures.py`; otherwise by hand

    def changes(self) -> int | None:
        """Count the commits since that changed the code; None where git does not know."""
        done = subprocess.run(
            ['git', 'rev-list', '--count', f'{self.commit}..', '--', *self.paths], cwd=ROOT,
            capture_output=True, text=True, check=False)
        return int(done.stdout) if done.returncode == 0 else None

    def table(self) -> list[str]:
        """Give the lines of a Markdown table."""
        return [f'| {" | ".join(cells)} |' for cells in (
            self.head, ['---'] * len(self.head), *self.rows)]

    def text(self) -> str:
        """Give the file: a row a line."""
        fields = {key: json.dumps(value, ensure_ascii=False)
                  for key, value in asdict(self).items()}
        fields['rows'] = '[\n  ' + ',\n  '.join(
            json.dumps(row, ensure_ascii=False) for row in self.rows) + ']'
        return '{' + ',\n '.join(f'"{key}": {value}' for key, value in fields.items()) + '}\n'


def read(name: str) -> Figures:
    """Read a file of figures."""
    return Figures(**json.loads((FOLDER / f'{name}.json').read_text(encoding='utf-8')))


class FiguresDirective(Directive):
    """Show the table of a file, with its command, its commit and its age."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Give the nodes."""
        name = self.arguments[0]
        environment = self.state.document.settings.env
        environment.note_dependency(str(FOLDER / f'{name}.json'))
        figures = read(name)
        changes = figures.changes()
        age = ('' if changes == 0 else ', age unknown' if changes is None else
               f'; {changes} commit{"s" * (changes > 1)} to its code since')
        if changes:
            LOGGER.info('old: figures %s are of %s, %d commits to their code since; %s',
                        name, figures.commit, changes, figures.command)
        lines = [*(UNIT.sub('\u00a0', line) for line in figures.table()), '',
                 f'*{figures.date}, {figures.commit}: `{figures.command}`*{age}', '']
        parent = nodes.container(classes=['figures'])
        self.state.nested_parse(StringList(lines, source=name), self.content_offset, parent)
        return [parent]


def setup(app: Any) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive('figures', FiguresDirective)
    return {'parallel_read_safe': True}
