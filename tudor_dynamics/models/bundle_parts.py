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

"""Parts of a bundle's head, and coefficients as plain values, checked on the way in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator,
    ValidationError)

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec, validation_message
from tudor_dynamics.errors import ModelError
from tudor_dynamics.models.estimation import Constants, Estimate
from tudor_dynamics.models.regressor import BaseSet, column_unit, Regressor
from tudor_dynamics.typing import FloatArray


# -- Parts of a bundle's head: what stands where, and which values a fit can have written there

MAX_COEFFICIENT = 1e15
"""Beyond it, one rad or A stands above all digits of a double: no fit gives that."""


def _within(value: float) -> float:
    if not abs(value) <= MAX_COEFFICIENT:  # NaN is not
        msg = f'{value:g}, which no fit gives: not finite, or beyond {MAX_COEFFICIENT:g}'
        raise ValueError(msg)
    return value


def _known(value: float) -> float:
    if math.isnan(value):
        raise ValueError('not finite, nor unknown')
    return value


def _size(value: float) -> float:
    if not 0.0 <= value <= MAX_COEFFICIENT:
        raise ValueError('expected 0 or more')
    return value


def _masses(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= value[0] < value[1] <= MAX_COEFFICIENT:
        raise ValueError(f'payload range {value[0]} to {value[1]} kg; expected two masses')
    return value


Coefficient = Annotated[float, AfterValidator(_within)]
Deviation = Annotated[float, AfterValidator(_known)]
Noise = Annotated[float, AfterValidator(_size)]
Payloads = Annotated[tuple[float, float], AfterValidator(_masses)]
Text = Annotated[str, BeforeValidator(str)]
Flag = Annotated[bool, BeforeValidator(bool)]
Whole = Annotated[int, BeforeValidator(int)]
Found = TypeVar('Found', bound='BundlePart')


class BundlePart(BaseModel):
    """Base of all parts: immutable; keys that only people read are passed over."""

    model_config = ConfigDict(frozen=True, extra='ignore')


class CoefficientPart(BundlePart):
    """A coefficient on one column, with its standard error: infinite where it is not shown."""

    column: Text
    value: Coefficient
    standard_error: Deviation


class BasePart(CoefficientPart):
    """A base parameter."""

    name: Text
    excited: Flag


class ConstantPart(BundlePart):
    """Torque constant of a joint, relative to that of others."""

    channel: str
    value: Annotated[float, Field(ge=1.0 / MAX_COEFFICIENT, le=MAX_COEFFICIENT)]
    relative_error: Annotated[float, Field(ge=0.0)]


class GroupPart(BundlePart):
    """Base parameters of channels that share them."""

    channels: tuple[str, ...]
    condition: float
    residual_std: tuple[Noise, ...]
    coefficients: tuple[BasePart, ...]
    torque_constants: tuple[ConstantPart, ...] | None = None

    @model_validator(mode='after')
    def _each(self) -> GroupPart:
        if len(self.residual_std) != len(self.channels):
            raise ValueError(f'residual_std of {len(self.residual_std)} channels; expected 0 or '
                             f'more for each of {list(self.channels)}')
        constants = self.torque_constants
        if constants is not None and tuple(item.channel for item in constants) != self.channels:
            raise ValueError(f'torque_constants; expected one for each of {list(self.channels)}')
        return self


class AnalyticalPart(BundlePart):
    """Analytical model."""

    estimator: Text
    form: Text | None = None
    groups: tuple[GroupPart, ...]

    @property
    def shared(self) -> bool:
        """Whether channels share their parameters up to torque constants."""
        return any(group.torque_constants is not None for group in self.groups)


class PayloadPart(AnalyticalPart):
    """Analytical model of all payloads."""

    payload_range: Payloads


class ElmPart(BundlePart):
    """ELM, whose arrays stand in a file of their own."""

    channels: tuple[str, ...]
    hidden: Whole
    ridge: float
    seed: Whole
    clip: Flag


class PayloadElmPart(ElmPart):
    """ELM of all payloads."""

    payload_range: Payloads


class PhysicalPart(BundlePart):
    """Physical parameter of an elastic model; without an error where it was not searched."""

    name: Text
    value: Coefficient
    unit: Text
    standard_error: float | None
    shown: Flag


class ChannelPart(BundlePart):
    """Coefficients of one channel of an elastic model."""

    channel: Text
    residual_std: Noise
    coefficients: tuple[CoefficientPart, ...]


class ElasticPart(BundlePart):
    """Elastic model, of one payload or of all."""

    physical: tuple[PhysicalPart, ...]
    channels: tuple[ChannelPart, ...]
    payload_range: Payloads | None = None


class BentPart(BundlePart):
    """Links that bend, with a model of the strain by where they are."""

    cutoff: Annotated[float, Field(gt=0.0, le=1e5)]
    bending: tuple[tuple[Coefficient, ...], ...]
    density: tuple[tuple[Coefficient, ...], ...]
    model: dict[str, Any]


class ModelsPart(BundlePart):
    """Models, with the preprocessing that they were fitted to."""

    preprocessing: PreprocessingSpec
    outputs: dict[Literal['effort', 'strain'], dict[str, dict[str, Any]]]


class ArmPart(BundlePart):
    """What the arm was when the models were fitted."""

    digest: str


class HeadPart(ModelsPart):
    """The head itself; `facts` are read by those who know of them."""

    arm: ArmPart
    files: dict[str, str]
    causal: ModelsPart | None = None
    data: dict[str, tuple[str, ...]] = {}
    facts: dict[str, Any] = {}


def read(part: type[Found], content: Any, context: dict[str, Any] | None = None) -> Found:
    """Read a part from plain values."""
    try:
        return part.model_validate(content, context=context)
    except ValidationError as err:
        raise ModelError(validation_message(err), remedy='fit the model again') from None


# -- Base parameters with their estimates to plain values and back, checked on the way in

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
