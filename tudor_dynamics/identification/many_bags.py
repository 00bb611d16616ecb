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

"""A fit to more bags than memory holds: passes over bags, sums of products, groups left out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
import copy
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
import hashlib
import json
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar
import warnings

import numpy as np

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import (
    BagError, FitError, quiet, TudorError, TudorWarning, UsageError)
from tudor_dynamics.files import dump_npz, read_bounded, source_digest, write_whole
from tudor_dynamics.identification.choice import Choices, choose
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, BagFacts, facts_of, filtered, load, model_for, spread_sample,
    SurveyedBag, training_blocks, Unused, with_recorded_gauges)
from tudor_dynamics.identification.fit import (
    enough, FitResult, FitSettings, FittedOutput, result_of)
from tudor_dynamics.identification.validation import (
    cases_of, method_of, noise_floor, Tally, trace, Validation)
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_npz
from tudor_dynamics.models.estimation import ESTIMATORS, Products, summed
from tudor_dynamics.models.friction import term_names
from tudor_dynamics.parallel import Count, elsewhere, in_processes, in_threads, width
from tudor_dynamics.typing import Progress


# -- Passes over many bags: survey, products, errors of models; one bag after the other.
#
# What a bag comes to is a file in a folder, under a name of all that it depends on: memory does
# not grow with the number of bags, and an interrupted fit goes on.

PARTS = ('arm', 'bags', 'signals', 'models', 'identification')
"""Parts of the package that sums depend on."""
LARGEST = 200_000_000  # bytes of what one bag came to
NAME = re.compile(r'[0-9a-f]{24}-[0-9a-f]{16}\.(npz|json)')
"""Of a file: checksum of the bag, digest of settings and sources."""
SUFFIX = '.sums'  # of the directory next to a bundle in which sums are kept
Place = tuple[int, str]  # number of the filters among those of a task, and the output


def forget(store: Path, used: Collection[str]) -> None:
    """Remove what bags came to under settings or sources of before."""
    for file in store.iterdir():
        if file.name not in used and NAME.fullmatch(file.name):
            file.unlink(missing_ok=True)


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked of every bag."""

    arm: Arm  # arm that was recorded, its friction settled
    specs: tuple[PreprocessingSpec, ...]  # filters and rates, all in one reading
    outputs: tuple[str, ...]  # outputs that every bag must have
    settings: FitSettings  # settings with nothing left open
    base: Path  # directory that the names of bags are relative to
    store: Path  # where sums are kept; processes and machines that go through bags all see it
    # Version of the package, by its sources.
    source: str = field(default_factory=lambda: source_digest(PARTS))

    def read(self, seen: SurveyedBag) -> BagData:
        """Read a bag by the first filters, under the name that it was given by."""
        there = replace(seen.choice, path=str(self.base / seen.choice.path))
        bag = load(there, self.arm, self.specs[0], learn=True, payload=seen.payload)
        return replace(bag, choice=replace(bag.choice, path=seen.choice.path))

    def name(self, seen: SurveyedBag, suffix: str, depends: str = '') -> str:
        """Name what a bag comes to; by other settings or sources it has another name."""
        choice = seen.choice
        own = json.dumps([choice.begin, choice.end, choice.seconds, choice.path, seen.payload,
                          self._digest, depends])
        return f'{seen.checksum[:24]}-{hashlib.sha256(own.encode()).hexdigest()[:16]}{suffix}'

    @cached_property
    def _digest(self) -> str:
        arm, settings = self.arm, self.settings
        return json.dumps([
            self.source, arm.digest, arm.spec.model_dump_json(),
            [spec.model_dump_json() for spec in self.specs], self.outputs, settings.strain_form,
            settings.shared, settings.payloads is not None])


Part = list[list[Products]]  # products of each group and channel


