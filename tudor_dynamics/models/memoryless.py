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

"""Models without a memory: what they learn from rows of motion, and how they follow it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping
from typing import Any, Protocol, TypeVar

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.models.base import block_of, Blocks, Live, Model, Range, SLIDING, TrainingBlock
from tudor_dynamics.models.friction import FrictionStates, LiveFriction
from tudor_dynamics.signals.preprocessing import Stretch
from tudor_dynamics.typing import FloatArray

Learner = TypeVar('Learner', bound='MemorylessModel')


class ModelSettings(Protocol):
    """What `identification.fit.FitSettings` says of models that are to be fitted."""

    @property
    def estimator(self) -> str:
        """Estimator of an analytical model."""

    @property
    def strain_form(self) -> str:
        """Where an analytical model takes the bending moment."""

    @property
    def elm_hidden(self) -> int:
        """How many neurons are hidden."""

    @property
    def elm_ridge(self) -> float:
        """Ridge of the output weights."""

    @property
    def elm_seed(self) -> int:
        """Seed of the hidden layer."""

    @property
    def shared(self) -> bool | None:
        """Whether currents of unknown torque constants share the inertial parameters."""

    @property
    def payloads(self) -> Range | None:
        """Least and largest payload of the training bags, where they differ [kg]."""


class MemorylessModel(Model):
    """
    A model that learns from rows: its outputs depend on the motion at their sample.

    What friction makes of the motion before, where it gives way, is an input beside it.
    """

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
        """
        Learn from several parts, such as bags, of which other models may learn too.

        known: empty before the first.
        """
        def blocks() -> Iterator[TrainingBlock]:
            for part in parts.values():
                yield from part()

        return self.fit_blocks(blocks)

    def fit(self: Learner, motion: FloatArray, output: FloatArray) -> Learner:
        """
        Learn from motion and outputs.

        output (samples, channels) [its unit]; motion (samples, inputs): ``[q, dq, ddq]`` of the
        active joints, in columns [rad, rad/s, rad/s^2 or m, m/s, m/s^2], and the payload [kg]
        where the model is of all payloads.
        """
        return self.fit_blocks(block_of(motion, output))

    @abstractmethod
    def predict(self, motion: FloatArray) -> FloatArray:
        """Predict the outputs, each sample by itself; see ``Model``."""

    def inputs(self, stretch: Stretch) -> FloatArray:
        """Give the motion, and what friction makes of the past; see ``Model``."""
        return stretch.motion if self.states is None else self.states.follow(stretch)

    def trail(self) -> LiveFriction | None:
        """Follow what friction makes of the past; see ``Model``."""
        return None if self.states is None else LiveFriction(self.states)

    def follow(self, stretch: Stretch) -> FloatArray:
        """Predict each sample of a stretch by itself; see ``Model``."""
        return self.predict(self.inputs(stretch))

    def follow_kept(self, stretch: Stretch) -> FloatArray:
        """Predict the samples that are kept, without those between where no filter needs them."""
        if stretch.decimation.sections is None:
            return self.predict(stretch.decimation(self.inputs(stretch)))
        return super().follow_kept(stretch)

    def stiction(self, q: FloatArray) -> FloatArray:
        """Turn each joint the one way and the other, slowly; see ``Model``."""
        n = q.shape[1]
        if len(self.channels) != n:
            return super().stiction(q)
        motion = np.zeros((2, n, len(q), 3 * n))
        motion[..., :n] = q
        for joint in range(n):
            motion[:, joint, :, n + joint] = np.array([SLIDING, -SLIDING])[:, None]
        y = self.predict(motion.reshape(-1, 3 * n)).reshape(2, n, len(q), n)
        own = np.abs(np.einsum('jkj->kj', y[0] - y[1]))
        return np.asarray(0.5 * np.median(own, axis=0))

    @classmethod
    def live(
        cls: type[Learner], models: Mapping[str, Learner], observer: str = 'off',
    ) -> Live:
        """Predict row by row; there is no state that an observer could correct."""
        return RowByRow(models)


class RowByRow:
    """Models without a memory, sample by sample; see ``Live``."""

    observing = False

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
        followed = ({output: trail.step(dt, row) for output, trail in self._trails.items()}
                    if self._trails else {})
        return {output: model.predict(followed.get(output, row)[None])[0]
                for output, model in self._models.items() if wanted is None or output in wanted}
