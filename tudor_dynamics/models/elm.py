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
Extreme Learning Machine: a random hidden layer and a linear output, the papers' benchmark.

Malzahn et al., Eqs. (16), (17): ``y = W_out sigma(W_in x + b)`` with logistic neurons, input
weights and biases uniform in [-1, 1], inputs and outputs normalised to [-1, 1], and ``W_out`` from
ridge regression with lambda.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import numpy as np
from scipy import linalg

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import check_budget, FitError, ModelError, NotFittedError
from tudor_dynamics.models.base import (
    AGAIN, Blocks, BundlePart, check_block, check_motion, check_payload, Flag, MAX_COEFFICIENT,
    MemorylessModel, ModelSettings, Payloads, Range, read, Whole)
from tudor_dynamics.signals.preprocessing import TrainingBlock
from tudor_dynamics.typing import FloatArray

ROWS_AT_A_TIME = 2048
MAX_HIDDEN = 100_000
ARRAYS = ('input_range', 'output_range', 'input_weights', 'biases', 'output_weights')


class ElmPart(BundlePart):
    """ELM, whose arrays stand in a file of their own."""

    channels: tuple[str, ...]  # joints or gauges
    hidden: Whole  # neurons
    ridge: float  # regularisation
    seed: Whole  # of the random weights
    clip: Flag  # whether inputs are limited to the range of the training
    payload_range: Payloads | None = None  # of a model of all payloads [kg]


