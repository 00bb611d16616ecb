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
A plan as a folder: the motion as a bag and as a table, and what it is to show as JSON.

``bag`` has one trajectory_msgs/JointTrajectory, ``trajectory.csv`` the same numbers; ``plan.json``
says what was asked for, what the motion keeps to, and the standard errors that it will bring.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.loading import validation_message
from tudor_dynamics.bags.trajectory import read_trajectory, Trajectory, TrajectorySeries
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import UsageError
from tudor_dynamics.excitation.expected import Noise
from tudor_dynamics.excitation.plan import Plan
from tudor_dynamics.files import read_bounded, write_whole

FORMAT, VERSION = 'tudor_dynamics/excitation', 1
HEAD, TABLE, BAG, PICTURE = 'plan.json', 'trajectory.csv', 'bag', 'motion.png'
MAX_HEAD_BYTES = 20_000_000
STAMP = 1_000_000_000
"""Stamp of the only message [ns]; one of zero would mean "not set" in ROS."""


class _Error(BaseModel):
    """One standard error; null where the motion does not show the parameter."""

    model_config = ConfigDict(extra='ignore', frozen=True)
    output: str
    column: str
    standard_error: float | None = Field(ge=0.0, allow_inf_nan=False)


class _Head(BaseModel):
    """What is read of ``plan.json``."""

    model_config = ConfigDict(extra='ignore', frozen=True)
    format: str  # noqa: A003
    version: int
    arm: str
    noise: dict[str, dict[str, float]]
    noise_of: str
    noise_stated: bool
    expected: tuple[_Error, ...] = Field(max_length=100_000)


@dataclass(frozen=True, eq=False)
class PlanFolder:
    """
    A plan that was read.

    Attributes
    ----------
    path : Path
        Folder that it was read from.
    arm : str
        Name of the arm.
    trajectory : Trajectory
        Motion that was planned.
    noise : Noise
        Noise that was stated.
    stated : bool
        Whether anybody stated it.

    """

    path: Path
    arm: str
    trajectory: Trajectory
    noise: Noise
    stated: bool


def plan_head(plan: Plan, arm: Arm, facts: dict[str, Any], *, stated: bool) -> dict[str, Any]:
    """
    Say what is planned as plain values.

    Parameters
    ----------
    plan : Plan
        Motion and what it will show.
    arm : Arm
        Arm that is to move.
    facts : dict
        What was asked for.
    stated : bool
        Whether the noise was stated, or is 1 for want of anything better.

    Returns
    -------
    dict
        Content of ``plan.json``.

    """
    joints = arm.active_joints

    def by_joint(values: Any) -> dict[str, float]:
        return dict(zip(joints, (round(float(value), 6) for value in values), strict=True))
    names = {'effort': joints, 'strain': arm.gauge_names}
    errors = []
    for item in plan.expected:
        row = asdict(item)
        value = row.pop('value')
        errors.append({**row, 'channels': list(item.channels),
                       'standard_error': value if math.isfinite(value) else None})
    return {
        'format': FORMAT, 'version': VERSION, 'arm': arm.name, 'digest': arm.digest, **facts,
        'noise': {output: dict(zip(names[output], size.tolist(), strict=True))
                  for output, size in plan.noise.size.items()},
        'noise_of': 'residuals' if plan.noise.residual else 'samples', 'noise_stated': stated,
        'part_of_limits': {
            'position': by_joint(plan.beyond.position), 'velocity': by_joint(plan.beyond.velocity),
            'acceleration': by_joint(plan.beyond.acceleration),
            'effort': by_joint(plan.beyond.effort)},
        'expected': errors}


def write_plan(folder: Path, plan: Plan, head: dict[str, Any]) -> None:
    """
    Write a plan, but for its picture.

    Parameters
    ----------
    folder : Path
        Folder that is there, and empty.
    plan : Plan
        Motion and what it will show.
    head : dict
        Content of ``plan.json``, see `plan_head`.

    """
    write_whole(folder / TABLE, plan.trajectory.table())
    write_bag(folder / BAG, [TrajectorySeries(
        '/joint_trajectory', np.array([STAMP]), [plan.trajectory])])
    write_whole(folder / HEAD, json.dumps(head, indent=2, allow_nan=False).encode() + b'\n')


def read_motion(path: Path) -> Trajectory:
    """
    Read the motion of a plan.

    Parameters
    ----------
    path : Path
        Folder of a plan, or a table as there is one in it.

    Returns
    -------
    Trajectory
        Motion.

    Raises
    ------
    BagError
        If it cannot be read.

    """
    return read_trajectory(path / TABLE if path.is_dir() else path)


def read_plan(path: str | Path) -> PlanFolder:
    """
    Read a plan.

    Parameters
    ----------
    path : str or Path
        Folder that ``tudor excite`` wrote.

    Returns
    -------
    PlanFolder
        Motion, and the noise that it was judged with.

    Raises
    ------
    UsageError, BagError
        If it is no such folder, or damaged.

    """
    path = Path(path)
    try:
        text = read_bounded(path / HEAD, MAX_HEAD_BYTES).decode()
        head = _Head.model_validate_json(text)
    except OSError as err:
        raise UsageError(f'there is no {HEAD} to be read ({err.strerror})', place=path,
                         remedy='give a folder of `tudor excite`') from None
    except (ValidationError, ValueError) as err:
        cause = validation_message(err) if isinstance(err, ValidationError) else str(err)
        raise UsageError(f'no plan ({cause})', place=path / HEAD) from None
    if (head.format, head.version) != (FORMAT, VERSION):
        raise UsageError(f'found {head.format[:60]} {head.version}, expected {FORMAT} {VERSION}',
                         place=path / HEAD, remedy='plan again with this version')
    noise = {output: np.array(list(values.values())) for output, values in head.noise.items()}
    if not noise or any(not np.all(size > 0.0) or not np.isfinite(size).all()
                        for size in noise.values()):
        raise UsageError('noise: expected a positive number for each channel', place=path / HEAD)
    return PlanFolder(path, head.arm, read_trajectory(path / TABLE),
                      Noise(noise, head.noise_of == 'residuals'), head.noise_stated)
