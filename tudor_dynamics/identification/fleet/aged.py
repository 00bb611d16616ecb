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

"""Has the model of a first date aged: its errors on later ones beside those on parts left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.identification.part_errors import part_errors, PartErrors
from tudor_dynamics.identification.worth.comparison import Change, change_of
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation.products import Products
from tudor_dynamics.typing import FloatArray

Part = list[list[Products]]


def aged(
    output: str, model: AnalyticalModel, others: Sequence[AnalyticalModel],
    then: Sequence[Part], now: Sequence[Part],
) -> list[Change]:
    """Compare the errors of a model on a later date with those on the date that it is of."""
    old = [part_errors(blind, part) for blind, part in zip(others, then, strict=True)]
    new = [part_errors(model, part) for part in now]
    return [change_of((output, 'analytical', channel), *(
        (first[i], second[i]) for first, second in zip(_figures(old), _figures(new), strict=True)))
        for i, channel in enumerate(model.channels)]


def _figures(parts: Sequence[PartErrors]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give root mean square and relative error, and how uncertain the mean square is."""
    squares, power, n = (np.array([getattr(part, name) for part in parts])
                         for name in ('squares', 'power', 'n'))
    means = squares / n
    doubt = (means.std(axis=0, ddof=1) / np.sqrt(len(parts)) / np.maximum(
        means.mean(axis=0), 1e-300) if len(parts) > 1 else np.full(n.shape[1], 0.5))
    total = squares.sum(axis=0)
    return (np.sqrt(total / n.sum(axis=0)),
            np.sqrt(total / np.maximum(power.sum(axis=0), 1e-300)), doubt)
