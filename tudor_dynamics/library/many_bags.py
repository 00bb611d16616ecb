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

"""A fit to more bags than memory holds: which of them, in how many passes, kept where."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import warnings

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.doctor.bags import examine_bags
from tudor_dynamics.errors import FitError, TudorError, TudorWarning, UsageError
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.bag_facts import Unused
from tudor_dynamics.identification.choice.choose import choose
from tudor_dynamics.identification.dataset import BagData, load, OUTPUTS
from tudor_dynamics.identification.fit import FitResult, FitSettings
from tudor_dynamics.identification.payloads import payload_range
from tudor_dynamics.identification.streamed.fit import Streamed
from tudor_dynamics.identification.streamed.kept import forget
from tudor_dynamics.identification.streamed.passes import files_of, gather, judge, survey
from tudor_dynamics.identification.streamed.sums import ErrorSums, fold_of, FoldSums, light
from tudor_dynamics.identification.streamed.task import Place, Sight, Task, Trial
from tudor_dynamics.library.recorded_gauges import with_recorded_gauges
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.typing import Progress


FROM = 33
"""Bags from which a fit is streamed without being asked to."""
SAMPLE = 8
"""Bags that stay in memory, for choices, thresholds and figures."""
TOLD = 5
"""Bags left out that are warned of one by one."""
SUFFIX = '.sums'
"""Of the directory beside a bundle in which sums are kept."""


@dataclass(frozen=True)
class Streaming:
    """How many bags are gone through."""

    # Where sums of each bag are kept, to go on after an interruption; made where it is not.
    folder: Path
    jobs: int = 1  # number of processes
    strict: bool = False  # refuse a bag that cannot be used, in place of leaving it out


def streams(bags: int, settings: FitSettings, *, asked: bool = False) -> bool:
    """Say whether a fit goes bag by bag."""
    if not asked and bags < FROM:
        return False
    others = [kind for kind in settings.kinds if kind != 'analytical']
    said = f'{bags} bags are gone through one by one'
    if others or settings.random_split:
        what = '--random-split' if not others else ' and '.join(others)
        raise UsageError(f'{said}, and {what} needs all of them at once',
                         remedy=f'leave it out, or name fewer than {FROM} bags')
    if settings.estimator == 'huber':
        raise UsageError(f"{said}, and the weights of Huber's estimator depend on all of them",
                         remedy=f'use wls or ols, or name fewer than {FROM} bags')
    if bags < 2:
        raise UsageError('a single bag is not gone through bag by bag',
                         remedy='leave --stream out')
    return True


def fit_many(
    arm: Arm,
    training: Sequence[BagChoice],
    test: Sequence[BagChoice],
    preprocessing: PreprocessingSpec,
    settings: FitSettings,
    payloads: Mapping[str, float],
    streaming: Streaming,
    progress: Progress = lambda _: None,
    *,
    ignore_payload: bool = False,
) -> FitResult:
    """
    Fit analytical models to any number of bags.

    What is left open is chosen by a sample of the bags, which thresholds and figures come from as
    well. Models and validation are of all of them.

    payloads [kg].
    """
    many = _Many(arm, settings, preprocessing, streaming, progress)
    return many.fit(training, test, payloads, ignore_payload=ignore_payload)


class _Many:
    """The steps of a fit to many bags, and what they share."""

    def __init__(
        self, arm: Arm, settings: FitSettings, spec: PreprocessingSpec, streaming: Streaming,
        progress: Progress,
    ) -> None:
        self.arm, self.settings, self.spec = arm, settings, spec
        self.streaming, self.progress, self.base = streaming, progress, Path.cwd()
        self.unused: list[Unused] = []

    def fit(
        self, choices: Sequence[BagChoice], tests: Sequence[BagChoice],
        payloads: Mapping[str, float], *, ignore_payload: bool,
    ) -> FitResult:
        """Go through all bags three times: seen, multiplied out, judged."""
        seen = survey([*choices, *tests], payloads, self.base, self.streaming.jobs,
                      self._count('see bags'))
        training, test = self._told_apart(seen[:len(choices)], seen[len(choices):])
        found = None if ignore_payload else payload_range(training, test)
        if found is not None:
            self.settings = replace(self.settings, payloads=found)
        bags, test_bags = self._sample(training), self._sample(test)
        recorded = with_recorded_gauges(self.arm, [bag.choice for bag in (*bags, *test_bags)])
        if recorded is not self.arm:
            self.arm = recorded
            bags, test_bags = self._sample(training), self._sample(test)
        outputs = self._outputs([*bags, *test_bags])
        bags, test_bags = ([bag for bag in some if all(map(bag.has, outputs))]
                           for some in (bags, test_bags))
        chosen = choose(self.arm, bags, self.spec, self.settings, self.progress, summable=True)
        if any('load' in joint.friction for joint in chosen.arm.joints):
            raise UsageError('friction that grows with the load is not fitted bag by bag: its '
                             'rows depend on all of them', remedy='leave the term load out')
        self.progress('doctor')
        findings = examine_bags(chosen.arm, [*bags, *test_bags])
        specs = [chosen.preprocessing]
        if chosen.preprocessing.filter == 'zero_phase':  # causal ones run beside the robot
            specs.append(chosen.preprocessing.model_copy(update={'filter': 'causal'}))
        task = Task(chosen.arm, tuple(specs), outputs, chosen.settings, self.base,
                    self.streaming.folder.absolute())
        done = self._streamed(task, training, test, bags, test_bags)
        result = replace(done.result(0), findings=findings, choices=chosen.made)
        return result if len(specs) == 1 else replace(result, causal=done.result(1))

    def _streamed(
        self, task: Task, training: Sequence[Sight], test: Sequence[Sight],
        bags: Sequence[BagData], test_bags: Sequence[BagData],
    ) -> Streamed:
        facts = gather([(task, training)], self.streaming.jobs, self._count('multiply out'))
        used = [(seen, item) for seen, item in zip(training, facts, strict=True)
                if not isinstance(item, Unused)]
        self._leave_out([item for item in facts if isinstance(item, Unused)])
        if len(used) < 2:
            raise FitError(f'of {len(training)} bags {len(used)} can be used: {self.unused[0]}',
                           remedy='give others')
        known = [replace(seen, fold=fold_of(i, len(used))) for i, (seen, _) in enumerate(used)]
        sums = FoldSums(task)
        for seen in known:
            self.progress('add up')
            sums.add(seen)
        self.progress('fit')
        models, others = {}, {}
        for place in sums.parts:
            models[place], others[place] = sums.models(place)
        trials = _trials(task, known, test, models, others)
        told = judge(trials, self.streaming.jobs, self._count('judge'))
        lost = [item for item in told[:len(known)] if isinstance(item, Unused)]
        if lost:
            raise FitError(f'{lost[0]}, though it could be read before',
                           remedy='fit again, and leave the bags alone meanwhile')
        judged = [item for item in told[len(known):] if not isinstance(item, Unused)]
        self._leave_out([item for item in told[len(known):] if isinstance(item, Unused)])
        if test and not judged:
            raise FitError(f'no test bag can be used: {self.unused[-1]}', remedy='give others')
        errors = ErrorSums()
        files = [trial.file(seen) for trial in trials for seen in trial.bags]
        for file, item in zip(files, told, strict=True):
            if not isinstance(item, Unused):
                errors.add(file)
        forget(task.folder, files_of(trials))
        folds = {str(item.choice): item.fold for item in known}
        return Streamed(
            task, models, others, tuple(item for _, item in used), tuple(judged),
            tuple(self.unused), errors.unseen, errors.seen,
            tuple(bag for bag in bags if str(bag.choice) in folds), tuple(test_bags), folds)

    def _told_apart(
        self, training: Sequence[Sight | Unused], test: Sequence[Sight | Unused],
    ) -> tuple[list[Sight], list[Sight]]:
        """Leave out what cannot be opened, and copies; a copy of a training bag is no test."""
        known: dict[str, list[Sight]] = {}
        found: tuple[list[Sight], list[Sight]] = ([], [])
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
                copy = Unused(str(item.choice), f'has the very bytes of the training bag '
                                                f'{other.choice} (sha256 {item.checksum[:12]})')
                if some is test:
                    raise FitError(f'{copy}: a copy is no test of what was learned from it',
                                   remedy='give another recording')
                wrong.append(copy)
        self._leave_out(wrong)
        if len(found[0]) < 2:
            raise FitError(f'of {len(training)} bags {len(found[0])} can be used: '
                           f'{self.unused[0]}', remedy='give others')
        if test and not found[1]:
            raise FitError(f'no test bag can be used: {self.unused[-1]}', remedy='give others')
        return found

    def _leave_out(self, wrong: Sequence[Unused]) -> None:
        if wrong and self.streaming.strict:
            more = f' (and {len(wrong) - 1} more)' if len(wrong) > 1 else ''
            raise FitError(f'--strict: {wrong[0]}{more}', remedy='leave it out, or --strict')
        for item in wrong[:max(0, TOLD - len(self.unused))]:
            warnings.warn(f'left out: {item}', TudorWarning, stacklevel=2)
        self.unused += wrong
        if wrong and len(self.unused) > TOLD:
            warnings.warn(f'{len(self.unused)} bags are left out; the bundle and --json name all',
                          TudorWarning, stacklevel=2)

    def _sample(self, seen: Sequence[Sight]) -> list[BagData]:
        """Read some bags, evenly among all; those that cannot be read are told of later."""
        edges = [i * len(seen) // SAMPLE for i in range(SAMPLE + 1)]
        found = []
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', TudorWarning)
            for first, last in zip(edges[:-1], edges[1:], strict=True):
                for item in seen[first:last]:
                    try:
                        found.append(load(item.choice, self.arm, self.spec, learn=True,
                                          payload=item.payload))
                    except TudorError:
                        continue
                    break
        return found

    def _outputs(self, bags: Sequence[BagData]) -> tuple[str, ...]:
        """Give the outputs that most bags have."""
        outputs = tuple(output for output in OUTPUTS
                        if 2 * sum(bag.has(output) for bag in bags) > len(bags))
        if not outputs:
            raise FitError('most bags can neither be read nor have efforts or strains in common',
                           remedy='tudor info BAG says what is in one')
        return outputs

    def _count(self, text: str) -> Callable[[int], None]:
        """Tell each bag that is done."""
        told = 0

        def count(done: int) -> None:
            nonlocal told
            for _ in range(told, done):
                self.progress(text)
            told = max(told, done)
        return count


def _trials(
    task: Task, known: Sequence[Sight], test: Sequence[Sight],
    models: Mapping[Place, AnalyticalModel],
    others: Mapping[Place, Mapping[int, AnalyticalModel]],
) -> list[Trial]:
    """Let each group of bags be judged by models of the others, or test bags by those of all."""
    whole = {place: light(model) for place, model in models.items()}
    found = []
    for fold in dict.fromkeys(seen.fold for seen in known):
        blind = {} if test else {place: light(of[fold]) for place, of in others.items()}
        found.append(Trial(task, tuple(seen for seen in known if seen.fold == fold), blind,
                           whole))
    return [*found, Trial(task, tuple(test), whole, {})] if test else found