@dataclass(frozen=True, eq=False)
class BagSums:
    """What a bag came to."""

    facts: BagFacts  # what is known of it
    parts: Mapping[Place, Part]  # Gram matrices with triangular factors

    def dumped(self) -> bytes:
        """Write Gram matrices, and triangular factors filled up with zeros."""
        arrays: dict[str, Any] = {'facts': np.frombuffer(json.dumps(
            asdict(self.facts)).encode(), np.uint8)}
        for (number, output), part in self.parts.items():
            for i, group in enumerate(part):
                matrices = np.zeros((len(group), 2, *group[0].gram.shape))
                for both, item in zip(matrices, group, strict=True):
                    assert item.triangle is not None
                    both[0], both[1, :len(item.triangle)] = item.gram, item.triangle
                arrays[f'{number} {output} {i}'] = matrices
                arrays[f'{number} {output} {i} n'] = np.array([item.n for item in group])
        return dump_npz(arrays)

    @classmethod
    def loaded(cls, content: bytes) -> BagSums:
        """Read what was written; whatever is wrong with it is an error."""
        arrays = load_npz(content, Path('sums'))
        facts = _facts(json.loads(arrays.pop('facts').astype(np.uint8).tobytes()))
        parts: dict[Place, Part] = {}
        for name, values in arrays.items():
            number, output, _, *rest = name.split()
            if rest:
                continue
            if not np.all(np.isfinite(values)):
                raise ValueError(f'{name} is not finite')
            counts = arrays[f'{name} n'].tolist()
            parts.setdefault((int(number), output), []).append(
                [Products(gram, int(n), factor) for (gram, factor), n in
                 zip(values, counts, strict=True)])
        return cls(facts, parts)


Judged = tuple[bool, int, str]
"""Whether a model has seen the bag, number of its filters, and its output."""


@dataclass(frozen=True, eq=False)
class BagErrors:
    """How models did on a bag."""

    facts: BagFacts  # what is known of it
    errors: Mapping[Judged, Tally]  # sums of each model

    def dumped(self) -> bytes:
        """Write the sums as JSON."""
        return json.dumps([asdict(self.facts), [
            [*which, asdict(tally)] for which, tally in self.errors.items()]],
            default=np.ndarray.tolist).encode()

    @classmethod
    def loaded(cls, content: bytes) -> BagErrors:
        """Read what was written; whatever is wrong with it is an error."""
        facts, errors = json.loads(content)
        found = {}
        for seen, number, output, values in errors:
            sums: dict[str, Any] = {key: np.array(value) if isinstance(value, list) else value
                                    for key, value in values.items()}
            found[bool(seen), int(number), str(output)] = Tally(**sums)
        return cls(_facts(facts), found)


def _facts(content: dict[str, Any]) -> BagFacts:
    return BagFacts(**{**content, 'warnings': tuple(content['warnings'])})


Kept = TypeVar('Kept', BagSums, BagErrors)


@dataclass(frozen=True, eq=False)
class Pass(ABC, Generic[Kept]):
    """A pass over bags, and what it keeps of each."""

    form: ClassVar[Any]  # what it keeps, `BagSums` or `BagErrors`
    task: Task  # what is asked of every bag
    bags: tuple[SurveyedBag, ...]

    @abstractmethod
    def name(self, seen: SurveyedBag) -> str:
        """Name what is kept of a bag."""

    @abstractmethod
    def made(self, seen: SurveyedBag) -> Kept:
        """Read a bag, and make of it what is kept."""

    def found(self, seen: SurveyedBag) -> Kept | None:
        """Read what is kept of a bag; None where nothing whole is."""
        try:
            return self.form.loaded(read_bounded(self.task.store / self.name(seen), LARGEST))
        except (OSError, TudorError, ValueError, KeyError, TypeError):
            return None

    def kept(self, seen: SurveyedBag) -> Kept:
        """Read what is kept of a bag, which has to be there."""
        found = self.found(seen)
        if found is None:
            raise FitError('the intermediate results of a bag cannot be read',
                           place=self.task.store / self.name(seen),
                           remedy='fit again; do not change this folder during the fit, and let '
                                  'every machine of the fit read it')
        return found

    def by_each_filter(self, seen: SurveyedBag) -> list[BagData]:
        """Read a bag once, and filter it in all the ways that are asked for."""
        bag: BagData = self.task.read(seen)
        lacking = [output for output in OUTPUTS
                   if output in self.task.outputs and not bag.has(output)]
        if lacking:
            raise BagError(f'the bag has no {" and no ".join(lacking)}, which the other bags have',
                           place=str(bag.choice), remedy='fit this bag separately')
        return [bag, *(filtered(bag, spec) for spec in self.task.specs[1:])]


