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

"""D-H rows as a table in a file: text, CSV or YAML."""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import Any

from tudor_dynamics.bounded_yaml import load_yaml
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import read_bounded

MAX_BYTES = 100_000
MAX_ROWS = 101
"""A hundred joints and a flange."""
LARGEST_ANGLE = 2 * math.pi + 1e-6
"""An angle of a table that is larger was given in degrees [rad]."""
KINDS = ('revolute', 'continuous', 'prismatic')
QUARTERS = re.compile(r'([+-]?)(\d+(?:\.\d+)?\*)?pi(?:/(\d+(?:\.\d+)?))?')
EXPECTED = ('expected rows `a alpha d theta` [m, rad, m, rad], base first, with the name of the '
            'joint before and prismatic behind them where need be; angles may be written pi/2')


@dataclass(frozen=True)
class DhRow:
    """One row of a table."""

    values: tuple[float, float, float, float]  # a, alpha, d and theta [m, rad, m, rad]
    joint: str = ''  # name of its joint; empty where the table does not say
    kind: str = ''  # how it moves; empty where the table does not say


@dataclass(frozen=True)
class Table:
    """A table of D-H rows."""

    rows: tuple[DhRow, ...]  # one a joint, base first
    convention: str = 'standard'  # `standard` or `modified`


def _number(word: str) -> float | None:
    found = QUARTERS.fullmatch(word)
    if found is not None:
        value = math.pi * float((found[2] or '1*')[:-1]) / float(found[3] or 1.0)
        return -value if found[1] == '-' else value
    try:
        return float(word)
    except ValueError:
        return None


def _row(words: list[str], where: str) -> DhRow:
    numbers = [_number(word) for word in words]
    joint = words.pop(0) if numbers and numbers[0] is None else ''
    kind = words.pop() if words and words[-1] in KINDS else ''
    values = [_number(word) for word in words]
    if len(values) != 4 or any(value is None or not math.isfinite(value) for value in values):
        raise ArmError(f'{" ".join(words)[:60]!r} is no row of a D-H table', place=where,
                       remedy=EXPECTED)
    a, alpha, d, theta = (float(value) for value in values if value is not None)
    if max(abs(alpha), abs(theta)) > LARGEST_ANGLE:
        raise ArmError(f'an angle of {max(alpha, theta, key=abs):g} looks like degrees',
                       place=where, remedy='give radians; pi/2 may be written so')
    return DhRow((a, alpha, d, theta), joint, kind)


def _from_yaml(content: Any, path: str) -> Table:
    content = content.get('kinematics', content) if isinstance(content, dict) else content
    convention = content.get('convention', 'standard') if isinstance(content, dict) else 'standard'
    rows = content.get('dh') if isinstance(content, dict) else content
    if not isinstance(rows, list) or convention not in ('standard', 'modified'):
        raise ArmError('no D-H rows', place=path, remedy=EXPECTED)
    return Table(tuple(
        _row([str(word) for word in row] if isinstance(row, list) else [],
             f'{path}, row {number}') for number, row in enumerate(rows[:MAX_ROWS + 1], start=1)),
        convention)


def read_table(path: Path) -> Table:
    """Read a table of D-H rows."""
    try:
        text = read_bounded(path, MAX_BYTES).decode()
    except (OSError, ValueError) as err:
        cause = getattr(err, 'strerror', None) or err
        raise ArmError(f'the D-H table cannot be read ({cause})', place=path,
                       remedy='check --dh') from None
    if path.suffix in ('.yaml', '.yml'):
        try:
            table = _from_yaml(load_yaml(text), str(path))
        except ArmError:
            raise
        except ValueError as err:
            raise ArmError(str(err), place=path) from None
    else:
        lines = [(number, line.partition('#')[0].replace(',', ' ').split())
                 for number, line in enumerate(text.splitlines(), start=1)]
        table = Table(tuple(_row(words, f'{path}, line {number}') for number, words in lines
                            if words and not _is_head(words)))
    if not 0 < len(table.rows) <= MAX_ROWS:
        raise ArmError(f'{len(table.rows)} D-H rows', place=path, remedy=EXPECTED)
    return table


def _is_head(words: list[str]) -> bool:
    return 'alpha' in [word.lower() for word in words]
