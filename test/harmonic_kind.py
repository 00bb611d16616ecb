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

"""A fourth kind of model, as somebody would add it: this file, and an entry in ``KINDS``."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import ModelError, NotFittedError
from tudor_dynamics.models.base import Blocks, MemorylessModel, ModelSettings
from tudor_dynamics.models.bundle import Kind, KINDS
from tudor_dynamics.typing import FloatArray

NAME = 'harmonic'


def features(motion: FloatArray) -> FloatArray:
    """Give what the outputs are a sum of: states, and sines and cosines of angles of links."""
    q = np.cumsum(motion[:, :motion.shape[1] // 3], axis=1)
    return np.hstack([np.ones((len(motion), 1)), motion, np.sin(q), np.cos(q),
                      np.tanh(20.0 * motion[:, q.shape[1]:2 * q.shape[1]])])


class HarmonicModel(MemorylessModel):
    """Outputs linear in states, and in sines and cosines of angles of links."""

    def __init__(self, channels: tuple[str, ...]) -> None:
        self.channels = channels
        self.weights_: FloatArray | None = None

    @classmethod
    def new(cls, arm: Arm, output: str, settings: ModelSettings) -> HarmonicModel:
        """Build one that is not fitted yet."""
        return cls(arm.channels[output])

    def fit_blocks(self, blocks: Blocks) -> HarmonicModel:
        """Learn by least squares."""
        rows, outputs = [], []
        for block in blocks():
            made = features(block.motion)
            rows.append(made if block.decimation is None else block.decimation(made))
            outputs.append(block.output)
        self.weights_ = np.linalg.lstsq(np.vstack(rows), np.vstack(outputs), rcond=1e-10)[0]
        return self

    def predict(self, motion: FloatArray) -> FloatArray:
        """Predict the outputs."""
        if self.weights_ is None:
            msg = 'the harmonic model has no weights yet; fit it, or load one'
            raise NotFittedError(msg)
        return np.asarray(features(motion) @ self.weights_)

    def to_dict(self, arm: Arm, output: str) -> dict[str, Any]:
        """Give the channels as plain values, and the weights as an array."""
        if self.weights_ is None:
            msg = 'the harmonic model has no weights yet; fit it, then save it'
            raise NotFittedError(msg)
        return {'channels': list(self.channels), 'weights': self.weights_}

    @classmethod
    def from_dict(cls, content: dict[str, Any], arm: Arm, output: str) -> HarmonicModel:
        """Build it from what a bundle keeps."""
        model = cls(arm.channels[output])
        shape = (1 + 6 * len(arm.active_joints), len(model.channels))
        if content['channels'] != list(model.channels) or content['weights'].shape != shape:
            msg = f'harmonic model of {content["channels"]}; expected {list(model.channels)}'
            raise ModelError(msg)
        model.weights_ = content['weights']
        return model


@pytest.fixture
def fourth_kind(monkeypatch: pytest.MonkeyPatch) -> str:
    """Enter the kind; gives its name."""
    monkeypatch.setitem(KINDS, NAME, Kind('harmonic', HarmonicModel))
    return NAME
