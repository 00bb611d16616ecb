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
Every public argument is explained, by what it is and not by its own name.

A function with sections explains all of its arguments in them. A docstring of one line is enough
for compiled helpers and the tables that they take, for nodes and commands (which ``docs/nodes.md``
and ``--help`` explain), and where at most two arguments are named in it, or are of a class of the
package. A method that keeps a contract is explained in the class that its docstring ends with.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
import re

from numpydoc.docscrape import NumpyDocString
import pytest

import tudor_dynamics as td

PACKAGE = Path(__file__).resolve().parents[1] / 'tudor_dynamics'
MOST = 2
"""Arguments that a docstring of one line may leave to its sentence."""
LEAST_WORDS = 3
"""Of a description; a unit counts as one of them."""
NO_CLASS = {'Any', 'ArrayLike', 'Callable', 'FloatArray', 'IntArray', 'Literal', 'Mapping', 'None',
            'NDArray', 'Path', 'Sequence'}
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Item:
    """
    Something public with arguments.

    Attributes
    ----------
    where : str
        File, line and name.
    doc : str
        Its docstring.
    arguments : dict of str to str
        Argument to annotation.
    brief : bool
        Whether a line is enough, whatever it takes.

    """

    where: str
    doc: str
    arguments: dict[str, str]
    brief: bool


def arguments(function: Function, *, method: bool) -> dict[str, str]:
    """Give the arguments of a function with their annotations."""
    args, found = function.args, {}
    static = any(ast.unparse(mark) == 'staticmethod' for mark in function.decorator_list)
    for arg in [*args.posonlyargs, *args.args][method and not static:] + args.kwonlyargs:
        found[arg.arg] = ast.unparse(arg.annotation) if arg.annotation else ''
    for mark, arg in (('*', args.vararg), ('**', args.kwarg)):
        if arg is not None:
            found[mark + arg.arg] = ''
    return found


def fields(node: ast.ClassDef) -> dict[str, str] | None:
    """Give the arguments of a dataclass or NamedTuple; None for another class."""
    marks = ' '.join(ast.unparse(mark) for mark in (*node.decorator_list, *node.bases))
    if 'dataclass' not in marks and 'NamedTuple' not in marks:
        return None
    return {line.target.id: ast.unparse(line.annotation) for line in node.body
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
            and not line.target.id.startswith('_') and 'init=False' not in ast.unparse(line)}


def items(text: str, place: str) -> Iterator[Item]:
    """Find what is public in a module."""
    shells = place.startswith(('nodes/', 'cli/'))
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith('_'):
            methods = [item for item in node.body if isinstance(item, Function)]
            init = [item for item in methods if item.name == '__init__']
            own = fields(node)
            if own is None:
                own = arguments(init[0], method=True) if init else {}
            yield Item(f'{place}:{node.lineno} {node.name}', ast.get_docstring(node) or '', own,
                       shells or any(ast.unparse(base) == 'NamedTuple' for base in node.bases))
            public = [(f'{node.name}.{item.name}', item) for item in methods
                      if not item.name.startswith('_')]
        elif isinstance(node, Function) and not node.name.startswith('_'):
            public = [(node.name, node)]
        else:
            continue
        for name, function in public:
            marks = [ast.unparse(mark) for mark in function.decorator_list]
            if any(mark.endswith('.setter') for mark in marks):
                continue
            yield Item(f'{place}:{function.lineno} {name}', ast.get_docstring(function) or '',
                       arguments(function, method='.' in name),
                       shells or any('compiled' in mark for mark in marks))


def named(argument: str, annotation: str, doc: str) -> bool:
    """Say whether a sentence speaks of an argument, or its class says what it is."""
    if set(re.findall(r'[A-Z]\w+', annotation)) - NO_CLASS:
        return True
    stems = [argument.lower(), *(word[:4] for word in argument.lower().split('_')
                                 if len(word) > 2)]
    return any(re.search(rf'\b{re.escape(stem)}', doc.lower()) for stem in stems)


@lru_cache
def methods_of(name: str) -> frozenset[str]:
    """Give the methods of the package's classes of a name."""
    return frozenset(
        item.name for file in PACKAGE.rglob('*.py')
        for node in ast.parse(file.read_text(encoding='utf-8')).body
        if isinstance(node, ast.ClassDef) and node.name == name
        for item in node.body if isinstance(item, Function))