class Summing(Pass[BagSums]):
    """Bags that are multiplied out."""

    form = BagSums

    def name(self, seen: SurveyedBag) -> str:
        return self.task.name(seen, '.npz')

    def made(self, seen: SurveyedBag) -> BagSums:
        """Multiply a bag out."""
        data = self.by_each_filter(seen)
        return BagSums(facts_of(data[0]), {
            (number, output): model.products(training_blocks([bag], output, model),
                                             triangular=True)
            for number, bag in enumerate(data) for output, model in self._models.items()})

    @cached_property
    def _models(self) -> dict[str, AnalyticalModel]:
        task = self.task
        return {output: AnalyticalModel.new(task.arm, output, task.settings)
                for output in task.outputs}


@dataclass(frozen=True, eq=False)
class Judging(Pass[BagErrors]):
    """Bags with the models that are judged by them."""

    form = BagErrors
    models: Mapping[Judged, AnalyticalModel]

    def name(self, seen: SurveyedBag) -> str:
        return self.task.name(seen, '.json', self._digest)

    def made(self, seen: SurveyedBag) -> BagErrors:
        """Let the models predict a bag."""
        data = self.by_each_filter(seen)
        return BagErrors(facts_of(data[0]), {
            (seen_it, number, output): trace(
                model_for(model, data[0]), data[number], output).tally()
            for (seen_it, number, output), model in self.models.items()})

    @cached_property
    def _digest(self) -> str:
        """Give a digest of what the models predict."""
        digest = hashlib.sha256()
        for which, model in self.models.items():
            digest.update(repr(which).encode() + model.coefficients().tobytes())
        return digest.hexdigest()


Item = TypeVar('Item')
EACH = 8  # pieces of work for each process
Found = list[BagFacts | Unused]
Counted = Callable[[int], None]  # told how many are done


def survey(
    choices: Sequence[BagChoice], payloads: Mapping[str, float], base: Path, jobs: int,
    progress: Counted,
) -> list[SurveyedBag | Unused]:
    """See many bags, with payloads [kg], without reading them: in threads, for checksums."""
    def see(choice: BagChoice) -> SurveyedBag | Unused:
        path = base / choice.path
        try:
            bag = open_bag(path)
            known = payloads.get(str(path.resolve()))
            return SurveyedBag(choice, bag.checksum(), bag.payload() if known is None else known)
        except TudorError as err:
            return _unused(str(choice), err, base)

    found = []
    with quiet():
        for part in _divided(choices, jobs):
            found += in_threads(see, part, jobs)
            progress(len(found))
    return found


def go_through(passes: Sequence[Pass[Any]], jobs: int, progress: Counted) -> Found:
    """Go through the bags of some passes, and keep what each bag comes to."""
    pieces = [replace(each, bags=tuple(part)) for each in passes
              for part in _divided(each.bags, width(jobs), len(passes))]
    return [item for found in in_processes(_gone_through, pieces, jobs, progress)
            for item in found]


def _gone_through(piece: Pass[Any], count: Count) -> Found:
    """Make what is not kept yet of each bag; what is wrong with one says so instead."""
    found: Found = []
    with quiet():
        for seen in piece.bags:
            try:
                kept = piece.found(seen)
                if kept is None:
                    kept = piece.made(seen)
                    write_whole(piece.task.store / piece.name(seen), kept.dumped())
                found.append(kept.facts)
            except TudorError as err:
                found.append(_unused(str(seen.choice), err, piece.task.base))
            count(1)
    return found


