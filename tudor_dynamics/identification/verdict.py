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

"""A verdict in words: may this model be used, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
import math

from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.base import Model

GOOD_FIT = 85.0
USABLE_FIT = 60.0
LARGEST_CONDITION = 1e4
LARGEST_GAP = 10.0


class Level(Enum):
    """How far a model can be trusted."""

    GOOD = 'good'
    USABLE = 'usable'
    DO_NOT_USE = 'do not use'


@dataclass(frozen=True)
class Verdict:
    """
    A level and its reasons.

    Attributes
    ----------
    level : Level
        How far the model can be trusted.
    reasons : tuple of str
        Why; the first one names the figure that decides.

    """

    level: Level
    reasons: tuple[str, ...] = field(default=())

    def __str__(self) -> str:
        """Write level and reasons on one line."""
        return f'{self.level.value}: {"; ".join(self.reasons)}'


def judge(
    validation: Validation,
    training_fit: float,
    *,
    condition: float = 1.0,
    unexcited: Sequence[str] = (),
) -> Verdict:
    """
    Judge a model by its validation and by what its training data could show.

    Parameters
    ----------
    validation : Validation
        Figures on motion that the model has not seen.
    training_fit : float
        Fit on its own training data [%].
    condition : float, default=1.0
        Largest condition number among its regressions.
    unexcited : sequence of str
        Parameters that the motion does not show.

    Returns
    -------
    Verdict
        Level with reasons.

    """
    fits = {name: item.fit for name, item in validation.score.channels.items()}
    still = [name for name, value in fits.items() if math.isnan(value)]
    if len(still) == len(fits):
        return Verdict(Level.DO_NOT_USE, (_dead(still, validation.method),))
    fit = max(validation.score.fit, -1e6)
    if fit >= GOOD_FIT:
        level, bound = Level.GOOD, f'>= {GOOD_FIT:g}'
    elif fit >= USABLE_FIT:
        level, bound = Level.USABLE, f'{USABLE_FIT:g} to {GOOD_FIT:g}'
    else:
        level, bound = Level.DO_NOT_USE, f'< {USABLE_FIT:g}'
    shown_fit = math.floor(10.0 * fit) / 10.0  # never rounded up over a bound
    reasons = [f'fit {shown_fit:.1f} % ({bound}) on {validation.method}']
    doubts = [_dead(still, validation.method)] if still else []
    worst = min((name for name in fits if name not in still), key=lambda name: fits[name])
    if fits[worst] < USABLE_FIT <= fit:
        doubts.append(f'channel {worst} alone has {fits[worst]:.1f} %: do not use it')
    if training_fit - fit > LARGEST_GAP:
        doubts.append(f'{training_fit - fit:.0f} points worse than in training: the bags differ, '
                      'or are too short')
    if unexcited:
        shown = ', '.join(unexcited[:3]) + (' ...' if len(unexcited) > 3 else '')
        doubts.append(f'the motion does not excite {shown}: trust it on similar motion only')
    elif condition > LARGEST_CONDITION:
        doubts.append(f'condition number {condition:.0f}: richer motion would pin the parameters')
    if doubts and level is Level.GOOD:
        level = Level.USABLE
    return Verdict(level, tuple(reasons + doubts))


def _dead(channels: Sequence[str], method: str) -> str:
    return (f'{", ".join(channels)} never changed on {method}: a dead sensor has no fit; do not '
            f'use {"this channel" if len(channels) == 1 else "these channels"}')


def judge_model(model: Model, validation: Validation, training_fit: float) -> Verdict:
    """
    Judge a model, of an analytical one its conditioning as well.

    Parameters
    ----------
    model : Model
        Model that was fitted.
    validation : Validation
        Figures on unseen motion.
    training_fit : float
        Fit on the training bags [%].

    Returns
    -------
    Verdict
        May it be used.

    """
    if not isinstance(model, AnalyticalModel):
        return judge(validation, training_fit)
    return judge(
        validation, training_fit,
        condition=max(group.estimate.condition for group in model.groups_),
        unexcited=tuple(group.base.names[i] for group in model.groups_
                        for i in group.estimate.unexcited))
