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

What a bag comes to is a file in a folder, under a name of all that it depends on: memory does
not grow with the number of bags, and an interrupted fit goes on.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
import hashlib
import json
from pathlib import Path
import re
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from tudor_dynamics.arm.description import Arm, OUTPUTS
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import BagError, FitError, quiet, TudorError
from tudor_dynamics.files import dump_npz, read_bounded, source_digest, write_whole
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, BagFacts, facts_of, filtered, load, model_for, SurveyedBag,
    training_blocks, Unused)
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.validation import Tally, trace
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle_io import load_npz
from tudor_dynamics.models.estimation import Products
from tudor_dynamics.parallel import Count, in_processes, in_threads, width


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
        return cls(_facts(facts), {(bool(seen), int(number), str(output)): _tally(values)
                                   for seen, number, output, values in errors})


def _tally(content: dict[str, Any]) -> Tally:
    arrays: dict[str, Any] = {key: np.array(value) if isinstance(value, list) else value
                              for key, value in content.items()}
    return Tally(**arrays)


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
            raise BagError(f'has no {" and no ".join(lacking)}, which the other bags have',
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
            return SurveyedBag(choice, bag.checksum(), bag.payload() if known is None else known)
        except TudorError as err:
            return _unused(str(choice), err, base)

    found = []
    with quiet():
        for part in _divided(choices, jobs):
            found += in_threads(see, part, jobs)
            progress(len(found))
    return found


def go_through(passes: Sequence[Pass[Any]], jobs: int, progress: Progress) -> Found:
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
