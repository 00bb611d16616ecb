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
Collect what commands and nodes say while the tests run, as people see it; then draw some.

    TUDOR_SAID=said.jsonl make test PYTEST_ARGS="-p tools.said"
    python tools/said.py said.jsonl --sample 40 --seed 7

Errors and warnings of commands, diagnoses of nodes that are not OK, findings of the doctor. Two
that differ in numbers, paths or names of topics and outputs alone count once.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
from pathlib import Path
import random
import re
from typing import Any

FILE = 'TUDOR_SAID'  # environment variable: where the messages of a run of tests go
LEVELS = {b'\x01': 'WARN', b'\x02': 'ERROR', b'\x03': 'STALE'}


def keep(kind: str, text: str) -> None:
    """Append a message; lines of several processes do not mix."""
    line = json.dumps({'kind': kind, 'text': text}) + '\n'
    number = os.open(os.environ[FILE], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    with contextlib.closing(os.fdopen(number, 'wb', buffering=0)) as file:
        file.write(line.encode())


def _before(owner: Any, name: str, note: Any) -> None:
    """Let a function be noted before it does what it does."""
    original = getattr(owner, name)

    def noted(*args: Any, **options: Any) -> Any:
        note(*args)
        return original(*args, **options)
    setattr(owner, name, noted)


def pytest_configure(config: Any) -> None:
    """Listen where commands and nodes speak."""
    if FILE not in os.environ:
        return
    from tudor_dynamics.cli import console, evaluate, fit, info, main
    from tudor_dynamics.nodes.common import base

    def findings(found: Any) -> None:
        for item in found:
            text = io.StringIO()
            with contextlib.redirect_stdout(text):
                original([item])
            keep('finding', text.getvalue().strip())
    original = console.print_findings
    for module in (evaluate, fit, info):
        _before(module, 'print_findings', findings)
    _before(main, 'complain', lambda text: keep('error', text))
    _before(main, '_show_warning',
            lambda message, *_: keep('warning', f'warning: {message}'))
    _before(base.TudorNode, '_log', lambda node, level, message: level in LEVELS and keep(
        'diagnostic', f'{node.get_name()}: {LEVELS[level]}: {message}'))


def kinds_of(file: Path) -> list[tuple[str, str]]:
    """Give one message of each kind of text."""
    found: dict[str, tuple[str, str]] = {}
    for line in file.read_text(encoding='utf-8').splitlines():
        item = json.loads(line)
        text = re.sub(r'/tmp/\S*/', '', item['text'])
        kind = re.sub(r'\'[^\']*\'|\S*[\d_/]\S*|strain( and effort)?|effort', '#', text)
        found.setdefault(kind, (item['kind'], text))
    return sorted(found.values())


def main() -> None:
    """Draw some."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('file', type=Path)
    parser.add_argument('--sample', type=int, default=40, metavar='N', help='draw so many')
    parser.add_argument('--seed', type=int, default=0)
    args = parser.parse_args()
    found = kinds_of(args.file)
    print(f'{len(found)} different messages')
    for kind, text in random.Random(args.seed).sample(found, min(args.sample, len(found))):
        print(kind, *text.splitlines(), sep='\n    ')


if __name__ == '__main__':
    main()
