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

from dataclasses import dataclass
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.base import Range
from tudor_dynamics.models.base_parameters import BaseSet
from tudor_dynamics.models.estimation.estimators import Estimate
from tudor_dynamics.models.estimation.torque_constants import Constants
from tudor_dynamics.models.regressor import Regressor
from tudor_dynamics.models.units import column_unit

MAX_COEFFICIENT = 1e15
"""Beyond it, one rad or A stands above all digits of a double: no fit gives that."""


@dataclass(frozen=True, eq=False)
class Group:
    """
    Base parameters of a group of channels with their estimate.

    Attributes
    ----------
    base : BaseSet
        Base parameters of the channels.
    estimate : Estimate
        Their values with standard errors.
    constants : Constants or None
        Torque constants that were found with them, where the channels share parameters up to
        these.

    """

    base: BaseSet
    estimate: Estimate
    constants: Constants | None = None


def plausible(values: Any) -> bool:
    """
    Say whether all numbers of a model are finite and far from overflowing anything.

    Parameters
    ----------
    values : array
        Numbers of a model, as they were read.

    """
    return bool(np.all(np.abs(values) <= MAX_COEFFICIENT))  # NaN is not


def payloads_of(content: dict[str, Any]) -> Range:
    """
    Read the payloads that a model was fitted to.

    Parameters
    ----------
    content : dict
        Plain values of a model of all payloads.

    Returns
    -------
    (float, float)
        Smallest and largest [kg].

    Raises
    ------
    ModelError
        If they are no range of masses.

    """
    low, high = (float(value) for value in content['payload_range'])
    if not 0.0 <= low < high <= MAX_COEFFICIENT:
        msg = f'payload range {low} to {high} kg; expected two masses'
        raise ModelError(msg)
    return low, high


def has_constants(content: dict[str, Any]) -> bool:
    """
    Say whether channels of a model share their parameters up to torque constants.

    Parameters
    ----------
    content : dict
        Plain values of an analytical model.

    """
    return any('torque_constants' in item for item in content['groups'])


def groups_to_list(
    groups: tuple[Group, ...], regressor: Regressor, arm: Arm, output: str,
) -> list[dict[str, Any]]:
    """
    Turn base parameters into plain values.

    Parameters
    ----------
    groups : tuple of Group
        Estimates of each group of channels.
    regressor : Regressor
        Rows that they belong to.
    arm : Arm
        Arm, for the units.
    output : {'effort', 'strain'}
        What they predict.

    Returns
    -------
    list of dict
        For each group its channels and coefficients.

    """
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


def groups_from_list(
    content: list[dict[str, Any]], regressor: Regressor, arm: Arm, output: str,
) -> tuple[Group, ...]:
    """
    Read base parameters from plain values.

    Parameters
    ----------
    content : list of dict
        As from `groups_to_list`.
    regressor : Regressor
        Rows that they belong to.
    arm : Arm
        Arm that they were estimated for.
    output : {'effort', 'strain'}
        What they predict.

    Returns
    -------
    tuple of Group
        Estimates of each group of channels.

    Raises
    ------
    ModelError
        If columns or channels are not those of the arm, or a number is not finite.

    """
    index = {name: i for i, name in enumerate(regressor.columns)}
    groups = []
    for item in content:
        channels = tuple(regressor.channels.index(name) for name in item['channels'])
        rows = item['coefficients']
        unknown = [row['column'] for row in rows if row['column'] not in index]
        if unknown:
            msg = f'parameter {unknown[0]!r} does not exist in the arm {arm.name!r}'
            raise ModelError(msg)
        values = np.array([float(row['value']) for row in rows])
        errors = np.array([float(row['standard_error']) for row in rows])
        if not plausible(values) or np.any(np.isnan(errors)):
            msg = (f'a coefficient of {item["channels"]} is not finite, or beyond '
                   f'{MAX_COEFFICIENT:g}')
            raise ModelError(msg)
        base = BaseSet(channels, np.array([index[row['column']] for row in rows], dtype=np.intp),
                       tuple(str(row['name']) for row in rows))
        unexcited = tuple(k for k, row in enumerate(rows) if not row['excited'])
        noise = np.array([float(v) for v in item['residual_std']])
        if len(noise) != len(channels) or not plausible(noise) or np.any(noise < 0.0):
            msg = f'residual_std {noise.tolist()} of {item["channels"]}; expected 0 or more each'
            raise ModelError(msg)
        groups.append(Group(base, Estimate(values, errors, float(item['condition']), unexcited,
                                           noise ** 2), _constants(item, len(channels))))
    listed = sorted(channel for group in groups for channel in group.base.channels)
    if listed != list(range(len(regressor.channels))):
        msg = f'{output} channels {listed} where {list(regressor.channels)} were expected'
        raise ModelError(msg)
    return tuple(groups)


def _constants(content: dict[str, Any], channels: int) -> Constants | None:
    rows = content.get('torque_constants')
    if rows is None:
        return None
    values = np.array([float(row['value']) for row in rows])
    errors = np.array([float(row['relative_error']) for row in rows])
    bounded = (plausible(values) and plausible(1.0 / values) if np.all(values > 0.0) else False)
    if [row['channel'] for row in rows] != content['channels'] or not bounded or np.any(
            ~(errors >= 0.0)):
        msg = (f'torque_constants {values.tolist()} of {content["channels"]}; expected one above '
               '0 for each')
        raise ModelError(msg)
    return Constants(values, errors)
