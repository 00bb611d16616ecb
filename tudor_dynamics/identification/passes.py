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

"""
Passes over many bags: survey, products, errors of models; one bag after the other.

What a bag comes to is bytes in a `Store`, under a name of all that it depends on: in memory, or on
disk, so that an interrupted fit goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, partial
import hashlib
import json
from os import SEEK_END
from pathlib import Path
import re
from tempfile import SpooledTemporaryFile
from typing import Any, TypeVar

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import BagError, FitError, quiet, TudorError
from tudor_dynamics.files import read_bounded, source_digest, write_whole
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, BagFacts, facts_of, filtered, load, model_for, OUTPUTS, SurveyedBag,
    training_blocks, Unused)
from tudor_dynamics.identification.fit import blank, FitSettings
from tudor_dynamics.identification.validation import Tally, trace
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle_io import dump_npz, load_npz
from tudor_dynamics.models.estimation import Products
from tudor_dynamics.parallel import Count, in_processes, in_threads, width


PARTS = ('arm', 'bags', 'signals', 'models', 'identification')
"""Parts of the package that sums depend on."""
SPOOLED = 256_000_000
"""Bytes of what bags came to that stay in memory."""
LARGEST = 200_000_000
"""Bytes of what one bag came to."""
NAME = re.compile(r'[0-9a-f]{24}-[0-9a-f]{16}\.(npz|json)')
"""Of a file: checksum of the bag, digest of settings and sources."""
SUFFIX = '.sums'
"""Of the directory next to a bundle in which sums are kept."""
Place = tuple[int, str]
"""Number of the filters among those of a task, and the output."""


class Memory(dict[str, bytes]):
    """What bags came to, in memory."""

    shared = False  # what other processes find is sent back

    def read(self, name: str) -> bytes | None:
        """Read what was kept; None where nothing is."""
        return self.get(name)

    def write(self, name: str, content: bytes) -> None:
        """Keep something."""
        self[name] = content

    def forget(self, used: Collection[str]) -> None:
        """Keep all: nothing is there from before."""

    def place(self, name: str) -> str:
        """Say where something is kept, in words."""
        return f'{name} in memory'


class Spool(Memory):
    """The same for many bags: what is more than memory should hold is in a nameless file."""

    def __init__(self) -> None:
        super().__init__()
        self._file = SpooledTemporaryFile(SPOOLED)
        self._places: dict[str, tuple[int, int]] = {}

    def read(self, name: str) -> bytes | None:
        """Read what was kept; None where nothing is."""
        begin, size = self._places.get(name, (0, 0))
        self._file.seek(begin)
        return self._file.read(size) or None

    def write(self, name: str, content: bytes) -> None:
        """Keep something."""
        self._places[name] = self._file.seek(0, SEEK_END), len(content)
        self._file.write(content)


@dataclass(frozen=True)
class Folder:
    """The same on disk: a directory with a file for each bag, made where it is not."""

    path: Path
    shared = True  # other processes and machines write into it

    def read(self, name: str) -> bytes | None:
        """Read what was kept; None where nothing is."""
        try:
            return read_bounded(self.path / name, LARGEST)
        except (OSError, ValueError):
            return None

    def write(self, name: str, content: bytes) -> None:
        """Keep something, whole or not at all."""
        write_whole(self.path / name, content)

    def forget(self, used: Collection[str]) -> None:
        """Remove what bags came to under settings or sources of before."""
        for file in self.path.iterdir():
            if file.name not in used and NAME.fullmatch(file.name):
                file.unlink(missing_ok=True)

    def place(self, name: str) -> str:
        """Say where something is kept, in words."""
        return str(self.path / name)


Store = Memory | Folder


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked of every bag."""

    arm: Arm  # arm that was recorded, its friction settled
    specs: tuple[PreprocessingSpec, ...]  # filters and rates, all in one reading
    outputs: tuple[str, ...]  # outputs that every bag must have
    settings: FitSettings  # settings with nothing left open
    base: Path  # directory that the names of bags are relative to
    store: Store  # where sums are kept
    # Version of the package, by its sources.
    source: str = field(default_factory=lambda: source_digest(PARTS))

    @property
    def with_payload(self) -> bool:
        """Say whether one model of all payloads is fitted."""
        return self.settings.payloads is not None

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

    def kept(self, seen: SurveyedBag) -> BagSums:
        """Read what a bag came to, which has to be there."""
        name = self.name(seen, '.npz')
        return _there(loaded_sums(self.store.read(name) or b''), self.store, name)

    @cached_property
    def _digest(self) -> str:
        arm, settings = self.arm, self.settings
        return json.dumps([
            self.source, arm.digest, arm.spec.model_dump_json(),
            [spec.model_dump_json() for spec in self.specs], self.outputs, settings.strain_form,
            settings.shared, self.with_payload])


Models = Mapping[Place, AnalyticalModel]


