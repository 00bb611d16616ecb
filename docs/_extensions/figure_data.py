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
Below it stand the command, the commit that the figures are of, and, where the code in ``paths``
computes otherwise since, that they are old and by how many commits. Comments, texts, types and
imports are no such code. The build ends with how many are old; this is no warning, so
that it does not fail. ``python tools/figures.py`` lists them.
"""

from __future__ import annotations

import ast
from dataclasses import asdict, dataclass
from functools import lru_cache
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


class _Computing(ast.NodeTransformer):
    """Leave of a module what figures may depend on."""

    def visit_Import(self, node: ast.Import) -> None:  # noqa: N802
        """Leave out where names are from: modules move."""

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:  # noqa: N802
        """Leave it out as well."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        """Leave out the type of an argument."""
        return ast.arg(node.arg)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:  # noqa: N802
        """Leave out the type of what it gives."""
        node.returns = None
        return self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.Pass:  # noqa: N802
        """Keep that an error ends it, not which."""
        return ast.Pass()

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.Constant:  # noqa: N802
        """Leave out texts for people."""
        return ast.Constant('')

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:  # noqa: N802
        """Leave them out where they are plain, too."""
        return ast.Constant('') if isinstance(node.value, str) and ' ' in node.value else node

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:  # noqa: N802
        """Leave out docstrings."""
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)


@lru_cache(maxsize=None)
def computing(text: str) -> str:
    """Give what a module computes: two texts with the same give the same figures."""
    return ast.dump(_Computing().visit(ast.parse(text)))


def git(*words: str, given: str = '') -> str | None:
    """Give what git says; None where it does not know."""
    done = subprocess.run(['git', *words], cwd=ROOT, input=given, capture_output=True, text=True,
                          check=False)
    return done.stdout if done.returncode == 0 else None


@lru_cache(maxsize=None)
def blob(name: str) -> str | None:
    """Give a version of a file; None where it is absent."""
    return git('cat-file', 'blob', name) if name.strip('0') else None


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
        """Count the commits since to code that computes otherwise; None where git cannot say."""
        raw = git('diff', '--raw', '--no-renames', '--no-abbrev', self.commit, 'HEAD', '--',
                  *self.paths)
        if raw is None:
            return None
        changed = []
        for line in raw.splitlines():
            (_, _, old, new, _), file = line.split('\t')[0].split(), line.split('\t')[1]
            texts = blob(old), blob(new)
            if None in texts or not file.endswith('.py') or (
                    computing(str(texts[0])) != computing(str(texts[1]))):
                changed.append(file)
        since = git('rev-list', '--count', f'{self.commit}..', '--', *changed) if changed else None
        return int(since or 0)

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
               f'; old: {changes} commit{"s" * (changes > 1)} to its code since')
        environment.figures_changes = {**getattr(environment, 'figures_changes', {}),
                                       name: changes}
        lines = [*(UNIT.sub('\u00a0', line) for line in figures.table()), '',
                 f'*{figures.date}, {figures.commit}: `{figures.command}`*{age}', '']
        parent = nodes.container(classes=['figures'])
        self.state.nested_parse(StringList(lines, source=name), self.content_offset, parent)
        return [parent]


def merge(app: Any, env: Any, docnames: list[str], other: Any) -> None:
    """Add what another process has read."""
    env.figures_changes = {**getattr(env, 'figures_changes', {}),
                           **getattr(other, 'figures_changes', {})}


def summary(app: Any, exception: Exception | None) -> None:
    """Say how many figures are old, in one line."""
    ages = getattr(app.env, 'figures_changes', {})
    if exception is None:
        LOGGER.info('figures: %d of %d are old; `python tools/figures.py` lists them',
                    sum(bool(count) for count in ages.values()), len(ages))


def setup(app: Any) -> dict[str, Any]:
    """Add the directive, and the line that ends the build."""
    app.add_directive('figures', FiguresDirective)
    app.connect('env-merge-info', merge)
    app.connect('build-finished', summary)
    return {'parallel_read_safe': True, 'env_version': 1}
