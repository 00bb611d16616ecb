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

"""Elastic models to plain values and back, checked on the way in."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError, NotFittedError
from tudor_dynamics.models.elastic.fitted import driven_arm
from tudor_dynamics.models.elastic.fitted import FittedElastic, PhysicalParameter
from tudor_dynamics.models.elastic.parameters import physical_unit
from tudor_dynamics.models.storage.parts import ElasticPart, read
from tudor_dynamics.models.units import output_units

Elastic = TypeVar('Elastic', bound=FittedElastic)


def elastic_to_dict(model: FittedElastic) -> dict[str, Any]:
    """Turn a fitted elastic model into plain values."""
    if (model.coefficients_ is None or model.standard_errors_ is None
            or model.noise_ is None):
        msg = 'the elastic model has no coefficients yet: fit it before saving it'
        raise NotFittedError(msg)
    content: dict[str, Any] = {
        'units': output_units(model.arm, model.output),
        'physical': [
            {'name': p.name, 'value': float(p.value), 'unit': p.unit,
             'standard_error': None if math.isnan(p.standard_error) else float(p.standard_error),
             'shown': p.shown} for p in model.physical],
        'channels': [
            {'channel': channel, 'residual_std': float(noise),
             'coefficients': [
                 {'column': column, 'value': float(value), 'standard_error': float(error)}
                 for column, value, error in zip(columns, values, errors, strict=True)]}
            for channel, columns, values, errors, noise in zip(
                model.channels, model.columns, model.coefficients_, model.standard_errors_,
                model.noise_, strict=True)]}
    if model.payload_range is not None:
        content['payload_range'] = [float(value) for value in model.payload_range]
    return content


def elastic_from_dict(
    made: type[Elastic], content: dict[str, Any], arm: Arm, output: str,
) -> Elastic:
    """Build an elastic model from plain values."""
    part = read(ElasticPart, content)
    physical = tuple(PhysicalParameter(
        item.name, item.value, item.unit,
        math.nan if item.standard_error is None else item.standard_error, item.shown)
        for item in part.physical)
    model = made(arm, output, physical, payload_range=part.payload_range)
    known = driven_arm(arm, model.values).parameters  # refuses unknown names and values
    for parameter in physical:
        if parameter.name in known and parameter.unit != physical_unit(arm, parameter.name):
            msg = (f'parameter {parameter.name} in {parameter.unit!r}; expected '
                   f'{physical_unit(arm, parameter.name)!r}')
            raise ModelError(msg)
    channels = tuple(item.channel for item in part.channels)
    columns = tuple(tuple(row.column for row in item.coefficients) for item in part.channels)
    if channels != model.channels or columns != model.columns:
        msg = (f'{output} channels {list(channels)} with the columns {list(columns)} where '
               f'{list(model.channels)} with {list(model.columns)} were expected')
        raise ModelError(msg)
    model.coefficients_, model.standard_errors_ = (tuple(
        np.array([getattr(row, value) for row in item.coefficients]) for item in part.channels)
        for value in ('value', 'standard_error'))
    model.noise_ = np.array([item.residual_std for item in part.channels])
    return model
