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

"""The tools that count: what they call a return, a line of code, a number with a source."""

from __future__ import annotations

import ast
import os
from pathlib import Path
import subprocess
import sys

from tools import nodes_reference, returns, said, size

MODULE = '''# A comment.

"""
Module about a load.

Notes
-----
One.

"""

import math

GAIN = -2.0
"""From bench/gain.py."""
LOW, HIGH = 1, math.pi


class Plan:
    """A class."""

    def payload(self) -> float:
        """Give it."""
        return GAIN
'''


def test_returns_are_moves_to_files_seen_before() -> None:
    """Neither the first look into a file nor a call within it counts; the way back does."""
    walk = returns.Walk()
    walk.call(('a.py', 'f'))
    for _ in range(2):
        walk.call(('b.py', 'g'))
        walk.call(('b.py', 'h'))
        walk.leave()
        walk.leave()
    walk.leave()
    assert walk.files == {'a.py', 'b.py'} and (walk.moves, walk.returns) == (5, 3)
    assert walk.causes == {(('a.py', 'f'), ('b.py', 'g')): 3}
    assert [line.strip() for line in walk.tree] == [
        '+ a.py:f', '+ b.py:g', 'b.py:h', '< back in a.py', '< b.py:g', 'b.py:h', '< back in a.py']


def test_an_arm_is_followed() -> None:
    """The walk begins where the arm is loaded, and is the same every time."""
    first, second = (returns.walk_through('load_arm') for _ in range(2))
    assert first.tree == second.tree and first.tree[0].endswith(':load_arm')
    assert first.returns == sum(first.causes.values()) > 0
    assert f'load_arm: {first.returns} returns' in returns.report('load_arm', first, False)


def test_size_of_a_module(tmp_path: Path) -> None:
    """Every figure of a small module, and what two of the same count together."""
    package = tmp_path / 'tudor_dynamics'
    for room in ('one', 'two'):
        (package / room).mkdir(parents=True)
        (package / room / 'module.py').write_text(MODULE)
    (package / '__init__.py').write_text("__all__ = ['Plan']\n")
    (package / 'two' / '__init__.py').write_text('')
    (tmp_path / 'test' / 'one').mkdir(parents=True)
    (tmp_path / 'test' / 'one' / 'test_module.py').write_text('import math\n\nassert math.pi\n')
    found = size.measure(package / 'one' / 'module.py', package)
    # The string after a number is code as the parser has it, and its comment.
    assert (found.lines, found.code, found.docstrings, found.sections) == (24, 6, 10, 4)
    assert (found.public, found.named, found.about, found.small) == (1, 1, 0, 1)
    assert (found.numbers, found.sourced) == (2, 1)
    starred = 'A, *REST = B = 1, 2, 3'
    assert list(size.numbers(ast.parse(starred), [starred])) == [('A', starred)]
    text = size.report(tmp_path)
    assert 'exported by the package: 1 names; public: 2' in text
    assert 'numbers: 4 in 2 files, 2 with a source' in text
    assert '1 classes have a name that another has:\n   Plan' in text
    assert all(len(line) <= 80 for line in text.splitlines())


def test_the_reference_has_all_of_a_node() -> None:
    """Topics, services, parameters with default and range, and diagnostics of each node."""
    text = nodes_reference.page('monitor')
    assert [line for line in text.splitlines() if line.startswith('#')] == [
        '## Subscribed', '## Published', '## Services', '## Parameters', '## Diagnostics']
    assert "made by tudor fit | `''` |" in text and '| s | 0 .. 60 |' in text


def test_what_is_said_is_collected(root: Path, tmp_path: Path) -> None:
    """An error of a command in a test is kept, once for each kind of text."""
    for name in (1, 2):
        (tmp_path / f'test_{name}.py').write_text(
            'from tudor_dynamics.cli.main import main\n\n\ndef test_error():\n'
            f"    assert main(['info', '{tmp_path}/no_{name}']) == 2\n")
    file = tmp_path / 'said.jsonl'
    subprocess.run([sys.executable, '-m', 'pytest', '-q', '-p', 'tools.said', str(tmp_path)],
                   check=True, cwd=root, env=os.environ | {said.FILE: str(file)})
    [(kind, text)] = said.kinds_of(file)
    assert kind == 'error' and text.startswith('tudor info: ') and 'no such file' in text
