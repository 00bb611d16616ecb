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

"""What models may be used for, one verdict each: prediction, feed-forward, collisions, payload."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.identification.fit import FittedOutput
from tudor_dynamics.identification.verdict import Grade
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.units import output_units
from tudor_dynamics.monitoring.thresholds.thresholds import MethodThresholds
from tudor_dynamics.typing import FloatArray

RATE = 1.0
"""False alarms per hour for which a collision detector is judged [1/h]."""
GOOD_SHARE, USABLE_SHARE = 0.25, 1.0
"""Threshold over the range of the output, at half of the largest speed."""
GOOD_WEIGHT, USABLE_WEIGHT = 0.05, 0.2
"""Error of a mean over `MEAN` over the range of what weight makes."""
GOOD_LEFT, USABLE_LEFT = 0.3, 0.7
"""Relative error of the efforts: what of them feed-forward leaves to the controller."""
MEAN = 1.0
"""Time over which a payload is averaged [s]."""
POSES = 2000
WEIGHTLESS = 1e-9
"""Part of what an output is at rest from which on it changes with the pose."""


@dataclass(frozen=True)
class Use:
    """One use of one model."""

    # Model, by what it predicts and what it is.
    output: str
    kind: str
    name: str  # `prediction`, `feed-forward`, `collision detection (METHOD)` or `payload`
    level: Grade | None  # may it be used; None where that cannot be said
    why: str  # figures behind it

    def __str__(self) -> str:
        """Write it on one line."""
        level = 'not known' if self.level is None else self.level.value
        return f'{self.name}: {level}: {self.why}'

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return {'use': self.name, 'verdict': None if self.level is None else self.level.value,
                'why': self.why}


def short(value: float) -> str:
    """Write a number with two digits, and no power of ten where it is at least 1e-4."""
    return f'{float(f"{value:.2g}"):g}'


def uses_of(
    item: FittedOutput, arm: Arm, thresholds: Mapping[str, MethodThresholds],
    missing: Mapping[str, str],
) -> list[Use]:
    """Judge a model by each of its uses."""
    found = [Use(item.output, item.kind, 'prediction', item.verdict.level,
                 '; '.join(item.verdict.reasons))]
    if item.output == 'effort':
        found.append(_feedforward(item))
    for method, learned in thresholds.items():
        found.append(_collisions(item, arm, method, learned))
    for method, why in missing.items():
        found.append(Use(item.output, item.kind, f'collision detection ({method})', None,
                         f'no thresholds: {why}'))
    payload = _payload(item, arm)
    return found if payload is None else [*found, payload]


def _feedforward(item: FittedOutput) -> Use:
    """
    Say what a controller has left to do behind efforts that are fed forward.

    It gives what is missing either way: an effort of which a model knows a half is no good
    prediction, and half of the work.
    """
    score = item.validation.score
    level = (Grade.GOOD if score.relative_error <= GOOD_LEFT else Grade.USABLE
             if score.relative_error <= USABLE_LEFT else Grade.DO_NOT_USE)
    each = ', '.join(f'{name} {100.0 * own.relative_error:.0f} %'
                     for name, own in score.channels.items())
    return Use(item.output, item.kind, 'feed-forward', level,
               f'{100.0 * score.relative_error:.0f} % of the efforts are left to the controller '
               f'({each})')


def _collisions(
    item: FittedOutput, arm: Arm, method: str, learned: MethodThresholds,
) -> Use:
    n = len(learned.channels)
    ratios = learned.ratios(RATE)[:n]
    rest = learned.profile[:n, 0] * ratios + learned.stiction
    columns = np.zeros(learned.profile.shape[1])
    reach = np.where(np.isfinite(learned.reach), learned.reach, 0.0)
    columns[0], columns[1:1 + learned.n_joints] = 1.0, 0.5 * reach
    moving = learned.profile[:n] @ columns * ratios
    measured = np.vstack([trace.measured for trace in item.validation.traces])
    span = np.maximum(np.ptp(np.quantile(measured, [0.005, 0.995], axis=0), axis=0), 1e-300)
    share = np.maximum(moving, rest) / span
    levels = [Grade.GOOD if one <= GOOD_SHARE else Grade.USABLE if one <= USABLE_SHARE
              else Grade.DO_NOT_USE for one in share.tolist()]
    # a touch is felt by all joints before it, so the better half decides
    level = sorted(levels, key=list(Grade).index)[(n - 1) // 2]
    units = output_units(arm, item.output)
    each = ', '.join(
        f'{name} {short(a)} at rest, {short(b)} {units[name]} in motion '
        f'({100 * c:.0f} % of its range)'
        for name, a, b, c in zip(learned.channels, rest, moving, share, strict=True))
    doubt = learned.doubt(RATE)
    wide = '' if doubt < 1.2 else f', and {doubt:.1f} times as wide as they would be from hours'
    return Use(item.output, item.kind, f'collision detection ({method})', level,
               f'told at {RATE:g} false alarm per hour: {each}; thresholds from '
               f'{learned.seconds:.0f} s of free motion{wide}')


def weights(model: Model, data: Sequence[BagData]) -> FloatArray | None:
    """
    Give what weight makes of the outputs at the poses of bags.

    Returns (poses, channels) [its unit], None of a model that does not predict single samples.
    """
    if model.has_memory:
        return None
    q = np.vstack([bag.recording.q for bag in data])
    q = q[::max(1, len(q) // POSES)]
    return model.predict(np.hstack([q, np.zeros_like(q), np.zeros_like(q)]))


def _payload(item: FittedOutput, arm: Arm) -> Use | None:
    """Say from which share of an arm's own weight another weight shows."""
    if not item.validation.cases:
        return None
    model, bag = item.validation.cases[0]
    weight = weights(model, [bag])
    if weight is None:
        return None
    span = np.ptp(weight, axis=0)
    means = []
    for trace in item.validation.traces:
        step = max(1, round(MEAN / max(float(np.median(np.diff(trace.t))), 1e-9)))
        whole = len(trace.t) // step * step
        error = (trace.measured - trace.predicted)[:whole]
        means.append(error.reshape(-1, step, error.shape[1]).mean(axis=1))
    error = np.sqrt(np.mean(np.vstack(means) ** 2, axis=0)) if means else np.full(len(span), 1.0)
    if not np.any(span > WEIGHTLESS * np.max(np.abs(weight), initial=1e-300)):
        return None  # a level axis carries no weight
    share = 2.0 * error / np.maximum(span, 1e-300)
    best = int(np.argmin(share))
    name, unit = model.channels[best], output_units(arm, item.output)[model.channels[best]]
    level = (Grade.GOOD if share[best] <= GOOD_WEIGHT else Grade.USABLE
             if share[best] <= USABLE_WEIGHT else Grade.DO_NOT_USE)
    return Use(item.output, item.kind, 'payload', level,
               f'best seen by {name}: its own weight makes {span[best]:.3g} {unit} over these '
               f'poses, a mean over {MEAN:g} s is off by {short(error[best])}, so that '
               f'{100.0 * share[best]:.0f} % of it show')
