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

"""Recordings beside a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.models.base import Model
from tudor_dynamics.payload.bent import BentLinks
from tudor_dynamics.payload.watched import Smoothed
from tudor_dynamics.signals import Stretch
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Readings:
    """An output of a recording beside a model."""

    # `[q, dq, ddq]`, (samples, 3 joints) [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    motion: FloatArray
    # (samples, channels): in units of the output; predicted as if nothing were carried beyond what
    # the model knows.
    measured: FloatArray
    predicted: FloatArray
    rate: float  # samples a second [Hz]
    t: FloatArray  # since the beginning of the recording, (samples,) [s]


def readings(model: Model, stretches: Sequence[Stretch], output: str) -> Readings:
    """Put an output of a recording beside a model."""
    pieces = [(s.t[s.decimation.keep], s.motion[s.decimation.keep],
               s.decimation(getattr(s, output)), model.follow_kept(s)) for s in stretches]
    t, motion, measured, predicted = (
        np.concatenate(column) for column in zip(*pieces, strict=True))
    seconds = sum(float(s.t[-1] - s.t[0]) for s in stretches)
    return Readings(motion, measured, predicted, len(motion) / max(seconds, 1e-9), t)


def bent_readings(bent: BentLinks, model: Model, stretches: Sequence[Smoothed]) -> Readings:
    """Put the strain of links that bend beside a model of it."""
    motion = np.vstack([bent.motion(item.states) for item in stretches])
    return Readings(motion, np.vstack([item.strain for item in stretches]), model.predict(motion),
                    1.0 / float(np.median([item.step for item in stretches])),
                    np.concatenate([item.t for item in stretches]))
