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

"""Sums over many bags, by groups that are left out together, and models of such sums."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import copy
from dataclasses import dataclass, field
from pathlib import Path

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.metrics import Tally
from tudor_dynamics.identification.streamed.kept import Part, read_bag, read_judged
from tudor_dynamics.identification.streamed.task import Place, Sight, Task
from tudor_dynamics.identification.trainers import blank
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation.products import Products, summed
from tudor_dynamics.models.training import TrainingBlock

FOLDS = 10
"""Groups of bags that are left out, one after the other."""


def fold_of(number: int, bags: int) -> int:
    """Say which group a bag is left out with: neighbours in time go together."""
    return number * min(FOLDS, bags) // bags


@dataclass
class FoldSums:
    """What groups of bags came to, added up bag by bag, in their order."""

    task: Task  # what was asked of every bag
    # Filters and output, then group, to sums.
    parts: dict[Place, dict[int, Part]] = field(default_factory=dict)

    def add(self, seen: Sight) -> None:
        """Add what was kept of a bag."""
        file = self.task.file(seen, '.npz')
        kept = read_bag(file)
        if kept is None:
            raise gone(file)
        for place, part in kept.parts.items():
            folds = self.parts.setdefault(place, {})
            known = folds.get(seen.fold)
            folds[seen.fold] = part if known is None else summed([known, part])

    def models(self, place: Place) -> tuple[AnalyticalModel, dict[int, AnalyticalModel]]:
        """
        Fit the model of all groups, and one without each of them.

        Returns others, an empty dict where there is one group alone.
        """
        folds = self.parts[place]
        known: dict[tuple[str, bool], Part] = {}
        for fold, part in folds.items():
            known[name_of(fold), True] = part
            known[name_of(fold), False] = [[Products(item.gram, item.n) for item in group]
                                           for group in part]
        arm, settings = self.task.arm, self.task.settings

        def fit(some: Sequence[int]) -> AnalyticalModel:
            return _fitted(arm, place[1], settings, [name_of(fold) for fold in some], known)

        return fit(list(folds)), {
            fold: fit([other for other in folds if other != fold])
            for fold in folds if len(folds) > 1}


@dataclass
class ErrorSums:
    """How models did on many bags, added up bag by bag, in their order."""

    # Filters and output to errors of models that have not seen the bags, and of those that have.
    unseen: dict[Place, Tally] = field(default_factory=dict)
    seen: dict[Place, Tally] = field(default_factory=dict)

    def add(self, file: Path) -> None:
        """Add what was kept of a bag."""
        judged = read_judged(file)
        if judged is None:
            raise gone(file)
        for total, found in ((self.unseen, judged.unseen), (self.seen, judged.seen)):
            for place, tally in found.items():
                total[place] = total[place] + tally if place in total else tally


def gone(file: Path) -> FitError:
    """Say that what was kept is not there any more."""
    return FitError('what a bag came to cannot be read any more', place=file,
                    remedy='fit again, leave that directory alone meanwhile, and let all machines '
                           'see it')


def name_of(fold: int) -> str:
    """Name a group of bags, in a bundle."""
    return f'group {fold + 1}'


def _fitted(
    arm: object, output: str, settings: FitSettings, names: Sequence[str],
    known: Mapping[tuple[str, bool], Part],
) -> AnalyticalModel:
    model = blank('analytical', arm, output, settings)  # type: ignore[arg-type]
    assert isinstance(model, AnalyticalModel)
    return model.fit_parts(dict.fromkeys(names, _nothing), dict(known))


def _nothing() -> Iterator[TrainingBlock]:
    """Give no data: all sums are known."""
    return iter(())


def light(model: AnalyticalModel) -> AnalyticalModel:
    """Give a model without the data that it was fitted to, to be sent."""
    other = copy.copy(model)
    other.data_ = {}
    return other
