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

"""Kinematics of a first description: a URDF, a D-H table, or left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import OPEN
from tudor_dynamics.arm.kinematics import (
    ExactAngles, is_prismatic, model_from_dh, model_from_urdf, read_urdf)
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import load_yaml, read_bounded


# -- D-H rows as a table in a file: text, CSV or YAML

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


# -- The kinematics of a first description: from a URDF, from D-H rows, or left open

GRAVITY = (0.0, 0.0, -9.81)
"""Of a base that stands upright [m/s^2]."""


@dataclass(frozen=True)
class DraftedChain:
    """Kinematics with the names of their joints."""

    content: dict[str, Any]  # as it stands in a description
    joints: tuple[str, ...]  # all that can move, base first
    model: pin.Model | None = None  # None where nothing is known of the kinematics
    has_masses: bool = False  # whether the links have masses, as those of a URDF
    name: str = ''  # of the robot, where the kinematics say
    note: str = ''  # what the user should know of them
    kinds: tuple[str, ...] = ()  # type of each joint where a table says

    def slides(self, joint: str) -> bool:
        """Say whether a joint moves along its axis."""
        return self.model is not None and is_prismatic(self.model, joint)

    def index(self, joints: Sequence[str]) -> list[int]:
        """Give the places of joints in the model's configuration."""
        assert self.model is not None
        return [int(self.model.joints[self.model.getJointId(joint)].idx_q) for joint in joints]


def chain_of_urdf(path: Path, out: Path) -> DraftedChain:
    """Take the kinematics of a URDF."""
    snapped = ExactAngles()
    text = read_urdf(path)
    model = model_from_urdf(text, str(path), snapped)
    model.gravity = pin.Motion(np.array(GRAVITY), np.zeros(3))
    joints = tuple(model.names)[1:]
    if not joints:
        raise ArmError('no joint of this URDF moves', place=path, remedy='give the URDF of an arm')
    relative = os.path.relpath(path.resolve(), out.parent.resolve())
    masses = any(inertia.mass > 0.0 for inertia in list(model.inertias)[1:])
    return DraftedChain({'urdf': relative}, joints, model, masses, model.name, snapped.note())


def _from_table(path: Path, table: Table, names: Sequence[str]) -> DraftedChain:
    rows = table.rows
    flange = int(table.convention == 'modified' and len(rows) == len(names) + 1)
    joints = [row.joint for row in rows[:len(rows) - flange]]
    if not all(joints):
        joints = list(names)
    if len(joints) + flange != len(rows) or not set(joints) <= set(names):
        raise ArmError(
            f'{len(rows)} rows for the joints {", ".join(names)} of the bag', place=path,
            remedy='give a row a joint, base first, with its name before the numbers')
    kinds = tuple(row.kind for row in rows)
    model = model_from_dh([row.values for row in rows], joints,
                          [kind or 'revolute' for kind in kinds], table.convention)
    model.gravity = pin.Motion(np.array(GRAVITY), np.zeros(3))
    content: dict[str, Any] = {'dh': [list(row.values) for row in rows]}
    if table.convention != 'standard':
        content['convention'] = table.convention
    note = '' if all(row.joint for row in rows[:len(joints)]) else (
        f'the rows of {path} are taken as those of {", ".join(joints)}, base first, as the bag '
        'names them: make sure of it')
    return DraftedChain(content, tuple(joints), model, note=note, kinds=kinds)


def chain_of(
    urdf: Path | None, dh: Path | None, names: Sequence[str], out: Path,
) -> DraftedChain:
    """Take the kinematics of a URDF or a table, or leave them open."""
    if urdf is not None:
        return chain_of_urdf(urdf, out)
    if dh is not None:
        return _from_table(dh, read_table(dh), names)
    return DraftedChain({'dh': OPEN}, tuple(names))
