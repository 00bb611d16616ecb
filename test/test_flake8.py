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
Style of the code: ament_flake8 where ROS has it, otherwise the same rules by ruff.

What ruff lacks comes from where flake8 has it: indentation of continued lines from pycodestyle,
and the order of imports, which ruff would wrap in its own way, from flake8-import-order.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import cache
import importlib.util
from pathlib import Path
import re
import subprocess
import sys

import pytest

PLACES = ('tudor_dynamics', 'papers', 'test', 'bench', 'examples', 'setup.py')
BODY = re.compile('^(?:def|class|async|@)', re.MULTILINE)
"""Where imports end."""


def ruff(root: Path, *words: str | Path) -> str:
    """Give what ruff complains about."""
    run = subprocess.run([sys.executable, '-m', 'ruff', 'check', '--no-cache', '--quiet',
                          '--output-format', 'concise', '--config', root / 'ruff.toml', *words],
                         capture_output=True, text=True)
    assert run.returncode in (0, 1) and not run.stderr, f'pip install -e .[test]: {run.stderr}'
    return run.stdout


@cache
def google() -> object:
    """Look a style up, once."""
    from flake8_import_order.styles import lookup_entry_point
    return lookup_entry_point('google')


def order(file: Path) -> Iterator[str]:
    """Give what is wrong with the order of imports in a file, and with lines between them."""
    from flake8_import_order.checker import ImportOrderChecker
    text = file.read_text(encoding='utf-8')
    body = BODY.search(text)
    head = text[:body.start()] if body else text
    try:
        tree = ast.parse(head)
    except SyntaxError:  # that was a line of a docstring
        head, tree = text, ast.parse(text)
    checker = ImportOrderChecker(str(file), tree)
    checker.lines = head.splitlines(keepends=True)
    checker.options = {'import_order_style': google()}
    for error in checker.check_order():
        if error.code != 'I202':  # lines within a group: the package stands apart from others
            yield f'{file}:{error.lineno}: {error.code} {error.message}\n'


def continued(files: Iterable[Path], report: pytest.CaptureFixture[str]) -> str:
    """Give what is wrong with the indentation of continued lines."""
    import pycodestyle
    guide = pycodestyle.StyleGuide(ignore=['E121', 'E123', 'E126'])  # as by default
    guide.options.physical_checks = []
    guide.options.logical_checks = [check for check in guide.options.logical_checks
                                    if check[0] == 'continued_indentation']
    guide.options.ast_checks = []
    assert len(guide.options.logical_checks) == 1
    for file in files:
        guide.input_file(str(file))
    return report.readouterr().out


@pytest.mark.flake8
@pytest.mark.linter
def test_flake8(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:
    """No file breaks ROS 2's code style, with the settings of setup.cfg and ruff.toml."""
    monkeypatch.chdir(root)
    places = [Path(place) for place in PLACES if Path(place).exists()]
    if importlib.util.find_spec('ament_flake8'):
        from ament_flake8.main import main_with_errors
        code, errors = main_with_errors(argv=['--config', 'setup.cfg', *map(str, places)])
        assert code == 0, '\n'.join(errors)
        return
    files = sorted(file for place in places
                   for file in ([place] if place.is_file() else place.rglob('*.py')))
    assert len(files) > 500
    wrong = ruff(root, '--extend-ignore', 'D', *places)
    wrong += ''.join(error for file in files for error in order(file))
    wrong += continued(files, capsys)
    assert not wrong, wrong


@pytest.mark.filterwarnings('ignore:invalid escape:DeprecationWarning')
@pytest.mark.skipif(not importlib.util.find_spec('ruff'), reason='ament_flake8 does without')
@pytest.mark.parametrize(('code', 'wrong'), [
    ('', ''),
    ('import sys\nfrom os import path\nprint(sys, path)', 'I100'),
    ('from os import path, environ\nprint(environ, path)', 'I101'),
    ('import yaml\n\nimport os\nprint(os, yaml)', 'I100'),
    ('import os\nimport yaml\nprint(os, yaml)', 'I201'),
    ('from abc import ABC\nimport os\nfrom os.path import join\n\nimport Yaml\nimport zmq\n'
     'print(ABC, os, join, Yaml, zmq)', ''),
    ('import os', 'unused-import'),
    ('print(none)', 'undefined-name'),
    ("print('%s %s' % (1,))", 'percent-format-positional-count-mismatch'),
    ('print("a")', 'bad-quotes-inline-string'),
    (f"print('{'a ' * 45}')", ''),
    (f"print('{'a ' * 46}')", 'line-too-long'),
    ('max = 1', 'builtin-variable-shadowing'),
    ('def f(min):\n    return min', 'builtin-argument-shadowing'),
    ('print(list(a for a in (1, 2)))', 'unnecessary-generator-list'),
    ('print(1 )', 'whitespace-before-close-bracket'),
    ('a=1', 'missing-whitespace-around-operator'),
    ('print(1,2)', 'missing-whitespace'),
    ('print(1)  #no', 'no-space-after-inline-comment'),
    ('def f():\n    pass\nprint(f)', 'blank-lines-after-function-or-class'),
    ('def f():\n  pass', 'indentation-with-invalid-multiple'),
    ('if 1: pass', 'multiple-statements-on-one-line-colon'),
    ('print(1) ', 'trailing-whitespace'),
    ('print(1)\n', 'too-many-newlines-at-end-of-file'),
    ('try:\n    pass\nexcept:\n    pass', 'bare-except'),
    ("print('\\d', rb'\\d')", 'invalid-escape-sequence'),
    ('print(1,\n  2)', 'E128'),
    ('if (1 and\n    2):\n    pass', 'E129'),
    ('print(\n    1,\n      2)', 'E131'),
])
def test_what_breaks_the_style_is_found(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, wrong: str,
) -> None:
    """One fault in a file is found, and alone; where there is none, nothing is."""
    file = tmp_path / 'code.py'
    file.write_text(f'{code}\n' if code else '')
    found = [*ruff(root, '--extend-ignore', 'D', file).splitlines(), *order(file),
             *continued([file], capsys).splitlines()]
    assert len(found) == bool(wrong) and wrong in ''.join(found), found
