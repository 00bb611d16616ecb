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

"""The contract of models: what they learn from, offer, and keep in a bundle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
import math
from typing import Annotated, Any, ClassVar, Protocol, TypeVar
import warnings

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import validation_message
from tudor_dynamics.errors import FitError, ModelError, TudorWarning
from tudor_dynamics.models.friction import FrictionStates, LiveFriction
from tudor_dynamics.signals.preprocessing import Stretch, TrainingBlock
from tudor_dynamics.typing import FloatArray, Shown

SAME = 1e-6  # payloads that differ by less are the same [kg]
AGAIN = 'fit the model again'


# -- What models learn from: blocks of motion with their outputs, checked

Blocks = Callable[[], Iterable[TrainingBlock]]


def block_of(motion: FloatArray, output: FloatArray) -> Blocks:
    """Wrap two arrays as training data of one block, after a check of their shapes."""
    motion, output = np.asarray(motion, dtype=float), np.asarray(output, dtype=float)
    if motion.ndim != 2 or output.ndim != 2 or len(motion) != len(output):
        raise FitError(f'motion has shape {motion.shape} and output {output.shape}; expected '
                       '(n_samples, 3 n_joints) and (n_samples, n_channels)')
    if not (np.all(np.isfinite(motion)) and np.all(np.isfinite(output))):
        raise FitError('motion or output has NaN or infinite values; leave out such samples')
    return lambda: [TrainingBlock(motion, output)]


def check_block(block: TrainingBlock, n_inputs: int | None, channels: tuple[str, ...]) -> None:
    """Refuse a block whose columns are not those of the model, where it has a number of them."""
    if n_inputs is not None:
        check_motion(block.motion, n_inputs)
    if block.output.ndim != 2 or block.output.shape[1] != len(channels):
        raise FitError(f'output has shape {block.output.shape}; expected (n_samples, '
                       f'{len(channels)}) for the channels {", ".join(channels)}')


def check_motion(motion: FloatArray, n_inputs: int, fewer: int | None = None) -> None:
    """Refuse motion whose columns are not those of the model."""
    if motion.ndim != 2 or motion.shape[1] not in (n_inputs, fewer):
        raise FitError(f'motion has shape {motion.shape}; expected (n_samples, {n_inputs}): '
                       f'positions, velocities, accelerations of {n_inputs // 3} joints')


# -- Parts of a bundle's head: what stands where, and which values a fit can have written there

MAX_COEFFICIENT = 1e15
"""Beyond it, one rad or A stands above all digits of a double: no fit gives that."""


def _within(value: float) -> float:
    if not abs(value) <= MAX_COEFFICIENT:  # NaN is not
        raise ValueError(f'expected a finite number up to {MAX_COEFFICIENT:g} in size')
    return value


def _known(value: float) -> float:
    if math.isnan(value):
        raise ValueError('expected a number, or .inf where the error is unknown')
    return value


def _size(value: float) -> float:
    if not 0.0 <= value <= MAX_COEFFICIENT:
        raise ValueError(f'expected 0 to {MAX_COEFFICIENT:g}')
    return value


def _masses(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= value[0] < value[1] <= MAX_COEFFICIENT:
        raise ValueError(f'{value[0]:g} to {value[1]:g} kg; expected two rising masses from 0 on')
    return value


Coefficient = Annotated[float, AfterValidator(_within)]
Deviation = Annotated[float, AfterValidator(_known)]
Noise = Annotated[float, AfterValidator(_size)]
Payloads = Annotated[tuple[float, float], AfterValidator(_masses)]
Text = Annotated[str, BeforeValidator(str)]
Flag = Annotated[bool, BeforeValidator(bool)]
Whole = Annotated[int, BeforeValidator(int)]
Part = TypeVar('Part', bound='BundlePart')


class BundlePart(BaseModel):
    """Base of all parts: immutable; keys that only people read are passed over."""

    model_config = ConfigDict(frozen=True, extra='ignore')


class CoefficientPart(BundlePart):
    """A coefficient on one column, with its standard error: infinite where it is not shown."""

    column: Text
    value: Coefficient
    standard_error: Deviation


def read(part: type[Part], content: Any, context: dict[str, Any] | None = None) -> Part:
    """Read a part from plain values."""
    try:
        return part.model_validate(content, context=context)
    except ValidationError as err:
        raise ModelError(validation_message(err, add=''), remedy=AGAIN) from None


# -- The contract of models: what each of them offers, whatever is inside

Range = tuple[float, float]  # least and largest payload [kg]
AnyModel = TypeVar('AnyModel', bound='Model')
SLIDING = 0.05
"""Speed at which friction has its sign, and little more than at standstill [rad/s or m/s]."""


@dataclass(frozen=True)
class Conditioning:
    """How well the training data showed the parameters of a model."""

    condition: float = 1.0  # largest among its regressions; 1 where it has none
    unexcited: tuple[str, ...] = ()  # parameters that the motion does not show


class Live(Protocol):
    """Models of one kind beside a running robot, sample by sample."""

    observing: bool
    """Whether measured strain corrects them."""

    def measure(self, strain: FloatArray) -> None:
        """Give the strain (n_gauges,) of the newest sample; NaN where a gauge does not count."""

    def step(
        self, dt: float, row: FloatArray, wanted: Collection[str] | None = None,
    ) -> dict[str, FloatArray] | None:
        """
        Go to the next sample and predict the outputs that are wanted, all by default.

        A dt of 0 restarts, at rest. Gives by output the values (n_channels,) in its units; None
        where there is no prediction.
        """


class Model(Shown, ABC):
    """A model that gives one output of an arm for its motion."""

    # Whether it follows whole stretches only; others learn and predict row by row.
    has_memory: ClassVar[bool] = True
    # Payloads that it was fitted to [kg]; None where it knows of none.
    payload_range: Range | None = None
    channels: tuple[str, ...]  # their names

    @abstractmethod
    def follow(self, stretch: Stretch) -> FloatArray:
        """Predict the outputs, shape (n_samples, n_channels), at all samples of a stretch."""

    def inputs(self, stretch: Stretch) -> FloatArray:
        """Give what `predict` takes of a stretch: ``[q, dq, ddq]``, unless a kind needs more."""
        return stretch.motion

    def trail(self) -> LiveFriction | None:
        """Give the same sample by sample; None where the motion is all."""
        return None

    def follow_kept(self, stretch: Stretch) -> FloatArray:
        """Predict the outputs at the samples that decimation keeps, filtered as measured ones."""
        return stretch.decimation(self.follow(stretch))

    def observe(self, stretch: Stretch) -> FloatArray:
        """Predict as beside the robot, where strain of the samples before corrects some kinds."""
        return self.follow(stretch)

    def predict(self, motion: FloatArray) -> FloatArray:
        """
        Predict samples (n_samples, 3 n_joints) that have no past; gives (n_samples, n_channels).

        Motion is ``[q, dq, ddq]`` of the active joints [rad, rad/s, rad/s^2 or m, m/s, m/s^2],
        outputs have their units. A model with a memory refuses, by a FitError.
        """
        raise FitError(f'{type(self).__name__} needs earlier samples as well, which predict() '
                       'does not have; call follow() with a Stretch (motion without gaps)')

    def conditioning(self) -> Conditioning:
        """Say how well the training data showed its parameters, where it has some."""
        return Conditioning()

    def estimated(self, arm: Arm, output: str) -> list[dict[str, Any]]:
        """
        List the coefficients that mean something by themselves, where it has some.

        For each group of channels that share them: ``channels``, ``condition`` number, and
        ``coefficients`` with ``name``, ``value``, ``standard_error``, ``unit`` (by the arm that
        was recorded, and what is predicted) and whether the motion has ``excited`` them.
        """
        return []

    def stiction(self, q: FloatArray) -> FloatArray:
        """
        Say how far an effort may lie off its prediction while the joint stands.

        A joint that stands keeps whatever friction it stopped with, which no motion
        shows: anything up to what friction jumps by where it begins to slide either way. Gives
        half of that jump (n_channels,), the median over positions (n_samples, n_joints)
        [rad or m], in the unit of each effort; zeros for an output that knows no friction.
        """
        return np.zeros(len(self.channels))

    def at(self, payload: float) -> Model:
        """Give a model of motion alone for a mass [kg] at the tip; itself if it knows none."""
        return self

    @classmethod
    @abstractmethod
    def live(cls: type[AnyModel], models: Mapping[str, AnyModel]) -> Live:
        """Put models of one arm, by output and all of this kind, beside the running robot."""

    @abstractmethod
    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        """
        Turn what was learned of an output into what a bundle of this arm keeps: plain values.

        Arrays, which are kept apart, stand in it under names of their own. A NotFittedError says
        that nothing was learned yet.
        """

    @classmethod
    @abstractmethod
    def from_dict(cls: type[AnyModel], content: dict[str, Any], arm: Arm, output: str) -> AnyModel:
        """
        Build a model from what a bundle keeps, which may come from anywhere.

        Parameters
        ----------
        content : dict
            As from ``to_dict``.
        arm : Arm
            Arm it was fitted for.
        output : {'effort', 'strain'}
            What the model predicts.

        Raises
        ------
        ModelError
            If it does not belong to the arm, or a number is not finite.

        """


def check_payload(payload: float, known: Range) -> None:
    """Refuse what is no mass, and warn beyond the payloads that a model was fitted to."""
    if not 0.0 <= payload < float('inf'):
        raise FitError(f'payload= {payload:g} kg: give 0 or more')
    low, high = known
    if not low - 1e-9 <= payload <= high + 1e-9:
        msg = (f'the load of {payload:g} kg is outside the {low:g} to {high:g} kg that the model '
               'was fitted to: it extrapolates')
        warnings.warn(msg, TudorWarning, stacklevel=3)


# -- Models without a memory: what they learn from rows of motion, and how they follow it

Learner = TypeVar('Learner', bound='MemorylessModel')


@dataclass(frozen=True, kw_only=True, repr=False)
class ModelSettings(Shown):
    """Choices of a fit that its models take; see ``FitSettings``."""

    estimator: str = 'auto'
    strain_form: str = 'exact'
    shared: bool | None = None
    elm_hidden: int = 100
    elm_ridge: float = 1e-6
    elm_seed: int = 0
    payloads: Range | None = None


class MemorylessModel(Model):
    """A model of rows: outputs depend on the motion at their sample, and on states of friction."""

    has_memory = False
    states: FrictionStates | None = None  # of friction that has some

    @classmethod
    @abstractmethod
    def new(cls: type[Learner], arm: Arm, output: str, settings: ModelSettings) -> Learner:
        """Build a model that is not fitted yet."""

    @abstractmethod
    def fit_blocks(self: Learner, blocks: Blocks) -> Learner:
        """Learn from data that come in blocks."""

    def fit_parts(
        self: Learner, parts: Mapping[str, Blocks], known: dict[tuple[str, bool], Any],
    ) -> Learner:
        """Learn from parts, such as bags; what is ``known`` of them serves other models, too."""
        def blocks() -> Iterator[TrainingBlock]:
            for part in parts.values():
                yield from part()

        return self.fit_blocks(blocks)

    def fit(self: Learner, motion: FloatArray, output: FloatArray) -> Learner:
        """Learn from outputs and motion; its last column is the payload [kg] in models of all."""
        return self.fit_blocks(block_of(motion, output))

    @abstractmethod
    def predict(self, motion: FloatArray) -> FloatArray:
        """Predict the outputs, each sample by itself; see ``Model``."""

    def inputs(self, stretch: Stretch) -> FloatArray:
        return stretch.motion if self.states is None else self.states.follow(stretch)

    def trail(self) -> LiveFriction | None:
        return None if self.states is None else LiveFriction(self.states)

    def follow(self, stretch: Stretch) -> FloatArray:
        return self.predict(self.inputs(stretch))

    def follow_kept(self, stretch: Stretch) -> FloatArray:
        """Predict the samples that are kept, without those between where no filter needs them."""
        if stretch.decimation.sections is None:
            return self.predict(stretch.decimation(self.inputs(stretch)))
        return super().follow_kept(stretch)

    def stiction(self, q: FloatArray) -> FloatArray:
        n = q.shape[1]
        if len(self.channels) != n:
            return super().stiction(q)
        motion = np.zeros((2, n, len(q), 3 * n))
        motion[..., :n] = q
        for joint in range(n):
            motion[:, joint, :, n + joint] = np.array([SLIDING, -SLIDING])[:, None]
        y = self.predict(motion.reshape(-1, 3 * n)).reshape(2, n, len(q), n)
        return np.asarray(0.5 * np.median(np.abs(np.einsum('jkj->kj', y[0] - y[1])), axis=0))

    @classmethod
    def live(cls: type[Learner], models: Mapping[str, Learner]) -> Live:
        """Predict row by row; there is no state that strain could correct."""
        return RowByRow(models)


class RowByRow:
    """Models without a memory, sample by sample; see ``Live``."""

    observing = False
    REMEMBERED = ('_trails',)  # of an alarm, see `online.memory`

    def __init__(self, models: Mapping[str, MemorylessModel]) -> None:
        self._models = models
        self._trails = {output: trail for output, model in models.items()
                        if (trail := model.trail()) is not None}

    def measure(self, strain: FloatArray) -> None:
        """Take a strain that corrects nothing."""

    def step(
        self, dt: float, row: FloatArray, wanted: Collection[str] | None = None,
    ) -> dict[str, FloatArray]:
        """Predict one sample; see ``Live``."""
        followed = {output: trail.step(dt, row) for output, trail in self._trails.items()}
        return {output: model.predict(followed.get(output, row)[None])[0]
                for output, model in self._models.items() if wanted is None or output in wanted}
