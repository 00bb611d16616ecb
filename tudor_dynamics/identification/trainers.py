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

"""How each kind of model is fitted to bags: most from rows, some from whole stretches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

from tudor_dynamics.arm import Arm
from tudor_dynamics.identification.dataset import BagData, training_blocks
from tudor_dynamics.identification.elastic.result import Identified
from tudor_dynamics.identification.elastic.trainer import ElasticTrainer, Searches
from tudor_dynamics.models.base import Model
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.memoryless import MemorylessModel, ModelSettings


class Trainer(Protocol):
    """Fits models of one kind to all bags, then to parts of them."""

    identified: Identified | None
    """What was found out about the arm from all bags; None for a kind that says nothing of it."""
    searches: Mapping[tuple[str, ...], Identified]
    """The same by names of bags, for the parts as well."""

    def prepare(self, parts: Sequence[Sequence[BagData]]) -> None:
        """
        Do together what several fits will have to begin with.

        Parameters
        ----------
        parts : sequence of sequence of BagData
            Bags of each fit to come, all of them first.

        """

    def fit(self, bags: Sequence[BagData], output: str) -> Model:
        """
        Fit the model of one output.

        Parameters
        ----------
        bags : sequence of BagData
            Bags to learn from.
        output : {'effort', 'strain'}
            Output to be learned.

        Returns
        -------
        Model
            Fitted model.

        """


def blank(kind: str, arm: Arm, output: str, settings: ModelSettings) -> MemorylessModel:
    """Build a model that is not fitted yet."""
    made = KINDS[kind].model if settings.payloads is None else KINDS[kind].of_payloads
    assert made is not None and issubclass(made, MemorylessModel)
    return made.new(arm, output, settings)


class RowTrainer:
    """Fits models without a memory to rows of motion."""

    identified: Identified | None = None
    searches: Mapping[tuple[str, ...], Identified] = MappingProxyType({})

    def __init__(self, kind: str, arm: Arm, settings: ModelSettings) -> None:
        self.kind, self.arm, self.settings = kind, arm, settings
        self._known: dict[str, dict[tuple[str, bool], Any]] = {}

    def prepare(self, parts: Sequence[Sequence[BagData]]) -> None:
        """Do nothing: each fit takes an instant, and keeps what it knows of each bag."""

    def fit(self, bags: Sequence[BagData], output: str) -> Model:
        """Fit the model of one output; see ``Trainer``."""
        with_payload = self.settings.payloads is not None
        model = blank(self.kind, self.arm, output, self.settings)
        parts = {str(bag.choice): training_blocks(
            [bag], output, with_payload=with_payload, inputs=model.inputs) for bag in bags}
        return model.fit_parts(parts, self._known.setdefault(output, {}))


TRAINERS = {'elastic': ElasticTrainer}
"""Trainers of the kinds that learn from whole stretches; rows do for all others."""


def check_kinds(
    kinds: Iterable[str], arm: Arm, bags: Sequence[BagData] | None = None,
) -> None:
    """Refuse an arm or bags that a kind cannot learn from, before hours of work and not after."""
    for kind in kinds:
        if kind in TRAINERS:
            TRAINERS[kind].check(arm, bags)


def trainer_of(
    kind: str, arm: Arm, settings: ModelSettings, progress: Callable[[str], None],
    kept: BagData | None, known: Searches | None = None,
    warm: Mapping[str, float] | None = None,
) -> Trainer:
    """Give the trainer of a kind."""
    if kind in TRAINERS:
        return TRAINERS[kind](arm, settings.payloads, progress, warm, kept, known)
    return RowTrainer(kind, arm, settings)
