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

"""A fit to more bags than memory holds: sums of products, groups left out together."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import copy
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
import warnings

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import FitError, TudorWarning, UsageError
from tudor_dynamics.identification.choice import Choices, choose
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, BagFacts, filtered, load, model_for, spread_sample, SurveyedBag,
    Unused, with_recorded_gauges)
from tudor_dynamics.identification.fit import (
    enough, FitResult, FitSettings, FittedOutput, result_of)
from tudor_dynamics.identification.passes import (
    forget, go_through, Judged, Judging, Part, Pass, Place, Summing, survey, Task)
from tudor_dynamics.identification.validation import (
    cases_of, method_of, noise_floor, Tally, trace, Validation)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.estimation import ESTIMATORS, Products, summed
from tudor_dynamics.models.friction import term_names
from tudor_dynamics.parallel import elsewhere
from tudor_dynamics.typing import Progress


FOLDS = 10
"""Groups of bags, neighbours in time, that are left out in turn (Kohavi, IJCAI 1995: ten)."""


class FoldModels(NamedTuple):
    """Models of one output by one of the filters."""

    whole: AnalyticalModel  # of all groups of bags
    others: Mapping[int, AnalyticalModel]  # without each group; empty where there is but one
    parts: Mapping[int, Part]  # what each group came to


def fold_models(gathered: Summing, progress: Progress = lambda _: None) -> dict[Place, FoldModels]:
    """Add up what groups of bags came to, in their order; fit all, and all but each group."""
    parts: dict[Place, dict[int, Part]] = {}
    task = gathered.task
    for seen in gathered.bags:
        progress('add up')
        for place, part in gathered.kept(seen).parts.items():
            folds = parts.setdefault(place, {})
            folds[seen.fold] = summed([folds[seen.fold], part]) if seen.fold in folds else part
    progress('fit')
    found = {}
    for (number, output), folds in parts.items():
        sums: dict[tuple[str, bool], Part] = {}
        for fold, part in folds.items():
            sums[str(fold), True] = part
            sums[str(fold), False] = [[Products(item.gram, item.n) for item in group]
                                      for group in part]

        def fit(some: Iterable[int]) -> AnalyticalModel:
            return AnalyticalModel.new(task.arm, output, task.settings).fit_parts(
                {str(fold): tuple for fold in some}, sums)

        found[number, output] = FoldModels(fit(folds), {
            out: fit(fold for fold in folds if fold != out) for out in folds if len(folds) > 1},
            folds)
    return found


def light(model: AnalyticalModel) -> AnalyticalModel:
    """Give a model without the data that it was fitted to, to be sent."""
    other = copy.copy(model)
    other.data_ = []
    return other


FROM = 33  # bags from which a fit is streamed without being asked to
WARNED = 5  # bags left out that are warned of one by one


@dataclass(frozen=True)
class Streaming:
    """How many bags are gone through."""

    # Where what each bag came to is kept, to go on after an interruption; else in a folder that is
    # removed.
    store: Path | None = None
    jobs: int = 1  # number of processes
    strict: bool = False  # refuse a bag that cannot be used, in place of leaving it out


def streams(bags: int, settings: FitSettings, *, asked: bool = False) -> bool:
    """Say whether a fit goes bag by bag."""
    if not asked and bags < FROM:
        return False
    others = [kind for kind in settings.kinds if kind != 'analytical']
    said = f'{bags} bags are fitted one by one'
    fewer = 'leave --stream out' if bags < FROM else f'name fewer than {FROM} bags'
    if others:
        what = f'--models {" ".join(others)}'
        raise UsageError(f'{said}, but {what} needs all at once',
                         remedy=f'leave out {what}, or {fewer}')
    estimator = ESTIMATORS.get(settings.estimator)
    if estimator is not None and estimator.sample_weights is not None:
        raise UsageError(f'{said}, but {estimator.words} needs all at once',
                         remedy=f'use --estimator wls or ols, or {fewer}')
    if bags < 2:
        raise UsageError('--stream needs two bags or more, and there is one',
                         remedy='leave --stream out')
    return True


class ManyBags:
    """Bags of a fit, one by one; a sample stays in memory for choices, thresholds and figures."""

    def __init__(
        self, arm: Arm, training: Sequence[BagChoice], test: Sequence[BagChoice],
        spec: PreprocessingSpec, payloads: Mapping[str, float], streaming: Streaming,
        progress: Progress,
    ) -> None:
        """See all bags, and read the sample: payloads [kg]."""
        self.arm, self.spec, self.streaming = arm, spec, streaming
        self.progress, self.base = progress, Path.cwd()
        self.unused: list[Unused] = []
        seen = survey([*training, *test], payloads, self.base, streaming.jobs,
                      self._count('see bags'))
        self.training, self.test = self._usable(seen[:len(training)], seen[len(training):])
        bags, test_bags = self._sample(self.training), self._sample(self.test)
        recorded = with_recorded_gauges(arm, [bag.choice for bag in (*bags, *test_bags)])
        if recorded is not arm:
            self.arm = recorded
            bags, test_bags = self._sample(self.training), self._sample(self.test)
        self.outputs = self._outputs([*bags, *test_bags])
        self.held = [bag for bag in bags if all(map(bag.has, self.outputs))]
        self.held_test = [bag for bag in test_bags if all(map(bag.has, self.outputs))]

    def choose(self, settings: FitSettings) -> Choices:
        """Choose what is left open by the sample."""
        chosen = choose(self.arm, self.held, self.spec, settings, self.progress, summable=True)
        if any(term_names(joint, loaded=True) for joint in chosen.arm.joints):
            raise UsageError('the friction term load needs all bags at once, not one by one',
                             remedy='remove load from --friction or joints[].friction')
        return chosen

    def fits(self, chosen: Choices, specs: Sequence[PreprocessingSpec]) -> list[FitResult]:
        """Go through all bags twice more: multiplied out, judged."""
        # other machines see the paths that bags are named relative to
        place = self.base if elsewhere() else None
        with TemporaryDirectory(prefix='tudor_', dir=place) as scratch:
            task = Task(chosen.arm, tuple(specs), self.outputs, chosen.settings, self.base,
                        self.streaming.store or Path(scratch))
            gathered, learned = self._gathered(task)
            models = fold_models(gathered, self.progress)
            judged, errors = self._judged(gathered, models)
        known = gathered.bags
        folds = {str(bag.choice): bag.fold for bag in known}
        method = method_of([bag.bag for bag in judged], len(known), len({*folds.values()}))
        results = []
        for number, spec in enumerate(specs):
            training = [filtered(bag, spec) for bag in self.held if str(bag.choice) in folds]
            test = [filtered(bag, spec) for bag in self.held_test]
            fitted = []
            for output in self.outputs:
                model, others, _ = models[number, output]
                left = [(model_for(others[folds[str(bag.choice)]], bag), bag) for bag in training]
                cases = cases_of(model, test) if test else left
                fitted.append(FittedOutput(
                    output, 'analytical', model,
                    Validation('the training bags themselves',
                               errors[True, number, output].score(model.channels), (),
                               model.channels),
                    Validation(method, errors[False, number, output].score(model.channels),
                               tuple(trace(at, bag, output) for at, bag in cases),
                               model.channels, tuple(cases)),
                    enough([*cases, *(left if test else ())]),
                    noise_floor(test or training, output, spec)))
            results.append(replace(result_of(
                task.arm, spec, task.settings, fitted, training, test, learned, judged),
                unused=tuple(self.unused)))
        return results

    def _gathered(self, task: Task) -> tuple[Summing, list[BagFacts]]:
        """Multiply out the training bags; give those that can be used, and their facts."""
        facts = go_through([Summing(task, tuple(self.training))], self.streaming.jobs,
                           self._count('multiply out'))
        used = [seen for seen, item in zip(self.training, facts, strict=True)
                if not isinstance(item, Unused)]
        self._leave_out([item for item in facts if isinstance(item, Unused)])
        self._refuse_few(used, self.training)
        folds = min(FOLDS, len(used))
        return (Summing(task, tuple(replace(seen, fold=i * folds // len(used))
                                    for i, seen in enumerate(used))),
                [item for item in facts if not isinstance(item, Unused)])

    def _judged(
        self, gathered: Summing, models: Mapping[Place, FoldModels],
    ) -> tuple[list[BagFacts], dict[Judged, Tally]]:
        """Let models predict all; gives test bags, and errors."""
        known = gathered.bags
        trials = _trials(gathered, self.test, models)
        answers = go_through(trials, self.streaming.jobs, self._count('judge'))
        lost = [item for item in answers[:len(known)] if isinstance(item, Unused)]
        if lost:
            raise FitError(f'{lost[0]} (earlier in this fit it could be read)',
                           remedy='fit again, and do not change bags during a fit')
        judged = [item for item in answers[len(known):] if not isinstance(item, Unused)]
        self._leave_out([item for item in answers[len(known):] if isinstance(item, Unused)])
        self._refuse_no_test(judged, self.test)
        sums: dict[Judged, Tally] = {}
        asked = [(trial, seen) for trial in trials for seen in trial.bags]
        for (trial, seen), item in zip(asked, answers, strict=True):
            if not isinstance(item, Unused):
                for which, tally in trial.kept(seen).errors.items():
                    sums[which] = sums[which] + tally if which in sums else tally
        passes: list[Pass[Any]] = [gathered, *trials]
        forget(gathered.task.store, {each.name(seen) for each in passes for seen in each.bags})
        return judged, sums

    def _refuse_few(self, used: Sequence[object], given: Sequence[object]) -> None:
        if len(used) < 2:
            raise FitError(f'{len(used)} of {len(given)} training bags can be used, 2 are needed: '
                           f'{self.unused[0]}', remedy='give other bags')

    def _refuse_no_test(self, used: Sequence[object], given: Sequence[object]) -> None:
        if given and not used:
            raise FitError(f'no test bag can be used: {self.unused[-1]}',
                           remedy='give --test other bags')

    def _usable(
        self, training: Sequence[SurveyedBag | Unused], test: Sequence[SurveyedBag | Unused],
    ) -> tuple[list[SurveyedBag], list[SurveyedBag]]:
        """Leave out what cannot be opened, and copies; a copy of a training bag is no test."""
        known: dict[str, list[SurveyedBag]] = {}
        found: tuple[list[SurveyedBag], list[SurveyedBag]] = ([], [])
        wrong = []
        for sights, some in zip(found, (training, test), strict=True):
            for item in some:
                if isinstance(item, Unused):
                    wrong.append(item)
                    continue
                same = known.setdefault(item.checksum, [])
                other = next((one for one in same if one.choice.overlaps(item.choice)), None)
                if other is None:
                    sights.append(item)
                    if some is training:
                        same.append(item)
                    continue
                copy = Unused(str(item.choice), f'is a copy of the training bag '
                                                f'{other.choice} (sha256 {item.checksum[:12]})')
                if some is test:
                    raise FitError(f'{copy} and cannot test the model',
                                   remedy='give another recording in its place')
                wrong.append(copy)
        self._leave_out(wrong)
        self._refuse_few(found[0], training)
        self._refuse_no_test(found[1], test)
        return found

    def _leave_out(self, wrong: Sequence[Unused]) -> None:
        if wrong and self.streaming.strict:
            raise FitError(f'--strict: {len(wrong)} unusable bags, first {wrong[0]}',
                           remedy='leave out such bags, or leave out --strict')
        for item in wrong[:max(0, WARNED - len(self.unused))]:
            warnings.warn(f'left out: {item}', TudorWarning, stacklevel=2)
        self.unused += wrong
        if wrong and len(self.unused) > WARNED:
            warnings.warn(f'{len(self.unused)} bags are left out, the fit uses the others; see '
                          'why in the key unused of --json', TudorWarning, stacklevel=2)

    def _sample(self, seen: Sequence[SurveyedBag]) -> list[BagData]:
        """Read some bags, evenly among all; those that cannot be read are named later."""
        return spread_sample(seen, lambda item: load(
            item.choice, self.arm, self.spec, learn=True, payload=item.payload))

    def _outputs(self, bags: Sequence[BagData]) -> tuple[str, ...]:
        """Give the outputs that most bags have."""
        outputs = tuple(output for output in OUTPUTS
                        if 2 * sum(bag.has(output) for bag in bags) > len(bags))
        if not outputs:
            raise FitError('neither efforts nor strains can be read from more than half of the '
                           'bags', remedy='check the bags with `tudor info BAG`')
        return outputs

    def _count(self, text: str) -> Callable[[int], None]:
        """Report each bag that is done."""
        reported = 0

        def count(done: int) -> None:
            nonlocal reported
            for _ in range(reported, done):
                self.progress(text)
            reported = max(reported, done)
        return count


def _trials(
    gathered: Summing, test: Sequence[SurveyedBag], models: Mapping[Place, FoldModels],
) -> list[Judging]:
    """Let each group of bags be judged by models of the others, or test bags by those of all."""
    task, whole = gathered.task, {place: light(of.whole) for place, of in models.items()}
    seen_it = {(True, *place): model for place, model in whole.items()}
    found = []
    for fold in dict.fromkeys(seen.fold for seen in gathered.bags):
        blind = {} if test else {
            (False, *place): light(of.others[fold]) for place, of in models.items()}
        bags = tuple(seen for seen in gathered.bags if seen.fold == fold)
        found.append(Judging(task, bags, blind | seen_it))
    if test:
        found.append(Judging(task, tuple(test), {
            (False, *place): model for place, model in whole.items()}))
    return found
