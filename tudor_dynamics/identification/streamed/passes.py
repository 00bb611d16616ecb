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

"""The passes over many bags: seen, multiplied out, judged; one bag after the other, and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar
import warnings

from tudor_dynamics import cluster
from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.reader import stated_payload
from tudor_dynamics.errors import BagError, TudorError, TudorWarning
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.bag_facts import BagFacts, facts_of, Unused
from tudor_dynamics.identification.dataset import BagData, filtered, OUTPUTS, training_blocks
from tudor_dynamics.identification.payloads import model_for
from tudor_dynamics.identification.streamed.kept import (
    Judged, KeptBag, read_bag, read_judged, write_bag, write_judged)
from tudor_dynamics.identification.streamed.sending import send, Work
from tudor_dynamics.identification.streamed.task import Sight, Task, Trial
from tudor_dynamics.identification.trainers import blank
from tudor_dynamics.identification.validation import trace
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.parallel import Count, in_processes, in_threads, width

EACH = 8
"""Pieces of work for each process."""
Item = TypeVar('Item')
Result = TypeVar('Result')
Progress = Callable[[int], None]


def survey(
    choices: Sequence[BagChoice], payloads: Mapping[str, float], base: Path, jobs: int,
    progress: Progress,
) -> list[Sight | Unused]:
    """
    See many bags without reading them: in threads, as checksums need no more.

    payloads [kg].
    """
    def see(choice: BagChoice) -> Sight | Unused:
        path = base / choice.path
        notes = Notes(str(path))
        try:
            bag = open_bag(path, notes)
            known = payloads.get(str(path.resolve()))
            return Sight(choice, bag.checksum(),
                         stated_payload(bag, notes) if known is None else known)
        except TudorError as err:
            return _unused(str(choice), err, base)

    found = []
    with _quiet():
        for part in _divided(choices, jobs):
            found += in_threads(see, part, jobs)
            progress(len(found))
    return found


def gather(
    asked: Sequence[tuple[Task, Sequence[Sight]]], jobs: int, progress: Progress,
) -> list[BagFacts | Unused]:
    """Multiply out many bags, and keep what each came to in its file."""
    trials = [Trial(task, tuple(bags), {}, {}) for task, bags in asked]
    return _gone_through(_gather, trials, _sums, jobs, progress)


def _sums(trial: Trial, seen: Sight) -> Path:
    return trial.task.file(seen, '.npz')


def _gather(trial: Trial, count: Count) -> list[BagFacts | Unused]:
    task = trial.task
    models: dict[str, AnalyticalModel] = {}

    def products(seen: Sight) -> BagFacts:
        file = _sums(trial, seen)
        kept = read_bag(file)
        if kept is None:
            for output in () if models else task.outputs:  # only where there is anything to do
                model = blank('analytical', task.arm, output, task.settings)
                assert isinstance(model, AnalyticalModel)
                models[output] = model
            kept = _multiplied(task, _complete(task, task.read(seen)), models)
            write_bag(file, kept)
        return kept.facts
    return _each(trial.bags, products, count, task.base)


def _multiplied(task: Task, bag: BagData, models: dict[str, AnalyticalModel]) -> KeptBag:
    parts = {}
    for number, spec in enumerate(task.specs):
        data = bag if number == 0 else filtered(bag, spec)
        for output, model in models.items():
            blocks = training_blocks([data], output, with_payload=task.with_payload,
                                     inputs=model.inputs)
            parts[number, output] = model.products(blocks, triangular=True)
    return KeptBag(facts_of(bag), parts)


def _complete(task: Task, bag: BagData) -> BagData:
    lacking = [output for output in OUTPUTS if output in task.outputs and not bag.has(output)]
    if lacking:
        raise BagError(f'no {" and no ".join(lacking)}, which other bags have',
                       place=str(bag.choice), remedy='fit it apart')
    return bag


def judge(trials: Sequence[Trial], jobs: int, progress: Progress) -> list[BagFacts | Unused]:
    """Let models predict many bags, and keep how they did in files."""
    return _gone_through(_judge, trials, Trial.file, jobs, progress)


def _gone_through(
    work: Work, trials: Sequence[Trial], kept: Callable[[Trial, Sight], Path], jobs: int,
    progress: Progress,
) -> list[BagFacts | Unused]:
    if cluster.sends():
        return send(work, trials, kept, progress)
    pieces = [replace(trial, bags=tuple(part)) for trial in trials
              for part in _divided(trial.bags, width(jobs), len(trials))]
    return _joined(in_processes(work, pieces, jobs, progress))


def _judge(trial: Trial, count: Count) -> list[BagFacts | Unused]:
    task = trial.task

    def tallies(seen: Sight) -> BagFacts:
        file = trial.file(seen)
        judged = read_judged(file)
        if judged is None:
            bag = _complete(task, task.read(seen))
            data = [bag, *(filtered(bag, spec) for spec in task.specs[1:])]
            judged = Judged(facts_of(bag), *(
                {(number, output): trace(model_for(model, bag), data[number], output).tally()
                 for (number, output), model in models.items()}
                for models in (trial.unseen, trial.seen)))
            write_judged(file, judged)
        return judged.facts
    return _each(trial.bags, tallies, count, task.base)


def files_of(trials: Sequence[Trial]) -> set[Path]:
    """Name the files that a fit has used."""
    found = set()
    for trial in trials:
        for seen in trial.bags:
            found |= {_sums(trial, seen), trial.file(seen)}
    return found


def _each(
    bags: Sequence[Sight], work: Callable[[Sight], Result], count: Count, base: Path,
) -> list[Result | Unused]:
    """Go through bags; what is wrong with one says so in its place."""
    found: list[Result | Unused] = []
    with _quiet():
        for seen in bags:
            try:
                found.append(work(seen))
            except TudorError as err:
                found.append(_unused(str(seen.choice), err, base))
            count(1)
    return found


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep warnings back: they stand among the facts of each bag."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        yield


def _unused(bag: str, err: TudorError, base: Path) -> Unused:
    return Unused(bag, err.advice.replace(f'{base}/', ''))


def _divided(items: Sequence[Item], jobs: int, parts: int = 1) -> list[Sequence[Item]]:
    """Divide what is one of some parts of all; not finer, as models go with each piece."""
    size = max(1, len(items) * parts // (EACH * jobs))
    return [items[first:first + size] for first in range(0, len(items), size)]


def _joined(parts: Sequence[Sequence[Item]]) -> list[Item]:
    return [item for part in parts for item in part]
