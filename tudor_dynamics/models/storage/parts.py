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

"""Parts of a bundle's head: what stands where, and which values a fit can have written there."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator,
    ValidationError)

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.arm.loading import validation_message
from tudor_dynamics.errors import ModelError

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
