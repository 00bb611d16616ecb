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

"""What no model can explain: the noise of the sensors, behind the filters of a fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm import PreprocessingSpec
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.signals.preprocessing import noise_gain
from tudor_dynamics.typing import FloatArray

ORDER = 5
"""Differences that leave nothing of a motion, and all of white noise."""
NORMAL = 0.6827
"""Share of a normal distribution within one standard deviation."""


def noise_floor(data: Sequence[BagData], output: str, spec: PreprocessingSpec) -> FloatArray:
    """
    Estimate the noise that the samples of a validation have.

    White noise alone is seen: what is smooth from sample to sample, such as hum or a sensor with
    a filter of its own, is not, so that the floor is a lower bound.

    Returns (channels,) [its unit].
    """
    scale = float(np.sqrt(_squares(ORDER)))
    found = []
    for bag in data:
        raw = getattr(bag.recording, output)
        for s in bag.stretches:
            first = int(np.searchsorted(bag.recording.stamp, s.stamp[0]))
            differences = np.diff(raw[first:first + len(s.t)], ORDER, axis=0)
            if not len(differences):
                continue
            found.append(noise_gain(s, spec) * np.quantile(
                np.abs(differences), NORMAL, axis=0) / scale)
    return np.median(found, axis=0) if found else np.zeros(0)


def _squares(order: int) -> float:
    """Sum the squares of the coefficients of a difference."""
    weights = np.array([1.0])
    for _ in range(order):
        weights = np.convolve(weights, [1.0, -1.0])
    return float(np.sum(weights**2))
