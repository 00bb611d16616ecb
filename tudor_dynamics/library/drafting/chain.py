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

"""The kinematics of a first description: from a URDF, from D-H rows, or left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import os
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.angles import Snapped
from tudor_dynamics.arm.kinematics import is_prismatic, model_from_dh
from tudor_dynamics.arm.open_values import OPEN
from tudor_dynamics.arm.urdf import model_from_urdf, read_urdf
from tudor_dynamics.errors import ArmError
from tudor_dynamics.library.drafting.dh_table import read_table, Table

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
    snapped = Snapped()
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
