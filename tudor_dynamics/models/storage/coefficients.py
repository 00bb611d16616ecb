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

"""Base parameters with their estimates to plain values and back, checked on the way in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base_parameters import BaseSet
from tudor_dynamics.models.estimation.estimators import Estimate
from tudor_dynamics.models.estimation.torque_constants import Constants
from tudor_dynamics.models.regressor import Regressor
from tudor_dynamics.models.storage.parts import GroupPart
from tudor_dynamics.models.units import column_unit
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Group:
    """Base parameters of a group of channels with their estimate."""

    base: BaseSet  # base parameters of the channels
    estimate: Estimate  # their values with standard errors
    # Torque constants that were found with them, where the channels share parameters up to these.
    constants: Constants | None = None


def on_all_columns(groups: Sequence[Group], regressor: Regressor) -> FloatArray:
    """Spread base parameters over the columns of a regressor; returns (channels, columns)."""
    full = np.zeros((len(regressor.channels), len(regressor.columns)))
    for group in groups:
        for i, channel in enumerate(group.base.channels):
            full[channel, group.base.kept] = group.estimate.parameters
            if group.constants is not None:
                full[channel, regressor.scaled] /= group.constants.values[i]
    return full


def groups_to_list(
    groups: tuple[Group, ...], regressor: Regressor, arm: Arm, output: str,
) -> list[dict[str, Any]]:
    """Turn base parameters into plain values."""
    found = []
    for group in groups:
        names = tuple(regressor.channels[i] for i in group.base.channels)
        found.append({
            'channels': list(names),
            'condition': float(group.estimate.condition),
            'residual_std': [float(np.sqrt(v)) for v in group.estimate.variances],
            **({} if group.constants is None else {'torque_constants': [
                {'channel': name, 'value': float(value), 'relative_error': float(error)}
                for name, value, error in zip(names, group.constants.values,
                                              group.constants.relative_errors, strict=True)]}),
            'coefficients': [
                {'name': name, 'column': regressor.columns[column],
                 'value': float(value), 'standard_error': float(error),
                 'unit': column_unit(arm, output, names, regressor.columns[column]),
                 'excited': k not in group.estimate.unexcited}
                for k, (name, column, value, error) in enumerate(zip(
                    group.base.names, group.base.kept, group.estimate.parameters,
                    group.estimate.standard_errors, strict=True))]})
    return found


def groups_of(
    parts: tuple[GroupPart, ...], regressor: Regressor, arm: Arm, output: str,
) -> tuple[Group, ...]:
    """Make base parameters of what was read."""
    index = {name: i for i, name in enumerate(regressor.columns)}
    channels = {name: i for i, name in enumerate(regressor.channels)}
    listed = [name for part in parts for name in part.channels]
    if sorted(listed) != sorted(channels):
        msg = f'{output} channels {listed} where {list(channels)} were expected'
        raise ModelError(msg)
    groups = []
    for part in parts:
        rows = part.coefficients
        unknown = [row.column for row in rows if row.column not in index]
        if unknown:
            msg = f'parameter {unknown[0]!r} does not exist in the arm {arm.name!r}'
            raise ModelError(msg)
        constants = part.torque_constants and Constants(
            np.array([item.value for item in part.torque_constants]),
            np.array([item.relative_error for item in part.torque_constants]))
        groups.append(Group(
            BaseSet(tuple(channels[name] for name in part.channels),
                    np.array([index[row.column] for row in rows], dtype=np.intp),
                    tuple(row.name for row in rows)),
            Estimate(np.array([row.value for row in rows]),
                     np.array([row.standard_error for row in rows]), part.condition,
                     tuple(k for k, row in enumerate(rows) if not row.excited),
                     np.array(part.residual_std) ** 2), constants or None))
    return tuple(groups)
