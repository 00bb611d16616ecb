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
What each tuned number changes: 30 % smaller, 30 % larger, and the figures that come of it.

    python bench/sweep.py                           # the settings of all rooms; hours
    python bench/sweep.py online --only ARMED DWELL # some numbers of a room
    python bench/sweep.py identification --all      # with constants outside settings.py

A copy of the package is changed in one number, runs the cases of its room (``tools/golden.py``)
and is compared with the copy as it was. The table says, for each number and direction, how many
cases differ and the headline figure that changes most: errors, fits, latencies, masses. A number
that changes nothing in any case is not needed, or no case covers it: look before it goes.
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
import re
import shutil
import sys
import tempfile

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / 'tools'))

from golden import differences, load_case, record  # noqa: E402
from golden_cases import Case, ordered, read_table  # noqa: E402

FITTED = ('fit/ols', 'evaluate/json')
CASES = {
    'arm': ('info/blades', 'fit/ols'),
    'bags': ('info/blades', 'fit/ols'),
    'signals': ('fit/rigid', 'record/pushed'),
    'control': ('record/pushed', 'objects/rig', 'tune/description'),
    'mechanics': ('simulate/shape', 'record/pushed'),
    'models': ('fit/rigid', 'fit/elm', 'compare/models'),
    'load': ('payload/json', 'payload/two'),
    'online': ('evaluate/collisions', 'evaluate/free'),
    'identification': ('fit/rigid', 'info/blades'),
    'show': ('fit/ols', 'export/urdf'),
    'fleet': ('fleet/text',),
    'cli': FITTED, 'nodes': ('objects/nodes',)}
"""Cases that a room's numbers are tried on; ``--cases`` names others."""
HEADLINE = re.compile(r'relative_error|\.fit$|latency|\.mass$|rate|standard_error|threshold|exit')
"""Figures that people read; the first that changes most is named."""
SMALLEST = 1e-12
"""Figures smaller than this have no relative change."""


@dataclass(frozen=True)
class Number:
    """A number at the top of a module."""

    file: Path  # below the package
    name: str
    value: float
    line: int
    start: int  # column
    end: int

    def changed(self, factor: float) -> str:
        """Give the literal times a factor; an integer changes by 1 at least."""
        if isinstance(self.value, float):
            return repr(self.value * factor)
        moved = round(self.value * factor)
        return str(moved if moved != self.value else self.value + (1 if factor > 1.0 else -1))


def numbers(package: Path, rooms: list[str], everywhere: bool) -> Iterator[Number]:
    """Find the numbers that are assigned at the top of modules, or are defaults of settings."""
    for file in sorted(package.rglob('*.py')):
        place = file.relative_to(package)
        if (rooms and place.parts[0] not in rooms) or not (
                everywhere or place.name == 'settings.py'):
            continue
        for node in ast.parse(file.read_text(encoding='utf-8')).body:
            fields = node.body if isinstance(node, ast.ClassDef) else [node]
            for item in fields:
                yield from _assigned(place, item)


def _assigned(place: Path, node: ast.stmt) -> Iterator[Number]:
    if isinstance(node, ast.AnnAssign) and node.value is not None:
        targets, values = [node.target], [node.value]
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        pair = isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)
        targets = node.targets[0].elts if pair else node.targets
        values = node.value.elts if pair else [node.value]
    else:
        return
    for target, value in zip(targets, values, strict=True):
        for entry in value.elts if isinstance(value, ast.Tuple) else [value]:
            if isinstance(target, ast.Name) and isinstance(entry, ast.Constant) and type(
                    entry.value) in (int, float) and entry.lineno == entry.end_lineno:
                yield Number(place, target.id, entry.value, entry.lineno - 1, entry.col_offset,
                             entry.end_col_offset or 0)


def largest_change(before: Path, after: Path, cases: list[Case]) -> str:
    """Say how many cases differ, and which headline figure changes most."""
    differ, largest, named = 0, 0.0, ''
    for case in cases:
        old, new = load_case(before, case.name), load_case(after, case.name)
        differ += next(differences(old, new), None) is not None
        for key, value in old.items():
            other = new.get(key)
            if HEADLINE.search(key) and {type(value), type(other)} <= {int, float} and (
                    value != other):
                change = abs(other - value) / max(abs(value), SMALLEST)
                if change > largest:
                    largest, named = change, f'{case.name} {key.removeprefix("stdout:")}'
    if not differ:
        return 'nothing'
    most = f', {100 * largest:.3g} % in {named}' if named else ''
    return f'{differ} of {len(cases)} cases{most}'


def main() -> None:
    """Sweep."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('rooms', nargs='*', help='default: all')
    parser.add_argument('--only', nargs='+', default=[], metavar='NAME')
    parser.add_argument('--all', action='store_true', help='also outside settings.py')
    parser.add_argument('--by', type=float, default=0.3, help='part by which they change')
    parser.add_argument('--cases', nargs='+', default=[], metavar='CASE')
    parser.add_argument('--json', type=Path, help='write the table to this file')
    args = parser.parse_args()
    root, table, rows = HERE.parent, read_table(), []
    with tempfile.TemporaryDirectory(prefix='sweep_') as name:
        tree = Path(name).resolve() / 'tree'
        for folder in ('tudor_dynamics', 'bags', 'config'):
            shutil.copytree(root / folder, tree / folder)
        base: dict[tuple[str, ...], Path] = {}
        for number in numbers(tree / 'tudor_dynamics', args.rooms, args.all):
            if args.only and number.name not in args.only:
                continue
            names = tuple(args.cases or CASES.get(number.file.parts[0], FITTED))
            cases = ordered(table, [item for item in names if item in table])
            if names not in base:
                base[names] = Path(name) / f'base{len(base)}'
                record(base[names], tree, cases)
            file = tree / 'tudor_dynamics' / number.file
            text = file.read_text(encoding='utf-8')
            row = {'file': str(number.file), 'name': number.name, 'value': number.value}
            for sign in (-1.0, 1.0):
                lines = text.splitlines(keepends=True)
                line = lines[number.line]
                lines[number.line] = (line[:number.start] + number.changed(1.0 + sign * args.by)
                                      + line[number.end:])
                file.write_text(''.join(lines), encoding='utf-8')
                after = Path(name) / 'after'
                shutil.rmtree(after, ignore_errors=True)
                record(after, tree, cases)
                row[f'{100 * sign * args.by:+.0f} %'] = largest_change(base[names], after, cases)
            file.write_text(text, encoding='utf-8')
            rows.append(row)
            print('  '.join(str(value) for value in row.values()), flush=True)
            if args.json:
                args.json.write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
