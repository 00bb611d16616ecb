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

"""A verdict in words: may this model be used to predict, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
import math

from tudor_dynamics.identification.metrics import ChannelScore, Score
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.models.base import Model

GOOD_FIT = 85.0
USABLE_FIT = 60.0
USABLE_ERROR = 15.0
"""Relative error up to which a model is of use where the output hardly varies [%]."""
NOISE_LIMITED = 1.25
"""Times the noise of the sensor up to which an error is all that there is to get."""
LARGEST_CONDITION = 1e4
LARGEST_GAP = 10.0


class Grade(Enum):
    """How far a model can be trusted."""

    GOOD = 'good'
    USABLE = 'usable'
    DO_NOT_USE = 'do not use'


@dataclass(frozen=True)
class Verdict:
    """A level and its reasons."""

    level: Grade  # how far the model can be trusted
    # Why; the first one names the figure that decides.
    reasons: tuple[str, ...] = field(default=())
    channels: dict[str, Grade] = field(default_factory=dict)  # the same of each channel

    def __str__(self) -> str:
        """Write level and reasons on one line."""
        return f'{self.level.value}: {"; ".join(self.reasons)}'


def level_of(score: Score | ChannelScore, noise: float = 0.0) -> Grade:
    """Judge figures; noise [unit of the output]: 0 where it is not known."""
    if score.fit >= GOOD_FIT:
        return Grade.GOOD
    limited = noise > 0.0 and score.rmse <= NOISE_LIMITED * noise
    if score.fit >= USABLE_FIT:
        return Grade.GOOD if limited else Grade.USABLE
    if 100.0 * score.relative_error <= USABLE_ERROR:
        return Grade.USABLE
    return Grade.DO_NOT_USE


def judge(
    validation: Validation,
    training_fit: float,
    *,
    condition: float = 1.0,
    unexcited: Sequence[str] = (),
    noise: Sequence[float] = (),
) -> Verdict:
    """
    Judge a model by its validation and by what its training data could show.

    training_fit [%]; noise [its unit]: empty where it is not known.
    """
    scores = validation.score.channels
    floors = dict(zip(scores, noise, strict=True)) if len(noise) else dict.fromkeys(scores, 0.0)
    still = [name for name, item in scores.items() if math.isnan(item.fit)]
    if len(still) == len(scores):
        return Verdict(Grade.DO_NOT_USE, (_dead(still, validation.method),),
                       dict.fromkeys(scores, Grade.DO_NOT_USE))
    levels = {name: Grade.DO_NOT_USE if name in still else level_of(item, floors[name])
              for name, item in scores.items()}
    total = math.sqrt(sum(floor**2 for floor in floors.values()) / len(floors))
    level = level_of(validation.score, total)
    reasons = [_figures(validation)]
    reasons += [f'{name}: {_limited(scores[name], floors[name])}' for name in scores
                if name not in still
                and scores[name].rmse <= NOISE_LIMITED * floors[name]]
    doubts = [_dead(still, validation.method)] if still else []
    doubts += [f'channel {name} alone has {scores[name].fit:.1f} %, relative error '
               f'{100.0 * scores[name].relative_error:.0f} %: '
               f'{"do not use it" if levels[name] is Grade.DO_NOT_USE else "usable"}'
               for name in sorted(scores, key=lambda key: scores[key].fit)
               if name not in still and _worse(levels[name], level)]
    if training_fit - validation.score.fit > LARGEST_GAP:
        doubts.append(f'{training_fit - max(validation.score.fit, -1e6):.0f} points worse than '
                      'in training: the bags differ, or are too short')
    if unexcited:
        shown = ', '.join(unexcited[:3]) + (' ...' if len(unexcited) > 3 else '')
        doubts.append(f'the motion does not excite {shown}: trust it on similar motion only')
    elif condition > LARGEST_CONDITION:
        doubts.append(f'condition number {condition:.0f}: richer motion would pin the parameters')
    if level is Grade.GOOD and any(
            not text.endswith(': usable') for text in doubts):
        level = Grade.USABLE
    return Verdict(level, tuple(reasons + doubts), levels)


def _worse(one: Grade, other: Grade) -> bool:
    order = list(Grade)
    return order.index(one) > order.index(other)


def _figures(validation: Validation) -> str:
    fit = max(validation.score.fit, -1e6)
    bound = (f'>= {GOOD_FIT:g}' if fit >= GOOD_FIT else
             f'{USABLE_FIT:g} to {GOOD_FIT:g}' if fit >= USABLE_FIT else f'< {USABLE_FIT:g}')
    shown = math.floor(10.0 * fit) / 10.0  # never rounded up over a bound
    return (f'fit {shown:.1f} % ({bound}) on {validation.method}, relative error '
            f'{100.0 * validation.score.relative_error:.1f} %')


def _limited(score: ChannelScore, noise: float) -> str:
    return (f'an error of {score.rmse:.3g} at a noise of {noise:.3g} is all that there is to get')


def _dead(channels: Sequence[str], method: str) -> str:
    return (f'{", ".join(channels)} never changed on {method}: a dead sensor has no fit; do not '
            f'use {"this channel" if len(channels) == 1 else "these channels"}')


def judge_model(
    model: Model, validation: Validation, training_fit: float, noise: Sequence[float] = (),
) -> Verdict:
    """
    Judge a model, by its conditioning as well where it has one.

    training_fit [%], noise [its unit].
    """
    known = model.conditioning()
    return judge(validation, training_fit, condition=known.condition,
                 unexcited=known.unexcited, noise=noise)