def digest_of(models: Models) -> str:
    """Give a digest of what models predict."""
    digest = hashlib.sha256()
    for place, model in models.items():
        digest.update(repr(place).encode() + model.coefficients().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Judging:
    """Bags with the models that are judged by them."""

    task: Task  # what is asked of every bag
    bags: tuple[SurveyedBag, ...]  # bags to predict
    # Models that have not seen these bags, and models that have; either may be none.
    unseen: Models
    seen: Models

    def name(self, seen: SurveyedBag) -> str:
        """Name how the models did on a bag."""
        return self.task.name(seen, '.json', self._digest)

    def kept(self, seen: SurveyedBag) -> BagErrors:
        """Read how the models did on a bag, which has to be there."""
        name, store = self.name(seen), self.task.store
        return _there(loaded_errors(store.read(name) or b''), store, name)

    @cached_property
    def _digest(self) -> str:
        return digest_of(self.unseen) + digest_of(self.seen)


Item = TypeVar('Item')
Part = list[list[Products]]
"""Products of each group and channel."""


@dataclass(frozen=True, eq=False)
class BagSums:
    """What a bag came to."""

    facts: BagFacts  # what is known of it
    parts: Mapping[Place, Part]  # Gram matrices with triangular factors


@dataclass(frozen=True, eq=False)
class BagErrors:
    """How models did on a bag."""

    facts: BagFacts  # what is known of it
    # Filters and output to the sums of a model that has not seen the bag, and of that of all.
    unseen: Mapping[Place, Tally]
    seen: Mapping[Place, Tally]


def dumped_sums(bag: BagSums) -> bytes:
    """Write what a bag came to: Gram matrices, triangular factors filled up with zeros."""
    arrays: dict[str, Any] = {'facts': np.frombuffer(json.dumps(
        asdict(bag.facts)).encode(), np.uint8)}
    for (number, output), part in bag.parts.items():
        for i, group in enumerate(part):
            matrices = np.zeros((len(group), 2, *group[0].gram.shape))
            for both, item in zip(matrices, group, strict=True):
                assert item.triangle is not None
                both[0], both[1, :len(item.triangle)] = item.gram, item.triangle
            arrays[f'{number} {output} {i}'] = matrices
            arrays[f'{number} {output} {i} n'] = np.array([item.n for item in group])
    return dump_npz(arrays)


def loaded_sums(content: bytes) -> BagSums | None:
    """Read what a bag came to; None where nothing whole is kept."""
    try:
        arrays = load_npz(content, Path('sums'))
        facts = _facts(json.loads(arrays.pop('facts').astype(np.uint8).tobytes()))
        parts: dict[Place, Part] = {}
        for name, values in arrays.items():
            number, output, _, *rest = name.split()
            if rest:
                continue
            if not np.all(np.isfinite(values)):
                return None
            counts = arrays[f'{name} n'].tolist()
            parts.setdefault((int(number), output), []).append(
                [Products(gram, int(n), factor) for (gram, factor), n in
                 zip(values, counts, strict=True)])
    except (TudorError, ValueError, KeyError, TypeError):
        return None
    return BagSums(facts, parts)


def dumped_errors(judged: BagErrors) -> bytes:
    """Write how models did on a bag."""
    return json.dumps({'facts': asdict(judged.facts)} | {
        models: [[*place, asdict(tally)] for place, tally in getattr(judged, models).items()]
        for models in ('unseen', 'seen')}, default=np.ndarray.tolist).encode()


def loaded_errors(content: bytes) -> BagErrors | None:
    """Read how models did on a bag; None where nothing whole is kept."""
    try:
        found = json.loads(content)
        unseen, seen = ({(int(number), str(output)): _tally(values)
                         for number, output, values in found[models]}
                        for models in ('unseen', 'seen'))
        return BagErrors(_facts(found['facts']), unseen, seen)
    except (ValueError, KeyError, TypeError):
        return None


def _tally(content: dict[str, Any]) -> Tally:
    arrays: dict[str, Any] = {key: np.array(value) if isinstance(value, list) else value
                              for key, value in content.items()}
    return Tally(**arrays)


def _there(found: Item | None, store: Store, name: str) -> Item:
    if found is None:
        raise FitError('what a bag came to cannot be read any more', place=store.place(name),
                       remedy='fit again, leave that directory alone meanwhile, and let all '
                              'machines see it')
    return found


def _facts(content: dict[str, Any]) -> BagFacts:
    return BagFacts(**{**content, 'warnings': tuple(content['warnings'])})


EACH = 8
"""Pieces of work for each process."""
Found = list[BagFacts | Unused]
Work = Callable[[Judging, Count], Found]
Answer = tuple[Found, Mapping[str, bytes]]
"""What is known of bags, and what is to be kept of them."""
Kept = TypeVar('Kept', BagSums, BagErrors)
Progress = Callable[[int], None]


def survey(
    choices: Sequence[BagChoice], payloads: Mapping[str, float], base: Path, jobs: int,
    progress: Progress,
) -> list[SurveyedBag | Unused]:
    """See many bags, with payloads [kg], without reading them: in threads, for checksums."""
    def see(choice: BagChoice) -> SurveyedBag | Unused:
        path = base / choice.path
        try:
            bag = open_bag(path)
            known = payloads.get(str(path.resolve()))
            return SurveyedBag(choice, bag.checksum(),
                               bag.payload() if known is None else known)
        except TudorError as err:
            return _unused(str(choice), err, base)

    found = []
    with quiet():
        for part in _divided(choices, jobs):
            found += in_threads(see, part, jobs)
            progress(len(found))
    return found


def gather(
    asked: Sequence[tuple[Task, Sequence[SurveyedBag]]], jobs: int, progress: Progress,
) -> Found:
    """Multiply out many bags, and keep what each came to."""
    trials = [Judging(task, tuple(bags), {}, {}) for task, bags in asked]
    return _gone_through(_gather, trials, jobs, progress)


def _sums(trial: Judging, seen: SurveyedBag) -> str:
    return trial.task.name(seen, '.npz')


def _gather(trial: Judging, count: Count) -> Found:
    task = trial.task
    models: dict[str, AnalyticalModel] = {}

    def products(seen: SurveyedBag) -> BagSums:
        for output in () if models else task.outputs:  # only where there is anything to do
            model = blank('analytical', task.arm, output, task.settings)
            assert isinstance(model, AnalyticalModel)
            models[output] = model
        data = _by_each_filter(task, seen)
        return BagSums(facts_of(data[0]), {
            (number, output): model.products(training_blocks(
                [bag], output, with_payload=task.with_payload, inputs=model.inputs),
                triangular=True)
            for number, bag in enumerate(data) for output, model in models.items()})
    return _each(trial, _sums, loaded_sums, dumped_sums, products, count)


def _by_each_filter(task: Task, seen: SurveyedBag) -> list[BagData]:
    """Read a bag once, and filter it in all the ways that are asked for."""
    bag = task.read(seen)
    lacking = [output for output in OUTPUTS if output in task.outputs and not bag.has(output)]
    if lacking:
        raise BagError(f'no {" and no ".join(lacking)}, which other bags have',
                       place=str(bag.choice), remedy='fit it apart')
    return [bag, *(filtered(bag, spec) for spec in task.specs[1:])]


def judge(trials: Sequence[Judging], jobs: int, progress: Progress) -> Found:
    """Let models predict many bags, and keep how they did."""
    return _gone_through(_judge, trials, jobs, progress)


def _gone_through(
    work: Work, trials: Sequence[Judging], jobs: int, progress: Progress,
) -> Found:
    store = trials[0].task.store
    pieces = [replace(trial, bags=tuple(part)) for trial in trials
              for part in _divided(trial.bags, width(jobs), len(trials))]
    if store.shared:
        return _joined(in_processes(work, pieces, jobs, progress))
    return _joined([_taken(store, answer) for answer in in_processes(
        partial(_returned, work), [replace(piece, task=replace(piece.task, store=Memory()))
                                   for piece in pieces], jobs, progress)])


def _returned(work: Work, trial: Judging, count: Count) -> Answer:
    assert isinstance(trial.task.store, Memory)
    return work(trial, count), trial.task.store


def _taken(store: Store, answer: Answer) -> Found:
    found, files = answer
    for name, content in files.items():
        store.write(name, content)
    return found


def _judge(trial: Judging, count: Count) -> Found:
    def tallies(seen: SurveyedBag) -> BagErrors:
        data = _by_each_filter(trial.task, seen)
        return BagErrors(facts_of(data[0]), *(
            {(number, output): trace(model_for(model, data[0]), data[number], output).tally()
             for (number, output), model in models.items()}
            for models in (trial.unseen, trial.seen)))
    return _each(trial, Judging.name, loaded_errors, dumped_errors, tallies, count)


def names_of(trials: Sequence[Judging]) -> set[str]:
    """Name all that a fit has used."""
    return {name for trial in trials for seen in trial.bags
            for name in (_sums(trial, seen), trial.name(seen))}


def _each(
    trial: Judging, name: Callable[[Judging, SurveyedBag], str],
    load: Callable[[bytes], Kept | None], dump: Callable[[Kept], bytes],
    make: Callable[[SurveyedBag], Kept], count: Count,
) -> Found:
    """Read what each bag comes to, or make and keep it; what is wrong with one says so instead."""
    found: Found = []
    store = trial.task.store
    with quiet():
        for seen in trial.bags:
            try:
                kept = load(store.read(name(trial, seen)) or b'')
                if kept is None:
                    kept = make(seen)
                    store.write(name(trial, seen), dump(kept))
                found.append(kept.facts)
            except TudorError as err:
                found.append(_unused(str(seen.choice), err, trial.task.base))
            count(1)
    return found


def _unused(bag: str, err: TudorError, base: Path) -> Unused:
    return Unused(bag, err.advice.replace(f'{base}/', ''))


def _divided(items: Sequence[Item], jobs: int, parts: int = 1) -> list[Sequence[Item]]:
    """Divide what is one of some parts of all; not finer, as models go with each piece."""
    size = max(1, len(items) * parts // (EACH * jobs))
    return [items[first:first + size] for first in range(0, len(items), size)]


def _joined(parts: Sequence[Sequence[Item]]) -> list[Item]:
    return [item for part in parts for item in part]
