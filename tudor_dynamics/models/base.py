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

"""The contract of models, and the blocks of motion that they learn from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError, TudorWarning
from tudor_dynamics.models.friction import LiveFriction
from tudor_dynamics.signals.preprocessing import Decimation, Stretch
from tudor_dynamics.typing import FloatArray

SAME = 1e-6
"""Payloads that differ by less are the same [kg]."""


# -- What models learn from: blocks of motion with their outputs, checked

@dataclass(frozen=True, eq=False)
class TrainingBlock:
    """Motion and the outputs that belong to it."""

    # `[q, dq, ddq]` of the active joints, in columns, (samples, 3 joints)
    # [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    output: FloatArray  # measured outputs after decimation, (kept, channels)
    # Brings rows of `motion` to rows of `output`; None where they belong together as is.
    decimation: Decimation | None = None


Blocks = Callable[[], Iterable[TrainingBlock]]
Inputs = Callable[[Stretch], FloatArray]
"""What a model takes of a stretch, a row a sample."""


def block_of(motion: FloatArray, output: FloatArray) -> Blocks:
    """
    Wrap two arrays as training data of one block, after a check of their shapes.

    output (samples, channels) [its unit]; motion (samples, inputs): ``[q, dq, ddq]`` and what else
    the model takes, in columns.
    """
    motion, output = np.asarray(motion, dtype=float), np.asarray(output, dtype=float)
    if motion.ndim != 2 or output.ndim != 2 or len(motion) != len(output):
        msg = (f'motion has shape {motion.shape} and output {output.shape}; expected '
               '(n_samples, 3 n_joints) and (n_samples, n_channels)')
        raise FitError(msg)
    if not (np.all(np.isfinite(motion)) and np.all(np.isfinite(output))):
        msg = 'motion or output has values that are not finite; leave such samples out'
        raise FitError(msg)
    return lambda: [TrainingBlock(motion, output)]


def check_block(block: TrainingBlock, n_inputs: int | None, channels: tuple[str, ...]) -> None:
    """
    Refuse a block whose columns are not those of the model.

    n_inputs: None where the model takes any number.
    """
    if n_inputs is not None:
        check_motion(block.motion, n_inputs)
    if block.output.ndim != 2 or block.output.shape[1] != len(channels):
        msg = (f'output has shape {block.output.shape}; expected (n_samples, {len(channels)}) for '
               f'the channels {list(channels)}')
        raise FitError(msg)


def check_motion(motion: FloatArray, n_inputs: int, fewer: int | None = None) -> None:
    """
    Refuse motion whose columns are not those of the model.

    motion (samples, inputs): ``[q, dq, ddq]`` and what else the model takes, in columns.
    """
    if motion.ndim != 2 or motion.shape[1] not in (n_inputs, fewer):
        msg = (f'motion has shape {motion.shape}; expected (n_samples, {n_inputs}): positions, '
               f'velocities, accelerations of {n_inputs // 3} joints')
        raise FitError(msg)


# -- The contract of models: what each of them offers, whatever is inside

Range = tuple[float, float]
"""Least and largest payload [kg]."""
AnyModel = TypeVar('AnyModel', bound='Model')
SLIDING = 0.05
"""Speed at which friction has its sign, and little more than at standstill [rad/s or m/s]."""


@dataclass(frozen=True)
class Conditioning:
    """
    How well the training data showed the parameters of a model.

    Attributes
    ----------
    condition : float
        Largest condition number among its regressions; 1 where it has none.
    unexcited : tuple of str
        Parameters that the motion does not show.

    """

    condition: float = 1.0
    unexcited: tuple[str, ...] = ()


class Live(Protocol):
    """Models of one kind beside a running robot, sample by sample."""

    observing: bool
    """Whether measured strain corrects them."""

    def measure(self, strain: FloatArray) -> None:
        """
        Give the strain that was measured at the newest sample; it counts with the next step.

        Parameters
        ----------
        strain : ndarray of shape (n_gauges,)
            Readings in their units; NaN for a gauge that does not count.

        """

    def step(
        self, dt: float, row: FloatArray, wanted: Collection[str] | None = None,
    ) -> dict[str, FloatArray] | None:
        """
        Go to the next sample and predict.

        Parameters
        ----------
        dt : float
            Time since the sample before [s]; 0 to begin anew, at rest.
        row : ndarray of shape (3 n_joints,)
            ``[q, dq, ddq]`` of one sample [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
        wanted : collection of str, optional
            Outputs that somebody needs; all by default.

        Returns
        -------
        dict of str to ndarray of shape (n_channels,), or None
            Output to values in its units; None where there is no prediction.

        """


class Model(ABC):
    """
    A model that gives one output of an arm for its motion.

    Attributes
    ----------
    has_memory : bool
        Whether it follows whole stretches only; others learn and predict row by row.
    payload_range : (float, float) or None
        Payloads that it was fitted to [kg]; None where it knows of none.
    channels : tuple of str
        Names of its channels.

    """

    has_memory: ClassVar[bool] = True
    payload_range: Range | None = None
    channels: tuple[str, ...]

    @abstractmethod
    def follow(self, stretch: Stretch) -> FloatArray:
        """
        Predict the outputs at all samples of a stretch.

        Parameters
        ----------
        stretch : Stretch
            Motion without a gap.

        Returns
        -------
        ndarray of shape (n_samples, n_channels)
            Outputs in their units.

        """

    def inputs(self, stretch: Stretch) -> FloatArray:
        """
        Give what `predict` takes of a stretch: its motion, unless a kind needs more.

        Parameters
        ----------
        stretch : Stretch
            Motion without a gap.

        Returns
        -------
        ndarray of shape (n_samples, n_inputs)
            ``[q, dq, ddq]`` of the active joints [rad, rad/s, rad/s^2 or m, m/s, m/s^2], and
            what else it takes.

        """
        return stretch.motion

    def trail(self) -> LiveFriction | None:
        """Give the same sample by sample; None where the motion is all."""
        return None

    def follow_kept(self, stretch: Stretch) -> FloatArray:
        """
        Predict the outputs at the samples that decimation keeps.

        Parameters
        ----------
        stretch : Stretch
            Motion without a gap.

        Returns
        -------
        ndarray of shape (n_kept, n_channels)
            Outputs in their units, decimated as measured ones are.

        """
        return stretch.decimation(self.follow(stretch))

    def observe(
        self, stretch: Stretch, strain_model: Model | None = None, observer: str = 'ringing',
    ) -> FloatArray:
        """
        Predict as beside the robot, where measured strain may correct what comes next.

        Parameters
        ----------
        stretch : Stretch
            Motion without a gap, with its strain.
        strain_model : Model, optional
            Model of the same kind by whose strain an effort is corrected.
        observer : {'off', 'ringing'}
            Whether measured strain corrects the model, where the kind can make use of it.

        Returns
        -------
        ndarray of shape (n_samples, n_channels)
            Outputs in their units.

        """
        return self.follow(stretch)

    def predict(self, motion: FloatArray) -> FloatArray:
        """
        Predict samples that have no past; a model with a memory refuses.

        Parameters
        ----------
        motion : ndarray of shape (n_samples, 3 n_joints)
            ``[q, dq, ddq]`` of the active joints, in columns [rad, rad/s, rad/s^2 or m, m/s,
            m/s^2].

        Returns
        -------
        ndarray of shape (n_samples, n_channels)
            Outputs in their units.

        Raises
        ------
        FitError
            If it has a memory.

        """
        msg = (f'{type(self).__name__} has a memory, and samples alone have no past: use follow, '
               'with a gapless stretch')
        raise FitError(msg)

    def conditioning(self) -> Conditioning:
        """Say how well the training data showed its parameters, where it has some."""
        return Conditioning()

    def estimated(self, arm: Arm, output: str) -> list[dict[str, Any]]:
        """
        List the coefficients that mean something by themselves, where it has some.

        Parameters
        ----------
        arm : Arm
            Arm that was recorded, for units.
        output : {'effort', 'strain'}
            What the model predicts.

        Returns
        -------
        list of dict
            For each group of channels that share them: ``channels``, ``condition`` number, and
            ``coefficients`` with ``name``, ``value``, ``standard_error``, ``unit`` and whether
            the motion has ``excited`` them.

        """
        return []

    def stiction(self, q: FloatArray) -> FloatArray:
        """
        Say how far an effort may lie off its prediction while the joint stands.

        A joint that stands keeps whatever friction it has come to rest with, which no motion
        tells: anything up to what friction jumps by where it begins to slide either way.

        Parameters
        ----------
        q : ndarray of shape (n_samples, n_joints)
            Positions of the active joints [rad or m].

        Returns
        -------
        ndarray of shape (n_channels,)
            Half of that jump, the median over the positions, in the unit of each joint's effort;
            zeros for an output that knows no friction.

        """
        return np.zeros(len(self.channels))

    def at(self, payload: float) -> Model:
        """
        Put a payload in.

        Parameters
        ----------
        payload : float
            Mass at the tip [kg].

        Returns
        -------
        Model
            Model of the motion alone; this one itself where it knows of no payloads.

        """
        return self

    @classmethod
    @abstractmethod
    def live(
        cls: type[AnyModel], models: Mapping[str, AnyModel], observer: str = 'off',
    ) -> Live:
        """
        Put models of one arm beside the running robot.

        Parameters
        ----------
        models : mapping of str to Model
            Output to model, all of this kind.
        observer : {'off', 'ringing'}, default='off'
            Whether measured strain corrects them, where the kind can make use of it.

        Returns
        -------
        Live
            The same models, sample by sample.

        """

    @abstractmethod
    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        """
        Turn what was learned into what a bundle keeps.

        Parameters
        ----------
        arm : Arm
            Arm of the bundle, for names and units.
        output : {'effort', 'strain'}
            What the model predicts.

        Returns
        -------
        dict
            Plain values; arrays, which are kept apart, stand in it under names of their own.

        Raises
        ------
        NotFittedError
            If it has learned nothing yet.

        """

    @classmethod
    @abstractmethod
    def from_dict(
        cls: type[AnyModel], content: dict[str, Any], arm: Arm, output: str,
    ) -> AnyModel:
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

        Returns
        -------
        Model
            Model that can predict.

        Raises
        ------
        ModelError
            If it does not belong to the arm, or a number is not finite.

        """


def check_payload(payload: float, known: Range) -> None:
    """Refuse what is no mass, and warn beyond the payloads that a model was fitted to."""
    if not 0.0 <= payload < float('inf'):
        msg = f'a payload of {payload} kg is impossible; give 0 or more'
        raise FitError(msg)
    low, high = known
    if not low - 1e-9 <= payload <= high + 1e-9:
        msg = (f'the payload {payload:g} kg is outside the {low:g} to {high:g} kg that the model '
               'was fitted to: it extrapolates')
        warnings.warn(msg, TudorWarning, stacklevel=3)
