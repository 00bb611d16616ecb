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

"""Is a model still what it was: its errors on other bags beside those of its validation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
import math
from typing import Any

import numpy as np

from tudor_dynamics.identification.validation import Validation

BLOCK = 5.0
"""Time whose mean squared error counts as one observation: errors are correlated [s]."""
FACTOR = 1.3
"""Growth of the error below which nothing is said, however certain it is."""
RELATIVE = 1.15
"""The same for the relative error: livelier motion has larger errors, not larger relative ones."""
SIGMAS = 3.0
"""Standard errors by which the error must have grown."""
UNKNOWN = 0.5
"""Relative standard error of a mean squared error where nothing tells it."""
LEAST = 0.1
"""It is no less: two motions are not alike."""


@dataclass(frozen=True)
class Change:
    """Errors of one channel, then and now."""

    # What is predicted, by which kind of model.
    output: str
    kind: str
    channel: str
    # Root mean square error in the validation and on the bags, in the unit of the output.
    then: float
    now: float
    # Relative error in the validation and on the bags.
    relative_then: float
    relative_now: float
    sigmas: float  # growth of the logarithm of the mean squared error over its standard error
    changed: bool  # whether the model is no longer what it was

    def __str__(self) -> str:
        """Write it on one line."""
        said = 'no longer what it was' if self.changed else 'as it was'
        return (f'{self.output} {self.kind}, {self.channel}: {said}: error {self.now:.3g}, in '
                f'validation {self.then:.3g}; relative {100 * self.relative_now:.1f} % after '
                f'{100 * self.relative_then:.1f} % ({self.sigmas:+.1f} standard errors)')

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        content = asdict(self)
        return {key: content[key] for key in content if key not in ('output', 'kind', 'channel')}


def spread(validation: Validation) -> dict[str, float]:
    """Say how well the mean squared errors of a validation are known."""
    means = []
    for trace in validation.traces:
        number = np.floor((trace.t - trace.t[0]) / BLOCK).astype(int)
        squares = (trace.measured - trace.predicted) ** 2
        means += [squares[number == k].mean(axis=0) for k in np.unique(number)
                  if np.sum(number == k) > 1]
    if len(means) < 2:
        return dict.fromkeys(validation.channels, UNKNOWN)
    blocks = np.array(means)
    errors = blocks.std(axis=0, ddof=1) / math.sqrt(len(blocks)) / np.maximum(
        blocks.mean(axis=0), 1e-300)
    return dict(zip(validation.channels, errors.tolist(), strict=True))


def changes(
    facts: Mapping[str, Any], found: Mapping[str, Mapping[str, Validation]],
) -> tuple[Change, ...]:
    """Compare errors on bags with those of the validation that a bundle tells of."""
    said = []
    for output, kinds in found.items():
        for kind, validation in kinds.items():
            now = spread(validation)
            for channel, score in validation.score.channels.items():
                try:
                    known = facts['validation'][output][kind]
                    old = known['validation']['channels'][channel]
                    then, relative = float(old['rmse']), float(old['relative_error'])
                    doubt = float(known.get('spread', {}).get(channel, UNKNOWN))
                except (KeyError, TypeError, ValueError):
                    continue  # of a bundle made by hand, of which nothing is known
                said.append(change_of(
                    (output, kind, channel), (then, score.rmse),
                    (relative, score.relative_error), (doubt, now[channel])))
    return tuple(said)


def change_of(
    name: tuple[str, str, str], errors: tuple[float, float], relative: tuple[float, float],
    doubts: tuple[float, float],
) -> Change:
    """Compare errors of one channel, then and now: errors [unit of the output]."""
    growth = errors[1] / max(errors[0], 1e-300)
    sigmas = 2.0 * math.log(max(growth, 1e-12)) / math.hypot(*(max(x, LEAST) for x in doubts))
    return Change(*name, *errors, *relative, sigmas,
                  growth > FACTOR and sigmas > SIGMAS and relative[1] > RELATIVE * relative[0])
