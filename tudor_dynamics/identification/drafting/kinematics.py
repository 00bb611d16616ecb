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
from dataclasses import dataclass, field
import math
import os
from pathlib import Path
import re
from typing import Any

import pinocchio as pin

from tudor_dynamics.arm.description import OPEN
from tudor_dynamics.arm.kinematics import (
    ExactAngles, is_prismatic, model_from_dh, model_from_urdf)
from tudor_dynamics.arm.urdf import read_urdf
from tudor_dynamics.errors import ArmError
from tudor_dynamics.files import load_yaml, read_text


MAX_BYTES = 100_000
MAX_ROWS = 101
"""A hundred joints and a flange."""
LARGEST_ANGLE = 2 * math.pi + 1e-6
"""An angle of a table that is larger was given in degrees [rad]."""
KINDS = ('revolute', 'continuous', 'prismatic')
QUARTERS = re.compile(r'([+-]?)(\d+(?:\.\d+)?\*)?pi(?:/(\d+(?:\.\d+)?))?')
EXPECTED = ('expected rows `a alpha d theta` [m, rad, m, rad], base first, with the name of the '
            'joint before and prismatic after them where need be; angles may be written pi/2')


@dataclass(frozen=True)
class DhRow:
    """One row of a table."""

    values: tuple[float, float, float, float]  # a, alpha, d and theta [m, rad, m, rad]
    joint: str = ''  # name of its joint; empty where the table does not say
    kind: str = ''  # how it moves; empty where the table does not say


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
    joint = words.pop(0) if words and _number(words[0]) is None else ''
    kind = words.pop() if words and words[-1] in KINDS else ''
    values = [math.nan if value is None else value for value in map(_number, words)]
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise ArmError(f'{" ".join(words)[:60]!r} is no row of a D-H table', place=where,
                       remedy=EXPECTED)
    a, alpha, d, theta = values
    if max(abs(alpha), abs(theta)) > LARGEST_ANGLE:
        raise ArmError(f'an angle of {max(alpha, theta, key=abs):g} looks like degrees',
                       place=where, remedy='give radians; pi/2 may be written so')
    return DhRow((a, alpha, d, theta), joint, kind)


def _from_yaml(text: str, path: Path) -> tuple[list[Any], str]:
    """Find the rows in YAML, and whether they are standard or modified."""
    try:
        content = load_yaml(text)
    except ValueError as err:
        raise ArmError(str(err), place=path) from None
    if isinstance(content, dict):
        content = content.get('kinematics', content)
    if not isinstance(content, dict):
        content = {'dh': content}
    rows, convention = content.get('dh'), content.get('convention', 'standard')
    if not isinstance(rows, list) or convention not in ('standard', 'modified'):
        raise ArmError('no D-H rows', place=path, remedy=EXPECTED)
    return rows, convention


def read_table(path: Path) -> tuple[list[DhRow], str]:
    """Read D-H rows, one a joint, base first, and whether they are standard or modified."""
    text = read_text(path, MAX_BYTES, 'the D-H table', ArmError, 'check --dh')
    if path.suffix in ('.yaml', '.yml'):
        found, convention = _from_yaml(text, path)
        lines = [(f'row {number}', list(map(str, row)) if isinstance(row, list) else [])
                 for number, row in enumerate(found[:MAX_ROWS + 1], start=1)]
    else:
        split = [line.partition('#')[0].replace(',', ' ').split() for line in text.splitlines()]
        convention = 'standard'
        lines = [(f'line {number}', words) for number, words in enumerate(split, start=1)
                 if words and 'alpha' not in map(str.lower, words)]
    rows = [_row(words, f'{path}, {where}') for where, words in lines]
    if not 0 < len(rows) <= MAX_ROWS:
        raise ArmError(f'{len(rows)} D-H rows', place=path, remedy=EXPECTED)
    return rows, convention


@dataclass(frozen=True)
class DraftedChain:
    """Kinematics with the names of their joints."""

    content: dict[str, Any]  # as it stands in a description
    joints: tuple[str, ...]  # all that can move, base first
    model: pin.Model | None = None  # None where nothing is known of the kinematics
    has_masses: bool = False  # whether the links have masses, as those of a URDF
    name: str = ''  # of the robot, where the kinematics say
    note: str = ''  # what the user should know of them
    kinds: dict[str, str] = field(default_factory=dict)  # joint to its type, where a table says

    def slides(self, joint: str) -> bool:
        """Say whether a joint moves along its axis."""
        return self.model is not None and is_prismatic(self.model, joint)


def chain_of_urdf(path: Path, out: Path) -> DraftedChain:
    """Take the kinematics of a URDF."""
    snapped = ExactAngles()
    text = read_urdf(path)
    model = model_from_urdf(text, str(path), snapped)
    joints = tuple(model.names)[1:]
    if not joints:
        raise ArmError('no joint of this URDF moves', place=path, remedy='give the URDF of an arm')
    relative = os.path.relpath(path.resolve(), out.parent.resolve())
    masses = any(inertia.mass > 0.0 for inertia in list(model.inertias)[1:])
    return DraftedChain({'urdf': relative}, joints, model, masses, model.name, snapped.note())


def chain_of_table(path: Path | None, names: Sequence[str]) -> DraftedChain:
    """Take the kinematics of a table of D-H rows, or leave them open."""
    if path is None:
        return DraftedChain({'dh': OPEN}, tuple(names))
    rows, convention = read_table(path)
    flange = int(convention == 'modified' and len(rows) == len(names) + 1)
    joints = [row.joint for row in rows[:len(rows) - flange]]
    if not all(joints):
        joints = list(names)
    if len(joints) + flange != len(rows) or not set(joints) <= set(names):
        raise ArmError(
            f'{len(rows)} rows for the joints {", ".join(names)} of the bag', place=path,
            remedy='give a row a joint, base first, with its name before the numbers')
    model = model_from_dh([row.values for row in rows], joints,
                          [row.kind or 'revolute' for row in rows], convention)
    content: dict[str, Any] = {'dh': [list(row.values) for row in rows]}
    if convention != 'standard':
        content['convention'] = convention
    kinds = {joint: row.kind for joint, row in zip(joints, rows, strict=False) if row.kind}
    note = '' if all(row.joint for row in rows[:len(joints)]) else (
        f'the rows of {path} are taken as those of {", ".join(joints)}, base first, as the bag '
        'names them: make sure of it')
    return DraftedChain(content, tuple(joints), model, note=note, kinds=kinds)
