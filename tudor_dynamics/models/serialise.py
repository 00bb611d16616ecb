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

"""Models to plain values and arrays and back, each checked on the way in."""

from __future__ import annotations

from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import ModelError, NotFittedError
from tudor_dynamics.models.analytical import AnalyticalModel, Group
from tudor_dynamics.models.base_parameters import BaseSet
from tudor_dynamics.models.elm import ExtremeLearningMachine
from tudor_dynamics.models.estimators import Estimate
from tudor_dynamics.models.payload import (
    payload_regressor, PayloadELM, PayloadModel, PayloadRegressor)
from tudor_dynamics.models.regressor import EffortRegressor, StrainRegressor
from tudor_dynamics.models.units import column_unit, output_units
from tudor_dynamics.typing import FloatArray

MAX_HIDDEN = 100_000
MAX_COEFFICIENT = 1e15
"""Beyond it, one rad or A stands above all digits of a double: no fit gives that."""
ELM_ARRAYS = ('input_range', 'output_range', 'input_weights', 'biases', 'output_weights')


def analytical_to_dict(model: AnalyticalModel, arm: Arm, output: str) -> dict[str, Any]:
    """
    Turn a fitted analytical model into plain values.

    Parameters
    ----------
    model : AnalyticalModel
        Model that was fitted.
    arm : Arm
        Arm, for the units.
    output : {'effort', 'strain'}
        What the model predicts.

    Returns
    -------
    dict
        Estimator, form, and for each group of channels its coefficients.

    """
    model.coefficients()  # raises if there are none
    units = output_units(arm, output)
    groups = []
    for group in model.groups_:
        names = tuple(model.channels[i] for i in group.base.channels)
        groups.append({
            'channels': list(names),
            'condition': float(group.estimate.condition),
            'residual_std': [float(np.sqrt(v)) for v in group.estimate.variances],
            'coefficients': [
                {'name': name, 'column': model.regressor.columns[column],
                 'value': float(value), 'standard_error': float(error),
                 'unit': column_unit(arm, output, names, model.regressor.columns[column]),
                 'excited': k not in group.estimate.unexcited}
                for k, (name, column, value, error) in enumerate(zip(
                    group.base.names, group.base.kept, group.estimate.parameters,
                    group.estimate.standard_errors, strict=True))]})
    content: dict[str, Any] = {'estimator': model.estimator, 'units': units}
    plain = (model.regressor.plain if isinstance(model.regressor, PayloadRegressor)
             else model.regressor)
    if isinstance(plain, StrainRegressor):
        content['form'] = plain.form
    if isinstance(model, PayloadModel):
        content['payload_range'] = [float(value) for value in model.payload_range]
    return {**content, 'groups': groups}


def plausible(values: Any) -> bool:
    """
    Say whether all numbers of a model are finite and far from overflowing anything.

    Parameters
    ----------
    values : array
        Numbers of a model, as they were read.

    """
    return bool(np.all(np.abs(values) <= MAX_COEFFICIENT))  # NaN is not


def payloads_from(content: dict[str, Any]) -> tuple[float, float] | None:
    """
    Read the payloads that a model was fitted to.

    Parameters
    ----------
    content : dict
        Plain values of a model.

    Returns
    -------
    tuple of float or None
        Smallest and largest [kg]; None where the model knows of no payload.

    Raises
    ------
    ModelError
        If they are no range of masses.

    """
    if 'payload_range' not in content:
        return None
    low, high = (float(value) for value in content['payload_range'])
    if not 0.0 <= low < high <= MAX_COEFFICIENT:
        msg = f'payload range {low} to {high} kg; expected two masses'
        raise ModelError(msg)
    return low, high


