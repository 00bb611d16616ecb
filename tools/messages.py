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
List what the package says to people: errors, warnings, log lines, diagnostics, help, reports.

    python tools/messages.py      how many there are of each kind

Found in the code: strings of three words and more that are no docstring. What a message repeats
stands in braces. `tools/said.py` draws some as they are printed.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
import re

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / 'tudor_dynamics'
ROOMS = {'nodes': 'diagnostic', 'control': 'diagnostic', 'online': 'diagnostic',
         'identification/doctor': 'finding', 'identification/uses.py': 'finding',
         'identification/next_steps.py': 'finding', 'identification/ringdowns.py': 'finding',
         'bags/info.py': 'finding'}
LOGGERS = ('debug', 'info', 'warning', 'warn', 'error', 'fatal')


@dataclass(frozen=True)
class Message:
    """A text, where it stands, and how people meet it."""

    kind: str
    place: str
    text: str


def text_of(node: ast.expr | None) -> str:
    """Give the text of an expression, with what it repeats in braces; choices by a bar."""
    if node is None:
        return ''
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else f'{{{node.value}}}'
    if isinstance(node, ast.JoinedStr):
        return ''.join(text_of(part) for part in node.values)
    if isinstance(node, ast.FormattedValue):
        inner = node.value
        quoted = '!r' * (node.conversion == ord('r'))
        return (f'{{{text_of(inner.body)}|{text_of(inner.orelse)}}}'
                if isinstance(inner, ast.IfExp) else f'{{{ast.unparse(inner)}{quoted}}}')
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Mod)):
        return text_of(node.left) + text_of(node.right)
    if isinstance(node, ast.IfExp):
        return f'{{{text_of(node.body)}|{text_of(node.orelse)}}}'
    return f'{{{ast.unparse(node)}}}'


def _plain(node: ast.expr) -> str:
    """Give the literal words of a text."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    inner = {ast.JoinedStr: 'values', ast.BinOp: 'left right', ast.IfExp: 'body orelse'}.get(
        type(node), '')
    parts = [getattr(node, name) for name in inner.split()]
    return ' '.join(_plain(part) for item in parts
                    for part in (item if isinstance(item, list) else [item]))


def _name(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else (
        call.func.id if isinstance(call.func, ast.Name) else '')


def _kind(call: ast.Call) -> str | None:
    name = _name(call)
    if re.fullmatch(r'[A-Z]\w*Error', name):
        return 'error'
    if name == 'warn':
        return 'warning'
    if name in LOGGERS and 'get_logger' in ast.unparse(call.func):
        return 'log'
    if name in ('add_argument', 'add_argument_group', 'ArgumentParser', 'add_parser', 'Param'):
        return 'help'
    return None


def _whole(call: ast.Call) -> str:
    """Give an error as people see it: ``place: cause; remedy``."""
    words = {item.arg: text_of(item.value) for item in call.keywords}
    cause = ', '.join(map(text_of, call.args[:1]))
    return ''.join((f'{words["place"]}: ' if 'place' in words else '', cause,
                    f'; {words["remedy"]}' if 'remedy' in words else ''))


def _raised(tree: ast.AST) -> set[str]:
    """Name the variables that an error is raised with: ``msg = ...; raise BagError(msg)``."""
    return {call.args[0].id for call in ast.walk(tree) if isinstance(call, ast.Call)
            and _kind(call) == 'error' and call.args and isinstance(call.args[0], ast.Name)}


def _walk(node: ast.AST, kind: str, file: str) -> Iterator[Message]:
    raised = _raised(node) if isinstance(node, (ast.FunctionDef, ast.Lambda)) else set()
    for child in ast.iter_child_nodes(node):
        inner = kind
        if isinstance(child, ast.Assign) and isinstance(child.targets[0], ast.Name) and (
                child.targets[0].id in raised):
            inner = 'error'
        if isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant):
            continue  # a docstring
        if isinstance(child, ast.keyword) and child.arg in ('help', 'description', 'epilog'):
            inner = 'help'
        if isinstance(child, ast.Call) and (found := _kind(child)) is not None:
            inner = found
            if found == 'error' and child.args and not isinstance(child.args[0], ast.Name):
                yield Message(found, f'{file}:{child.lineno}', ' '.join(_whole(child).split()))
                continue
        if isinstance(child, (ast.Constant, ast.JoinedStr, ast.BinOp, ast.IfExp)):
            text = ' '.join(text_of(child).split())
            plain = _plain(child).strip()
            if len(re.findall(r'[A-Za-z]{2,}', plain)) >= 3 and ' ' in plain and (
                    not plain.startswith(('SELECT', 'PRAGMA'))):
                yield Message(inner, f'{file}:{child.lineno}', text)
                continue
        yield from _walk(child, inner, file)


@cache
def messages(package: Path = PACKAGE) -> list[Message]:
    """List the messages of all modules."""
    found = []
    for file in sorted(package.rglob('*.py')):
        name = str(file.relative_to(package))
        room = next((kind for part, kind in ROOMS.items() if name.startswith(part)), 'report')
        found += _walk(ast.parse(file.read_text(encoding='utf-8')), room, name)
    return found


def main() -> None:
    """Count them."""
    argparse.ArgumentParser(description=__doc__.strip().splitlines()[0]).parse_args()
    for kind, number in Counter(message.kind for message in messages()).most_common():
        print(f'{number:5d} {kind}')


if __name__ == '__main__':
    main()
