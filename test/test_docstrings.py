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
A docstring says what the signature does not: a summary everywhere, sections where others read.

Sections (``Parameters`` and so on) stand at the names that ``import tudor_dynamics`` gives, at
contracts (abstract classes, protocols), at file formats and at equations of a paper; there they
explain every argument, arrays with their shape. Their methods with one argument or two may do with
a line. Nothing else has sections: units and shapes stand in a line, fields of a dataclass are
commented where they stand. A method that does what its base says needs no words of its own.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
import inspect
from pathlib import Path
import re

from numpydoc.docscrape import NumpyDocString
import pytest

import tudor_dynamics as td

PACKAGE = Path(__file__).resolve().parents[1] / 'tudor_dynamics'
FORMATS = {
    'bags/writer.py', 'control/cascade.py', 'identification/excitation_plan.py',
    'identification/detection.py', 'fleet/study.py', 'bags/trajectory.py',
    'models/base.py', 'models/bundle.py', 'online/threshold_learning.py'}
"""Modules that also define a file format, or what a model has to do: sections may stand there."""
SECTION = re.compile(r'^(Parameters|Other Parameters|Attributes|Returns|Yields|Raises)\n-{3,}$',
                     re.M)
EQUATION = re.compile(r'\bEqs?\. |:math:|\.\. math')
MOST = 2
"""Arguments that a method, a contract or a format may leave to a docstring of one line."""
LEAST_WORDS = 3
"""Of a description; a unit counts as one of them."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Item:
    """A class or function with its docstring."""

    place: str  # file, below the package
    line: int
    name: str  # dotted below the module
    doc: str
    arguments: dict[str, str]  # argument to annotation
    contract: bool  # whether it is part of an abstract class or a protocol

    def __str__(self) -> str:
        return f'{self.place}:{self.line} {self.name}'

    @property
    def public(self) -> bool:
        """Whether no part of its name is private."""
        return not re.search(r'(^|\.)_', self.name)

    @property
    def inherited(self) -> bool:
        """Whether a base class has a docstring for it."""
        owner, _, method = self.name.partition('.')
        if not method or not (PACKAGE / self.place).is_file():
            return False
        module = 'tudor_dynamics.' + self.place.removesuffix('.py').replace('/', '.')
        return any(inspect.getdoc(getattr(base, method, None))
                   for base in getattr(import_module(module), owner).__bases__)

    @property
    def exported(self) -> bool:
        """Whether ``import tudor_dynamics`` gives it, or the class that it belongs to."""
        return self.public and (self.place, self.name.partition('.')[0]) in EXPORTED

    @property
    def allowed(self) -> bool:
        """Whether sections belong there."""
        return (bool(EQUATION.search(self.doc)) or self.exported
                or (self.public and (self.contract or self.place in FORMATS)))


def exported() -> set[tuple[str, str]]:
    """Give file and name of what ``td`` offers, and of what that inherits."""
    found = [getattr(td, name) for name in td.__all__]
    found += [base for value in found if inspect.isclass(value) for base in value.__mro__]
    return {(value.__module__.partition('.')[2].replace('.', '/') + '.py', value.__name__)
            for value in found if value.__module__.startswith('tudor_dynamics.')}


EXPORTED = exported()


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


def fields(node: ast.ClassDef) -> dict[str, str]:
    """Give what makes an object: fields of a dataclass or NamedTuple, arguments of another."""
    marks = ' '.join(ast.unparse(mark) for mark in (*node.decorator_list, *node.bases))
    if 'dataclass' not in marks and 'NamedTuple' not in marks:
        init = [item for item in node.body if isinstance(item, Function)
                and item.name == '__init__']
        return arguments(init[0], method=True) if init else {}
    return {line.target.id: ast.unparse(line.annotation) for line in node.body
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
            and 'ClassVar' not in ast.unparse(line.annotation)
            and not line.target.id.startswith('_') and 'init=False' not in ast.unparse(line)}


def items(text: str, place: str) -> Iterator[Item]:
    """Find the classes and functions of a module, and the methods."""
    def give(node: ast.ClassDef | Function, owner: str, contract: bool) -> Iterator[Item]:
        taken = (fields(node) if isinstance(node, ast.ClassDef)
                 else arguments(node, method=bool(owner)))
        yield Item(place, node.lineno, f'{owner}{node.name}', ast.get_docstring(node) or '', taken,
                   contract)

    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            contract = any(re.search(r'\b(ABC|Protocol)\b', ast.unparse(base))
                           for base in node.bases)
            yield from give(node, '', contract)
            for item in node.body:
                if isinstance(item, Function) and not any(
                        ast.unparse(mark).endswith('.setter') for mark in item.decorator_list):
                    yield from give(item, f'{node.name}.', contract)
        elif isinstance(node, Function):
            yield from give(node, '', False)


def complaints(item: Item) -> Iterator[str]:
    """Say what is wrong with the docstring of an item."""
    if item.public and not item.doc:
        if not item.inherited:
            yield f'{item}: there is no docstring'
    elif SECTION.search(item.doc) and not item.allowed:
        yield f'{item}: sections, where a summary and a line with units are enough'
    elif SECTION.search(item.doc) and item.public:
        yield from unexplained(item)
    elif (item.exported and len(item.arguments) > MOST * ('.' in item.name)
          and not pointed(item)):
        yield f'{item}: no section Parameters, but others call it'
    elif (item.allowed and item.public and item.place not in FORMATS
          and len(item.arguments) > MOST and not pointed(item)):
        yield f'{item}: {len(item.arguments)} arguments and no section Parameters'


def pointed(item: Item) -> bool:
    """Say whether a docstring ends with where else its arguments are explained."""
    return bool(re.search(r'see ``\w+``\.$', item.doc))


def unexplained(item: Item) -> Iterator[str]:
    """Compare the sections of a docstring with the arguments."""
    sections = NumpyDocString(item.doc)
    found = {name.strip().replace('\\', ''): entry
             for section in ('Parameters', 'Other Parameters', 'Attributes')
             for entry in sections[section] for name in entry.name.split(',')}
    for name, annotation in item.arguments.items():
        if name not in found:
            yield f'{item}: {name} is not documented'
        elif re.match(r'(Float|Int)Array|NDArray', annotation) and 'shape' not in found[name].type:
            yield f'{item}: {name} is an array of no shape'
    for entry in sections['Parameters']:
        for name in entry.name.replace('\\', '').split(','):
            if name.strip() not in item.arguments:
                yield f'{item}: {name.strip()} is documented, but is no argument'
    for name, entry in found.items():
        text = ' '.join(entry.desc)
        if len(re.findall(r"[\w']+", re.sub(r' \[[^\]]*\]', ' unit', text))) < LEAST_WORDS:
            yield f'{item}: {name} is explained by {text!r}'


def all_complaints(text: str, place: str) -> list[str]:
    """Check a module."""
    return [line for item in items(text, place) for line in complaints(item)]


def test_docstrings_say_what_the_signature_does_not() -> None:
    """Sections stand where others read them and explain all; nothing public has no docstring."""
    files = {file.relative_to(PACKAGE).as_posix(): file for file in sorted(PACKAGE.rglob('*.py'))}
    found = [line for place, file in files.items()
             for line in all_complaints(file.read_text(encoding='utf-8'), place)]
    assert FORMATS <= set(files)
    assert not found, '\n'.join(found)


SAMPLE = '''
{head}
    """
    Do something{why}.

    Parameters
    ----------
    arm : Arm
        {text}
    {other} : {kind}
        How long it takes [s].

    """
'''
WORDS = {'head': 'def load_arm(arm: Arm, t: FloatArray) -> None:', 'why': '', 'other': 't',
         'text': 'Arm that works.', 'kind': 'ndarray of shape (n,)'}
PLACE = 'arm/description.py'


@pytest.mark.parametrize('changes, count', [
    ({}, 0), ({'text': 'Arm.'}, 1), ({'text': 'Length [m].'}, 1), ({'other': 'second'}, 2),
    ({'kind': 'ndarray'}, 1), ({'head': 'def inner(arm: Arm, t: float):'}, 1),
    ({'head': 'def _inner(arm: Arm, t: float):'}, 1),
    ({'head': 'def inner(arm: Arm, t: float):', 'why': ' by Eq. (3)'}, 0)])
def test_sections_are_complete_and_where_they_belong(changes: dict[str, str], count: int) -> None:
    """A missing argument, an empty description, and sections on internals are found."""
    assert len(all_complaints(SAMPLE.format(**{**WORDS, **changes}), PLACE)) == count


@pytest.mark.parametrize('place, line, count', [
    ('sample.py', 'def work(x: float, y: float, z: float):\n    """Do."""', 0),
    ('sample.py', 'def work():\n    pass', 1),
    ('sample.py', 'def _work():\n    pass', 0),
    ('sample.py', '@dataclass\nclass Row:\n    """Row."""\n    width: float', 0),
    ('sample.py', 'class A(ABC):\n    """A."""\n    def do(self, x, y, z):\n        """Do."""', 1),
    ('sample.py', 'class A:\n    """A."""\n    def do(self, x, y, z):\n        """Do."""', 0),
    ('bags/writer.py', 'def work(x: float, y: float, z: float):\n    """Do."""', 0),
    (PLACE, 'def load_arm(path: Path):\n    """Load."""', 1)])
def test_a_line_is_enough_for_internals_alone(place: str, line: str, count: int) -> None:
    """What others call or implement needs sections, everything public a docstring."""
    assert len(all_complaints(line, place)) == count