def analytical_from_dict(content: dict[str, Any], arm: Arm, output: str) -> AnalyticalModel:
    """
    Build an analytical model from plain values.

    Parameters
    ----------
    content : dict
        As from `analytical_to_dict`.
    arm : Arm
        Arm it was fitted for.
    output : {'effort', 'strain'}
        What the model predicts.

    Returns
    -------
    AnalyticalModel
        Model that can predict.

    Raises
    ------
    ModelError
        If columns or channels are not those of the arm, or a number is not finite.

    """
    plain = (EffortRegressor(arm) if output == 'effort'
             else StrainRegressor(arm, str(content['form'])))
    payloads = payloads_from(content)
    regressor = plain if payloads is None else payload_regressor(plain, arm)
    index = {name: i for i, name in enumerate(regressor.columns)}
    groups = []
    for item in content['groups']:
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
                                           noise ** 2)))
    listed = sorted(channel for group in groups for channel in group.base.channels)
    if listed != list(range(len(regressor.channels))):
        msg = f'{output} channels {listed} where {list(regressor.channels)} were expected'
        raise ModelError(msg)
    more: dict[str, Any] = {'estimator': str(content['estimator']),
                            'base': tuple(group.base for group in groups)}
    n_joints = len(arm.active_joints)
    model = (PayloadModel(regressor, n_joints, payloads, **more)
             if isinstance(regressor, PayloadRegressor) and payloads is not None
             else AnalyticalModel(regressor, n_joints, **more))
    model.groups_ = tuple(groups)
    return model


def elm_to_arrays(
    model: ExtremeLearningMachine, prefix: str,
) -> tuple[dict[str, Any], dict[str, FloatArray]]:
    """
    Turn a fitted ELM into settings and arrays.

    Parameters
    ----------
    model : ExtremeLearningMachine
        Model that was fitted.
    prefix : str
        Start of the arrays' names.

    Returns
    -------
    settings : dict
        Plain values.
    arrays : dict of str to ndarray
        Weights and ranges.

    """
    if model.output_weights_ is None:
        msg = f'the ELM {prefix} has no weights yet: call fit before saving it'
        raise NotFittedError(msg)
    settings = {'hidden': model.hidden, 'ridge': model.ridge, 'seed': model.seed,
                'clip': model.clip, 'channels': list(model.channels)}
    if isinstance(model, PayloadELM):
        settings['payload_range'] = [float(value) for value in model.payload_range]
    arrays = {f'{prefix}_{name}': np.asarray(getattr(model, f'{name}_')) for name in ELM_ARRAYS}
    return settings, arrays


def elm_from_arrays(
    settings: dict[str, Any],
    arrays: dict[str, FloatArray],
    prefix: str,
    channels: tuple[str, ...],
    n_inputs: int,
) -> ExtremeLearningMachine:
    """
    Build an ELM from settings and arrays.

    Parameters
    ----------
    settings : dict
        As from `elm_to_arrays`.
    arrays : dict of str to ndarray
        Weights and ranges.
    prefix : str
        Start of the arrays' names.
    channels : tuple of str
        Channels of the arm.
    n_inputs : int
        Three times the number of active joints.

    Returns
    -------
    ExtremeLearningMachine
        Model that can predict.

    Raises
    ------
    ModelError
        If an array is missing, of another shape, or not finite.

    """
    hidden = int(settings['hidden'])
    if not 1 <= hidden <= MAX_HIDDEN or list(settings['channels']) != list(channels):
        msg = f'ELM of {hidden} neurons for {settings["channels"]}; expected {list(channels)}'
        raise ModelError(msg)
    more: dict[str, Any] = {'hidden': hidden, 'ridge': float(settings['ridge']),
                            'seed': int(settings['seed']), 'clip': bool(settings['clip'])}
    payloads = payloads_from(settings)
    n_inputs += payloads is not None
    model = (ExtremeLearningMachine(channels, **more) if payloads is None
             else PayloadELM(channels, payloads, **more))
    shapes = {'input_range': (2, n_inputs), 'output_range': (2, len(channels)),
              'input_weights': (n_inputs, hidden), 'biases': (hidden,),
              'output_weights': (hidden, len(channels))}
    for name, shape in shapes.items():
        array = arrays.get(f'{prefix}_{name}')
        if array is None or array.shape != shape or not plausible(array):
            found = 'nothing' if array is None else f'shape {array.shape}'
            msg = (f'elm.npz: {prefix}_{name}: found {found}, expected finite values of {shape}, '
                   f'none beyond {MAX_COEFFICIENT:g}')
            raise ModelError(msg)
        setattr(model, f'{name}_', array)
    return model