def _unused(bag: str, err: TudorError, base: Path) -> Unused:
    return Unused(bag, err.advice.replace(f'{base}/', ''))


def _divided(items: Sequence[Item], jobs: int, parts: int = 1) -> list[Sequence[Item]]:
    """Divide what is one of some parts of all; not finer, as models go with each piece."""
    size = max(1, len(items) * parts // (EACH * jobs))
    return [items[first:first + size] for first in range(0, len(items), size)]


# -- The fit: models of groups of bags, left out in turn, and figures of all

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
    fewer = 'leave out stream=' if bags < FROM else f'name fewer than {FROM} bags'
    if others:
        raise UsageError(f'{said}, but {" and ".join(others)} models need all at once',
                         remedy=f'leave {" and ".join(others)} out of models=, or {fewer}')
    estimator = ESTIMATORS.get(settings.estimator)
    if estimator is not None and estimator.sample_weights is not None:
        raise UsageError(f'{said}, but {estimator.words} needs all at once',
                         remedy=f'use the estimator wls or ols, or {fewer}')
    if bags < 2:
        raise UsageError('one bag cannot be fitted bag by bag',
                         remedy='give two bags or more, or leave out stream=')
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
        every = [*bags, *test_bags]
        self.outputs = tuple(output for output in OUTPUTS
                             if 2 * sum(bag.has(output) for bag in every) > len(every))
        if not self.outputs:
            raise FitError('neither efforts nor strains can be read from more than half of the '
                           'bags', remedy='check the bags with `tudor info BAG`')
        self.held = [bag for bag in bags if all(map(bag.has, self.outputs))]
        self.held_test = [bag for bag in test_bags if all(map(bag.has, self.outputs))]

    def choose(self, settings: FitSettings) -> Choices:
        """Choose what is left open by the sample."""
        chosen = choose(self.arm, self.held, self.spec, settings, self.progress, summable=True)
        if any(term_names(joint, loaded=True) for joint in chosen.arm.joints):
            raise UsageError("the friction term 'load' needs all bags at once, not one by one",
                             remedy='remove it from joints[].friction or from the fit')
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
            raise FitError(f'a bag cannot be read any more: {lost[0]}',
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
            raise FitError(f'{len(used)} of {len(given)} training bags can be used, but 2 are '
                           f'needed; bag {self.unused[0]}', remedy='or give other bags')

    def _refuse_no_test(self, used: Sequence[object], given: Sequence[object]) -> None:
        if given and not used:
            raise FitError(f'no test bag can be used; bag {self.unused[-1]}',
                           remedy='or give other test bags')

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
                copy = Unused(str(item.choice),
                              f'has the same samples as the training bag {other.choice}')
                if some is test:
                    raise FitError(f'bag {copy}, so it does not test the model',
                                   remedy='give another recording in its place')
                wrong.append(copy)
        self._leave_out(wrong)
        self._refuse_few(found[0], training)
        self._refuse_no_test(found[1], test)
        return found

    def _leave_out(self, wrong: Sequence[Unused]) -> None:
        if wrong and self.streaming.strict:
            raise FitError(f'{len(wrong)} bags cannot be used, but strict= needs all; the first: '
                           f'{wrong[0]}', remedy='to fit without them, leave out strict=')
        for item in wrong[:max(0, WARNED - len(self.unused))]:
            warnings.warn(f'bag {item}; the fit leaves this bag out', TudorWarning, stacklevel=2)
        self.unused += wrong
        if wrong and len(self.unused) > WARNED:
            warnings.warn(f'{len(self.unused)} bags are left out of the fit; the key unused of '
                          'the JSON output says why', TudorWarning, stacklevel=2)

    def _sample(self, seen: Sequence[SurveyedBag]) -> list[BagData]:
        """Read some bags, evenly among all; those that cannot be read are named later."""
        return spread_sample(seen, lambda item: load(
            item.choice, self.arm, self.spec, learn=True, payload=item.payload))

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
