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

"""Reading arm descriptions: YAML, checked against the schema and against the kinematics."""

from __future__ import annotations

from pathlib import Path
from typing import Any
import warnings

import numpy as np
import pinocchio as pin
from pydantic import ValidationError

from tudor_dynamics.arm.angles import Snapped
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import is_prismatic, model_from_dh
from tudor_dynamics.arm.open_values import check_no_open_values
from tudor_dynamics.arm.schema import ArmSpec
from tudor_dynamics.arm.urdf import model_from_urdf, read_urdf
from tudor_dynamics.bounded_yaml import load_yaml
from tudor_dynamics.errors import ArmError, check_type, TudorWarning
from tudor_dynamics.files import read_bounded

MAX_YAML_BYTES = 2_000_000
MAX_PARTS = 8
"""Mistakes that one message names."""


def validation_message(err: ValidationError) -> str:
    """Put a pydantic error on one line: each key, what is wrong, what was found."""
    parts = []
    for item in err.errors(include_url=False):
        where = '.'.join(str(part) for part in item['loc']) or 'top level'
        text = str(item.get('ctx', {}).get('error', item['msg']))
        if item['type'] == 'extra_forbidden':
            text = 'unknown key (misspelt?)'
        found = item.get('input')
        shown = '' if isinstance(found, (dict, list)) or item['type'] == 'missing' else (
            f', found {_short(repr(found))}')
        parts.append(f'{_short(where)}: {text}{shown}')
    more = f'; and {len(parts) - MAX_PARTS} more' if len(parts) > MAX_PARTS else ''
    return '; '.join(parts[:MAX_PARTS]) + more


def _short(text: str) -> str:
    return text if len(text) <= 100 else f'{text[:100]}...'


def _check_against_model(spec: ArmSpec, model: pin.Model, source: str) -> None:
    known = list(model.names)[1:]
    for joint in spec.joints:
        if joint.name not in known:
            msg = (f'{source}: joint {joint.name!r} is not in the kinematics, '
                   f'whose joints are {known}; correct joints[].name')
            raise ArmError(msg)
    for joint in spec.joints:
        prismatic = is_prismatic(model, joint.name)
        if joint.type is not None and prismatic != (joint.type == 'prismatic'):
            found = 'prismatic' if prismatic else 'revolute'
            msg = (f'{source}: joint {joint.name!r} is described as {joint.type}, '
                   f'but is {found} in the kinematics')
            raise ArmError(msg)
        wrong = {'N m': prismatic, 'N': not prismatic}.get(joint.effort.unit, False)
        if wrong:
            kind, unit = ('prismatic', 'N') if prismatic else ('revolute', 'N m')
            msg = (f'{source}: joint {joint.name!r} is {kind} and has effort unit '
                   f'{joint.effort.unit!r}; expected {unit!r} or A')
            raise ArmError(msg)
        for gauge in spec.gauges:
            if prismatic and gauge.joint == joint.name and gauge.axis is None:
                msg = (f'{source}: gauge {gauge.name!r} is behind the prismatic joint '
                       f'{joint.name!r}, about whose axis nothing bends; give gauges[].axis')
                raise ArmError(msg)


def arm_from_dict(content: Any, *, base: Path, source: str) -> Arm:
    """
    Check a description and build its models.

    Parameters
    ----------
    content : dict
        The description as it stands in YAML.
    base : Path
        Directory that file names in the description are relative to.
    source : str
        Where the description came from, for messages.

    Returns
    -------
    Arm
        Checked description with its models.

    Raises
    ------
    ArmError
        If a key is unknown or missing, a value impossible, or the kinematics do not fit.

    """
    if not isinstance(content, dict):
        msg = f'{source}: expected a YAML mapping with name, kinematics and joints'
        raise ArmError(msg)
    check_no_open_values(content, source)
    try:
        spec = ArmSpec.model_validate(content)
    except ValidationError as err:
        msg = f'{source}: {validation_message(err)}'
        raise ArmError(msg) from None
    urdf, snapped = None, Snapped()
    if spec.kinematics.urdf is not None:
        urdf = read_urdf(base / spec.kinematics.urdf)
        model = model_from_urdf(urdf, str(base / spec.kinematics.urdf), snapped)
    else:
        rows = spec.kinematics.dh
        assert rows is not None  # the schema has one of the two
        exact = [(a, snapped.take(alpha, f'alpha of row {number}'), d,
                  snapped.take(theta, f'theta of row {number}'))
                 for number, (a, alpha, d, theta) in enumerate(rows, start=1)]
        model = model_from_dh(exact, [joint.name for joint in spec.joints],
                              [joint.type or 'revolute' for joint in spec.joints],
                              spec.kinematics.convention)
    _check_against_model(spec, model, source)
    model.gravity = pin.Motion(np.array(spec.gravity), np.zeros(3))
    note = snapped.note()
    return Arm(spec, model, source, urdf, (note,) if note else ())


def load_arm(path: str | Path) -> Arm:
    """
    Read an arm description.

    Parameters
    ----------
    path : str or Path
        YAML file, see ``config/tudor.yaml``.

    Returns
    -------
    Arm
        Checked description with its models.

    Raises
    ------
    ArmError
        If the file cannot be read or is wrong; the message names file, key and expectation.

    """
    check_type(path, (str, Path), 'path', 'the path of a YAML file')
    path = Path(path)
    try:
        text = read_bounded(path, MAX_YAML_BYTES).decode()
    except OSError as err:
        msg = (f'{path}: the arm description cannot be read ({err.strerror}); check --arm, or '
               'write one with `tudor init`')
        raise ArmError(msg) from None
    except ValueError as err:  # no UTF-8, or a NUL in the path
        msg = f'{path}: the arm description cannot be read ({err}); check --arm'
        raise ArmError(msg) from None
    try:
        content = load_yaml(text)
    except ValueError as err:
        msg = f'{path}: {err}'
        raise ArmError(msg) from None
    arm = arm_from_dict(content, base=path.parent, source=str(path))
    for note in arm.notes:
        warnings.warn(f'{path}: {note}', TudorWarning, stacklevel=2)
    return arm
