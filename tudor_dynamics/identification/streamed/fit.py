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

"""From sums over many bags to judged models, in the shape of any other fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tudor_dynamics.identification.bag_facts import BagFacts, Unused
from tudor_dynamics.identification.dataset import BagData, filtered
from tudor_dynamics.identification.fit import FitResult, FittedOutput
from tudor_dynamics.identification.metrics import Tally
from tudor_dynamics.identification.noise import noise_floor
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.identification.ringing import find_ringing
from tudor_dynamics.identification.streamed.task import Place, Task
from tudor_dynamics.identification.unseen import Case, ENOUGH
from tudor_dynamics.identification.validation import trace, Validation
from tudor_dynamics.identification.verdict import judge_model
from tudor_dynamics.models.analytical import AnalyticalModel


@dataclass(frozen=True, eq=False)
class Streamed:
    """What the passes over many bags came to."""

    task: Task  # what was asked of every bag
    models: Mapping[Place, AnalyticalModel]  # filters and output to the model of all bags
    others: Mapping[Place, Mapping[int, AnalyticalModel]]  # the same without each group of bags
    # Bags learned from, and test bags.
    learned: tuple[BagFacts, ...]
    judged: tuple[BagFacts, ...]
    unused: tuple[Unused, ...]  # bags that were left out
    # How models did on the test bags, or on each bag left out; and on the bags learned from.
    unseen: Mapping[Place, Tally]
    seen: Mapping[Place, Tally]
    # A sample of the bags, which stays in memory: for choices, thresholds and figures.
    training: tuple[BagData, ...]
    test: tuple[BagData, ...]
    folds: Mapping[str, int]  # bag to the group that it is left out with

    @property
    def method(self) -> str:
        """Say how it was judged, in words."""
        if len(self.judged) == 1:
            return f'test bag {self.judged[0].bag}'
        if self.judged:
            return f'{len(self.judged)} test bags'
        groups, bags = len({*self.folds.values()}), len(self.learned)
        return (f'leave one bag out, {bags} bags' if groups == bags else
                f'leave one of {groups} groups of bags out, {bags} bags')

    def result(self, number: int) -> FitResult:
        """Give the fit behind some of the filters."""
        task, spec = self.task, self.task.specs[number]
        training, test = (tuple(filtered(bag, spec) for bag in bags)
                          for bags in (self.training, self.test))
        fitted = tuple(self._output(number, output, training, test) for output in task.outputs)
        ringing = find_ringing(fitted[-1].model, [*training, *test], fitted[-1].output)
        told = [text for bag in (*self.learned, *self.judged) for text in bag.warnings]
        return FitResult(task.arm, spec, task.settings, fitted, training, test, ringing,
                         tuple(dict.fromkeys(told)), learned=self.learned, judged=self.judged,
                         unused=self.unused)

    def _output(
        self, number: int, output: str, training: Sequence[BagData], test: Sequence[BagData],
    ) -> FittedOutput:
        place = number, output
        model = self.models[place]
        left = self._cases(place, training)
        cases = [(model_for(model, bag), bag) for bag in test] if test else left
        validation = Validation(
            self.method, self.unseen[place].score(model.channels),
            tuple(trace(at, bag, output) for at, bag in cases), model.channels, tuple(cases))
        seen = Validation('the training bags themselves',
                          self.seen[place].score(model.channels), (), model.channels)
        noise = noise_floor(test or training, output, self.task.specs[number])
        verdict = judge_model(model, validation, seen.score.fit, noise.tolist())
        return FittedOutput(output, 'analytical', model, seen, validation, None, verdict,
                            _enough([*cases, *(left if test else ())]), noise)

    def _cases(self, place: Place, bags: Sequence[BagData]) -> list[Case]:
        """Pair bags of the sample with models that have not seen them."""
        others = self.others[place]
        return [(model_for(others[self.folds[str(bag.choice)]], bag), bag) for bag in bags]


def _enough(cases: Sequence[Case]) -> tuple[Case, ...]:
    """Take no more than thresholds profit from."""
    taken: list[Case] = []
    for case in cases:
        if sum(float(bag.recording.t[-1]) for _, bag in taken) >= ENOUGH:
            break
        taken.append(case)
    return tuple(taken)
