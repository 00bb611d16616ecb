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

"""Messages of errors: one line, whatever they repeat."""

from __future__ import annotations

import ast
from pathlib import Path
import pickle
import re

import tudor_dynamics
from tudor_dynamics.errors import BagError, MAX_MESSAGE, TudorError

SEARCHES = ('startswith', 'endswith', 'removeprefix', 'removesuffix', 'partition', 'rpartition',
            'find', 'index')


def test_messages_are_one_line() -> None:
    """Line ends, control characters and endless names of a file do not get into a terminal."""
    assert str(BagError('a\n  b\x1b[2J: ä')) == 'a b?[2J: ä'
    assert str(TudorError('y' * 9999)) == 'y' * MAX_MESSAGE + '...'
    assert str(TudorError()) == ''


def test_errors_travel_between_processes() -> None:
    """What a worker raises arrives as it was."""
    err = pickle.loads(pickle.dumps(BagError('no such bag', place='run1', remedy='record')))
    assert isinstance(err, BagError) and str(err) == 'run1: no such bag; record'
    assert (err.cause, err.place, err.remedy) == ('no such bag', 'run1', 'record')


def test_programs_read_attributes() -> None:
    """Cause, place and remedy are data; a place is given once, by who knows it best."""
    err = BagError('empty; or not', remedy='record again')
    assert err.place is None and err.advice == str(err) == 'empty; or not; record again'
    placed = err.at('run: 1')
    assert isinstance(placed, BagError) and str(placed) == 'run: 1: empty; or not; record again'
    assert placed.at('elsewhere') is placed and placed.advice == err.advice
    assert (placed.cause, placed.remedy) == (err.cause, err.remedy)


def test_no_program_compares_messages() -> None:
    """What an error or a note says is for people: no module looks for words in it."""
    found = []
    for file in Path(tudor_dynamics.__file__).parent.rglob('*.py'):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Attribute) and node.attr in SEARCHES:
                words = ast.unparse(node.value)
            elif isinstance(node, ast.Compare) and isinstance(node.ops[0], (ast.In, ast.NotIn)):
                words = ast.unparse(node.comparators[0])
            else:
                continue
            if re.search(r"str\(\w*(err|error|exc)\)|\bnotes?\.texts\b|\['msg'\]", words):
                found.append(f'{file.name}:{node.lineno}: {ast.unparse(node)}')
    assert found == []
