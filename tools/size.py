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
Print how large the package is, room by room, and what a reader meets in it.

    python tools/size.py [CHECKOUT]

Lines of code are those without blank lines, comments, imports and docstrings of modules, classes
and functions. Rooms are the folders of the package, ``.`` what lies beside them; ``papers/`` is
counted apart. Columns: docs, share of lines in docstrings; mods, modules; <50, modules with less
code than that (no ``__init__``); public, functions and classes of modules; load, modules about
payload alone, by their path or by the word in 15 % of their lines; num, numbers that modules
define; src, those whose comment has one of the words bench, paper, measured, measurement; tests,
their code per code of the room.
"""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
import re
import sys
import textwrap

PACKAGE = 'tudor_dynamics'
SMALL = 50
"""Lines of code."""
ABOUT = 0.15
"""Share of lines with the word from which on a module is about nothing else."""
WORD = 'payload'
SOURCE = re.compile(r'bench|\bpapers?\b|\bmeasure(?:d|ments?)\b', re.IGNORECASE)
SECTION = re.compile(r'^\s*-{4,}\s*$', re.MULTILINE)
Documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass
class Size:
    """What is counted in a module, or in several."""

    lines: int = 0
    code: int = 0
    docstrings: int = 0
    sections: int = 0
    modules: int = 0
    small: int = 0
    public: int = 0
    named: int = 0
    about: int = 0
    numbers: int = 0
    numbered: int = 0
    sourced: int = 0
    classes: list[str] = field(default_factory=list)

    def __add__(self, other: Size) -> Size:
        """Add, item by item."""
        return Size(*(getattr(self, name) + getattr(other, name)
                      for name in self.__dataclass_fields__))


def docstrings(tree: ast.Module) -> Iterator[ast.Expr]:
    """Find them in a module, its classes and functions."""
    for node in ast.walk(tree):
        if isinstance(node, Documented) and ast.get_docstring(node, clean=False) is not None:
            statement = node.body[0]
            assert isinstance(statement, ast.Expr)
            yield statement


def _lines(nodes: Iterator[ast.AST]) -> set[int]:
    return {line for node in nodes for line in range(
        getattr(node, 'lineno'), getattr(node, 'end_lineno') + 1)}


def is_number(value: ast.expr) -> bool:
    """Say whether it is one, perhaps with a sign."""
    if isinstance(value, ast.UnaryOp):
        value = value.operand
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def numbers(tree: ast.Module, text: list[str]) -> Iterator[tuple[str, str]]:
    """Give name and comment of each number that a module defines."""
    for statement, after in zip_longest(tree.body, tree.body[1:]):
        if isinstance(statement, ast.Assign):
            target, value = statement.targets[0], statement.value
        elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
            target, value = statement.target, statement.value
        else:
            continue
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts))  # fewer names where one takes the rest
        first = statement.lineno - 1
        while first > 0 and text[first - 1].startswith('#'):
            first -= 1
        comment = ' '.join(text[first:statement.end_lineno])
        if (isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                and isinstance(after.value.value, str)):
            comment += ' ' + after.value.value
        for name, item in pairs:
            if isinstance(name, ast.Name) and is_number(item):
                yield name.id, comment


def measure(path: Path, root: Path) -> Size:
    """Count in one file."""
    content = path.read_text()
    tree, text = ast.parse(content), content.splitlines()
    found = list(docstrings(tree))
    documented = _lines(iter(found))
    imported = _lines(node for node in ast.walk(tree)
                      if isinstance(node, (ast.Import, ast.ImportFrom)))
    written = {number for number, line in enumerate(text, start=1) if line.strip()}
    code = len({number for number in written if not text[number - 1].lstrip().startswith('#')}
               - documented - imported)
    sections = 0
    for item in found:
        assert isinstance(item.value, ast.Constant)
        parts = SECTION.split(str(item.value.value), maxsplit=1)
        sections += 1 + len(parts[1].splitlines()) if len(parts) > 1 else 0
    place = path.relative_to(root).as_posix()
    share = sum(WORD in line.lower() for line in text) / max(len(written), 1)
    defined = [node.name for node in tree.body if isinstance(
        node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and not node.name.startswith('_')]
    given = list(numbers(tree, text))
    return Size(
        len(text), code, len(documented), sections, 1,
        int(code < SMALL and path.name != '__init__.py'), len(defined),
        int(WORD in content.lower() or WORD in place), int(WORD in place or share > ABOUT),
        len(given), int(bool(given)),
        sum(bool(SOURCE.search(comment)) for _, comment in given),
        [node.name for node in tree.body
         if isinstance(node, ast.ClassDef) and not node.name.startswith('_')])


def rooms(folder: Path) -> dict[str, Size]:
    """Count in a folder, by the folders in it."""
    sizes: dict[str, Size] = defaultdict(Size)
    for path in sorted(folder.rglob('*.py')):
        parts = path.relative_to(folder).parts
        sizes[parts[0] if len(parts) > 1 else '.'] += measure(path, folder)
    return dict(sorted(sizes.items()))


def _row(name: str, size: Size, tests: int) -> str:
    return (f'{name:15}{size.lines:7}{size.code:7}{size.docstrings / max(size.lines, 1):6.0%}'
            f'{size.modules:6}{size.small:5}{size.public:8}{size.about:6}{size.numbers:5}'
            f'{size.sourced:5}{tests / max(size.code, 1):7.2f}')


def report(checkout: Path) -> str:
    """Write the table and what follows it."""
    package, tests = rooms(checkout / PACKAGE), rooms(checkout / 'test')
    papers = sum(rooms(checkout / 'papers').values(), Size())
    total = sum(package.values(), Size())
    lines = ['room             lines   code  docs  mods  <50  public  load  num  src  tests',
             *(_row(name, size, tests[name].code if name in tests else 0)
               for name, size in package.items()),
             _row('package', total, sum(size.code for size in tests.values()))]
    if papers.modules:
        lines.append(_row('papers beside', papers, 0))
    init = ast.parse((checkout / PACKAGE / '__init__.py').read_text())
    exported = [len(node.value.elts) for node in init.body
                if isinstance(node, ast.Assign) and isinstance(node.value, ast.List)
                and getattr(node.targets[0], 'id', '') == '__all__']
    speaking = [name for name, size in package.items() if size.about]
    twice = sorted(name for name, count in Counter(total.classes).items() if count > 1)
    lines += [
        '', f'exported by the package: {sum(exported)} names; public: {total.public}',
        f'sections of docstrings: {total.sections} lines, '
        f'{total.sections / max(total.lines, 1):.0%} of the package',
        f'numbers: {total.numbers} in {total.numbered} files, {total.sourced} with a source',
        f'{WORD}: named in {total.named} files; {total.about} modules in {len(speaking)} rooms '
        'are about nothing else:', '   ' + ', '.join(speaking),
        f'{len(twice)} classes have a name that another has:',
        textwrap.fill(' '.join(twice), 78, initial_indent='   ', subsequent_indent='   ')]
    return '\n'.join(lines)


if __name__ == '__main__':
    print(report(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parents[1]))