def explained_elsewhere(item: Item) -> bool:
    """Say whether a docstring points to a class that has the same method."""
    owner, _, method = item.where.rpartition(' ')[2].partition('.')
    pointed = re.search(r'; see ``(\w+)``\.$', item.doc)
    return (pointed is not None and pointed[1] != owner
            and method in methods_of(pointed[1]))


def complaints(item: Item) -> Iterator[str]:
    """Say what is wrong with the docstring of an item."""
    if explained_elsewhere(item):
        return
    sections = NumpyDocString(item.doc)
    found = {name.strip().replace('\\', ''): ' '.join(entry.desc)
             for section in ('Parameters', 'Other Parameters', 'Attributes')
             for entry in sections[section] for name in entry.name.split(',')}
    if not found:
        if not item.brief and len(item.arguments) > MOST:
            yield f'{item.where}: {len(item.arguments)} arguments and no section Parameters'
        elif not item.brief:
            yield from (f'{item.where}: {name} is not spoken of' for name, kind
                        in item.arguments.items() if not named(name, kind, item.doc))
        return
    for name in item.arguments:
        if name not in found and not item.brief:
            yield f'{item.where}: {name} is not documented'
    stated = ','.join(entry.name for entry in sections['Parameters']).replace('\\', '').split(',')
    for name in (part.strip() for part in stated if part):
        if name not in item.arguments:
            yield f'{item.where}: {name} is documented, but is no argument'
    for name, text in found.items():
        if len(re.findall(r"[\w']+", re.sub(r' \[[^\]]*\]', ' unit', text))) < LEAST_WORDS:
            yield f'{item.where}: {name} is explained by {text!r}'


def all_complaints(text: str, place: str) -> list[str]:
    """Check a module."""
    return [line for item in items(text, place) for line in complaints(item)]


def test_every_public_argument_is_explained() -> None:
    """No argument is undocumented, none is explained in two words."""
    files = sorted(PACKAGE.rglob('*.py'))
    found = [line for file in files for line in all_complaints(
        file.read_text(encoding='utf-8'), file.relative_to(PACKAGE).as_posix())]
    assert len(files) > 150
    assert not found, '\n'.join(found)


@pytest.mark.parametrize('name', td.__all__)
def test_the_library_has_sections(name: str) -> None:
    """What ``td`` offers explains all arguments one by one, also those of its methods."""
    home = getattr(td, name).__module__.removeprefix('tudor_dynamics.').replace('.', '/') + '.py'
    text = (PACKAGE / home).read_text(encoding='utf-8')
    for item in items(text, home):
        if item.where.rpartition(' ')[2].partition('.')[0] == name and item.arguments and (
                not explained_elsewhere(item)):
            documented = NumpyDocString(item.doc)
            assert documented['Parameters'] or documented['Attributes'], item.where


SAMPLE = '''
def {name}(arm: {kind}, seconds: float) -> None:
    """
    Do something.

    Parameters
    ----------
    arm : {kind}
        {text}
    {other} : float
        How long it takes [s].

    """
'''


@pytest.mark.parametrize('changes, count', [
    ({}, 0), ({'text': 'Arm.'}, 1), ({'text': 'Length [m].'}, 1), ({'other': 'second'}, 2),
    ({'name': '_private', 'text': 'Arm.'}, 0)])
def test_what_is_wrong_is_seen(changes: dict[str, str], count: int) -> None:
    """A missing argument, one that is none, and a description that says nothing are found."""
    words = {'name': 'work', 'kind': 'Arm', 'text': 'Arm that works.', 'other': 'seconds'}
    assert len(all_complaints(SAMPLE.format(**{**words, **changes}), 'sample.py')) == count


@pytest.mark.parametrize('line, count', [
    ('def work(arm: Arm) -> None:\n    """Do."""', 0),
    ('def work(x: float) -> None:\n    """Do."""', 1),
    ('def work(x: float) -> None:\n    """Double x [m]."""', 0),
    ('def work(a: Arm, b: Arm, c: Arm) -> None:\n    """Do."""', 1),
    ('@compiled\ndef work(a, b, c):\n    """Do."""', 0),
    ('class A:\n    def at(self, x):\n        """Put in; see ``Model``."""', 0),
    ('class A:\n    def up(self, x):\n        """Put in; see ``Model``."""', 1),
    ('class Model:\n    def at(self, x):\n        """Put in; see ``Model``."""', 1),
    ('@dataclass\nclass Row:\n    """Row."""\n    width: float', 1)])
def test_lines_that_say_too_little_are_seen(line: str, count: int) -> None:
    """One line is enough for little, and only where it speaks of it."""
    assert len(all_complaints(line, 'sample.py')) == count