class ExtremeLearningMachine(MemorylessModel):
    """Random-feature regression from motion to outputs."""

    # Inputs beyond the range seen in training are brought back to its edge. The paper does not say
    # so, but without it spikes in an acceleration throw the output far off: the hidden neurons
    # extrapolate linearly, with large weights of opposite signs.

    # Smallest and largest values in the training data, (2, n).
    input_range_: FloatArray
    output_range_: FloatArray
    # W_in (inputs, hidden) and b (hidden,) of Eq. (16), drawn at random.
    input_weights_: FloatArray
    biases_: FloatArray
    output_weights_: FloatArray | None  # W_out of Eq. (17), which is learned, (hidden, channels)

    def __init__(
        self, channels: tuple[str, ...], *, hidden: int = 100, ridge: float = 1e-6, seed: int = 0,
        clip: bool = True, payload_range: Range | None = None,
    ) -> None:
        self.channels = channels
        self.hidden = hidden  # neurons H
        self.ridge = ridge  # lambda of Eq. (17)
        self.seed = seed  # of the hidden layer
        self.clip = clip  # whether inputs are kept within the range of the training data
        self.payload_range = payload_range  # of a model with a payload as last input [kg]
        self.output_weights_ = None

    def __repr__(self) -> str:
        """Write outputs, size and seed."""
        state = '' if self.output_weights_ is not None else ', not fitted'
        return (f'{type(self).__name__}({", ".join(self.channels)}; {self.hidden} hidden neurons, '
                f'ridge {self.ridge:g}, seed {self.seed}{state})')

    @classmethod
    def new(cls, arm: Arm, output: str, settings: ModelSettings) -> ExtremeLearningMachine:
        return cls(arm.channels[output], hidden=settings.elm_hidden,
                   ridge=settings.elm_ridge, seed=settings.elm_seed,
                   payload_range=settings.payloads)

    def fit_blocks(self, blocks: Blocks) -> ExtremeLearningMachine:
        for name, value, least in (
                ('hidden', self.hidden, 1), ('ridge', self.ridge, 0), ('seed', self.seed, 0)):
            if not value >= least:
                raise FitError(f'elm_{name}= {value}: give {least} or more')
        check_budget(f'{self.hidden} neurons', self.hidden, 16.0 * self.hidden, 'take fewer')
        lows: list[FloatArray] = []
        highs: list[FloatArray] = []
        for block in blocks():
            check_block(block, None, self.channels)
            kept = (block.motion if block.decimation is None
                    else block.motion[block.decimation.keep])
            both = [kept, block.output]
            lows.append(np.concatenate([x.min(axis=0) for x in both]))
            highs.append(np.concatenate([x.max(axis=0) for x in both]))
        if not lows:
            raise FitError('no training data for the ELM; give more or longer bags')
        limits = np.stack([np.min(lows, axis=0), np.max(highs, axis=0)])
        n_inputs = limits.shape[1] - len(self.channels)
        self.output_weights_ = None  # what was learned before goes with the ranges before
        self.input_range_, self.output_range_ = limits[:, :n_inputs], limits[:, n_inputs:]
        generator = np.random.default_rng(self.seed)
        self.input_weights_ = generator.uniform(-1.0, 1.0, (n_inputs, self.hidden))
        self.biases_ = generator.uniform(-1.0, 1.0, self.hidden)
        gram = np.zeros((self.hidden, self.hidden))
        moment = np.zeros((self.hidden, len(self.channels)))
        for block in blocks():
            for features, output in self._rows(block):
                gram += features.T @ features
                moment += features.T @ _normalise(output, self.output_range_)
        gram[np.diag_indices(self.hidden)] += self.ridge
        try:
            self.output_weights_ = linalg.solve(gram, moment, assume_a='pos')
        except linalg.LinAlgError:
            msg = f'the hidden layer is singular with ridge {self.ridge}; use a ridge above 0'
            raise FitError(msg) from None
        return self

    def predict(self, motion: FloatArray) -> FloatArray:
        weights = self._weights()
        motion = np.asarray(motion, dtype=float)
        check_motion(motion, self.input_range_.shape[1])
        output = np.empty((len(motion), len(self.channels)))
        low, high = self.output_range_
        for first in range(0, len(motion), ROWS_AT_A_TIME):
            part = slice(first, first + ROWS_AT_A_TIME)
            normal = self._features(motion[part]) @ weights
            output[part] = low + 0.5 * (normal + 1.0) * (high - low)
        return output

    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        if self.output_weights_ is None:
            raise NotFittedError(f'the ELM of {output} has no weights yet; fit it, then save it')
        content: dict[str, Any] = {
            'hidden': self.hidden, 'ridge': self.ridge, 'seed': self.seed, 'clip': self.clip,
            'channels': list(self.channels)}
        if self.payload_range is not None:
            content['payload_range'] = [float(value) for value in self.payload_range]
        return {**content, **{name: np.asarray(getattr(self, f'{name}_')) for name in ARRAYS}}

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> ExtremeLearningMachine:
        part, channels = read(ElmPart, content), arm.channels[output]
        hidden = part.hidden
        if not 1 <= hidden <= MAX_HIDDEN or part.channels != channels:
            raise ModelError(f'ELM of {hidden} neurons for {", ".join(part.channels)}; expected '
                             f'{", ".join(channels)}', remedy=AGAIN)
        model = cls(**dict(part))
        n_inputs = 3 * len(arm.active_joints) + (part.payload_range is not None)
        shapes = ((2, n_inputs), (2, len(channels)), (n_inputs, hidden), (hidden,),
                  (hidden, len(channels)))
        for name, shape in zip(ARRAYS, shapes, strict=True):
            array: Any = content.get(name)
            found: object = array.shape if isinstance(array, np.ndarray) else 'nothing'
            if found == shape and not np.all(np.abs(array) <= MAX_COEFFICIENT):
                found = f'NaN or values beyond {MAX_COEFFICIENT:g}'
            if found != shape:
                raise ModelError(f'array {output}_elm_{name} of elm.npz: found {found}, expected '
                                 f'shape {shape}', remedy=AGAIN)
            setattr(model, f'{name}_', array)
        return model

    def at(self, payload: float) -> ExtremeLearningMachine:
        if self.payload_range is None:
            return self
        self._weights()  # raises if there are none
        check_payload(payload, self.payload_range)
        plain = copy(self)
        plain.payload_range = None
        low, high = self.input_range_[:, -1]
        normal = 2.0 * (payload - low) / (high - low) - 1.0 if high > low else 0.0
        normal = min(max(normal, -1.0), 1.0) if self.clip else normal
        plain.input_range_ = self.input_range_[:, :-1]
        plain.input_weights_ = self.input_weights_[:-1]
        plain.biases_ = self.biases_ + normal * self.input_weights_[-1]
        return plain

    def _weights(self) -> FloatArray:
        if self.output_weights_ is None:
            raise NotFittedError('the ELM has no weights yet; fit it, or load a fitted one')
        return self.output_weights_

    def _features(self, motion: FloatArray) -> FloatArray:
        x = _normalise(motion, self.input_range_)
        if self.clip:
            np.clip(x, -1.0, 1.0, out=x)
        from scipy.special import expit  # slow to import, and few bundles have an ELM

        return np.asarray(expit(x @ self.input_weights_ + self.biases_))

    def _rows(self, block: TrainingBlock) -> list[tuple[FloatArray, FloatArray]]:
        if block.decimation is not None and block.decimation.sections is not None:
            return [(block.decimation(self._features(block.motion)), block.output)]
        motion = block.motion if block.decimation is None else block.decimation(block.motion)
        return [(self._features(motion[i:i + ROWS_AT_A_TIME]), block.output[i:i + ROWS_AT_A_TIME])
                for i in range(0, len(motion), ROWS_AT_A_TIME)]


def _normalise(x: FloatArray, limits: FloatArray) -> FloatArray:
    """Map [low, high] to [-1, 1]; a constant to 0."""
    low, high = limits
    width = np.where(high > low, high - low, 1.0)
    return np.where(high > low, 2.0 * (x - low) / width - 1.0, 0.0)
