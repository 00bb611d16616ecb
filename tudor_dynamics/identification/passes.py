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

"""Passes over many bags, kept on disk and continued, locally or on other machines."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
import hashlib
import json
from pathlib import Path
import re
from tempfile import TemporaryDirectory
from typing import Any, overload, TypeVar
import warnings

import numpy as np

from tudor_dynamics import parallel
from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.errors import BagError, TudorError, TudorWarning
from tudor_dynamics.files import open_regular, read_bounded, source_digest, write_whole
from tudor_dynamics.identification.dataset import (
    BagChoice, BagData, BagFacts, facts_of, filtered, load, model_for, OUTPUTS, training_blocks,
    Unused)
from tudor_dynamics.identification.fit import blank, FitSettings
from tudor_dynamics.identification.validation import Tally, trace
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle_io import dump_npz, load_npz
from tudor_dynamics.models.estimation import Products
from tudor_dynamics.parallel import Count, in_processes, in_threads, width
from tudor_dynamics.typing import FloatArray


# -- What is asked of every bag of many, and under which name what it came to is kept

PARTS = ('arm', 'bags', 'signals', 'models', 'identification')
"""Parts of the package that sums depend on."""
Place = tuple[int, str]
"""Number of the filters among those of a task, and the output."""


@dataclass(frozen=True)
class Sight:
    """A bag before it is read."""

    choice: BagChoice  # bag, or part of one, as it was given
    checksum: str  # SHA-256 over its storage files
    payload: float | None = None  # mass at the tip, as given or as its metadata say [kg]
    fold: int = -1  # which bags it is left out with


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked of every bag."""

    arm: Arm  # arm that was recorded, its friction settled
    # Filters and rates; all of them are gone through in one reading.
    specs: tuple[PreprocessingSpec, ...]
    outputs: tuple[str, ...]  # outputs that every bag must have
    settings: FitSettings  # settings with nothing left open
    base: Path  # directory that the names of bags are relative to
    folder: Path  # where sums are kept
    # Version of the package, by its sources.
    source: str = field(default_factory=lambda: source_digest(PARTS))
    # Bags, by the names they were given by, that stand elsewhere than these say.
    sent: Mapping[str, Path] = field(default_factory=dict)

    @property
    def with_payload(self) -> bool:
        """Say whether one model of all payloads is fitted."""
        return self.settings.payloads is not None

    def place(self, seen: Sight) -> Path:
        """Say where a bag stands."""
        return self.sent.get(seen.choice.path, self.base / seen.choice.path)

    def read(self, seen: Sight) -> BagData:
        """Read a bag by the first filters, under the name that it was given by."""
        there = replace(seen.choice, path=str(self.place(seen)))
        bag = load(there, self.arm, self.specs[0], learn=True, payload=seen.payload)
        return replace(bag, choice=replace(bag.choice, path=seen.choice.path))

    def file(self, seen: Sight, suffix: str, depends: str = '') -> Path:
        """Name the file of what a bag comes to; other settings or sources are another file."""
        choice = seen.choice
        own = json.dumps([choice.begin, choice.end, choice.seconds, choice.path, seen.payload,
                          self._digest, depends])
        return self.folder / (f'{seen.checksum[:24]}-'
                              f'{hashlib.sha256(own.encode()).hexdigest()[:16]}{suffix}')

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
class Trial:
    """Bags with the models that are judged by them."""

    task: Task  # what is asked of every bag
    bags: tuple[Sight, ...]  # bags to predict
    # Models that have not seen these bags, and models that have; either may be none.
    unseen: Models
    seen: Models

    def file(self, seen: Sight) -> Path:
        """Name the file of how the models did on a bag."""
        return self.task.file(seen, '.json', self._digest)

    @cached_property
    def _digest(self) -> str:
        return digest_of(self.unseen) + digest_of(self.seen)


# -- What bags came to, in files that a fit takes up again: whole, or as if they were not there

LARGEST = 200_000_000
"""Bytes of what one bag came to."""
NAME = re.compile(r'[0-9a-f]{24}-[0-9a-f]{16}\.(npz|json)')
"""Of a file: checksum of the bag, digest of settings and sources."""
Part = list[list[Products]]
"""Products of each group and channel."""


@dataclass(frozen=True, eq=False)
class KeptBag:
    """What a bag came to."""

    facts: BagFacts  # what is known of it
    # Filters and output to products, as Gram matrices with triangular factors.
    parts: Mapping[Place, Part]


@dataclass(frozen=True, eq=False)
class Judged:
    """How models did on a bag."""

    facts: BagFacts  # what is known of it
    # Filters and output to the sums of a model that has not seen the bag, and of that of all.
    unseen: Mapping[Place, Tally]
    seen: Mapping[Place, Tally]


def write_bag(path: Path, bag: KeptBag) -> None:
    """Write what a bag came to, whole or not at all."""
    arrays: dict[str, Any] = {'facts': np.frombuffer(json.dumps(
        asdict(bag.facts)).encode(), np.uint8)}
    for (number, output), part in bag.parts.items():
        for i, group in enumerate(part):
            arrays[f'{number} {output} {i}'] = np.array([_matrices(item) for item in group])
            arrays[f'{number} {output} {i} n'] = np.array([item.n for item in group])
    write_whole(path, dump_npz(arrays))


def read_bag(path: Path) -> KeptBag | None:
    """Read what a bag came to."""
    try:
        arrays = load_npz(read_bounded(path, LARGEST), path)
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
    except (TudorError, OSError, ValueError, KeyError, TypeError):
        return None
    return KeptBag(facts, parts)


def write_judged(path: Path, judged: Judged) -> None:
    """Write how models did on a bag, whole or not at all."""
    write_whole(path, json.dumps({'facts': asdict(judged.facts)} | {
        name: [[*place, _plain(tally)] for place, tally in getattr(judged, name).items()]
        for name in ('unseen', 'seen')}).encode())


def read_judged(path: Path) -> Judged | None:
    """
    Read how models did on a bag.

    path: None is given for one that is not there, as by `read_bag`.
    """
    try:
        content = json.loads(read_bounded(path, LARGEST))
        unseen, seen = ({(int(number), str(output)): _tally(values)
                         for number, output, values in content[name]}
                        for name in ('unseen', 'seen'))
        return Judged(_facts(content['facts']), unseen, seen)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def forget(folder: Path, used: Collection[Path]) -> None:
    """Remove what bags came to under settings or sources of before."""
    for file in folder.iterdir():
        if file not in used and NAME.fullmatch(file.name):
            file.unlink(missing_ok=True)


def _facts(content: dict[str, Any]) -> BagFacts:
    return BagFacts(**{**content, 'warnings': tuple(content['warnings'])})


def _plain(tally: Tally) -> list[Any]:
    values = (getattr(tally, item.name) for item in fields(Tally))
    return [value.tolist() if isinstance(value, np.ndarray) else value for value in values]


def _tally(values: Sequence[Any]) -> Tally:
    given = zip(fields(Tally), values, strict=True)
    content: dict[str, Any] = {item.name: np.array(value) if isinstance(value, list) else value
                               for item, value in given}
    return Tally(**content)


def _matrices(product: Products) -> FloatArray:
    factor = np.zeros_like(product.gram)
    assert product.triangle is not None
    factor[:len(product.triangle)] = product.triangle
    return np.array([product.gram, factor])


# -- Bags that travel with the work to be done on them, to workers that do not see the same paths.
#
# A parcel is packed when its turn comes, so that only a few bags are held at a time. What a worker
# keeps of a bag comes back, and stands where it would stand had the worker seen this path.

Found = list[BagFacts | Unused]
Work = Callable[[Trial, Count], Found]


@dataclass(frozen=True, eq=False)
class Parcel:
    """A bag, and what is to be done on it."""

    work: Work  # does it; a function of a module
    trial: Trial  # what is asked of the only bag in it
    name: str  # name of the bag's directory or file
    files: Mapping[str, bytes]  # its files; under no name if the bag is a file itself


class _Parcels(Sequence[Parcel]):
    """Parcels that are packed when they are taken."""

    def __init__(self, work: Work, trials: Sequence[Trial]) -> None:
        self._work, self._trials = work, trials

    def __len__(self) -> int:
        return len(self._trials)

    @overload
    def __getitem__(self, number: int) -> Parcel: ...

    @overload
    def __getitem__(self, number: slice) -> list[Parcel]: ...

    def __getitem__(self, number: int | slice) -> Parcel | list[Parcel]:
        if isinstance(number, slice):
            return [self[k] for k in range(*number.indices(len(self)))]
        return packed(self._work, self._trials[number])


def send(
    work: Work, trials: Sequence[Trial], kept: Callable[[Trial, Sight], Path],
    progress: Callable[[int], None],
) -> Found:
    """Do work on the cluster, each bag sent with it; here, where it was done before."""
    single = [(replace(trial, bags=(seen,)), kept(trial, seen).exists())
              for trial in trials for seen in trial.bags]
    away = [trial for trial, done in single if not done]
    before = len(single) - len(away)
    answers = iter(in_processes(unpacked, _Parcels(work, away), 1,
                                lambda more: progress(before + more)))
    found: Found = []
    for trial, done in single:
        if done:
            found += work(trial, lambda _: None)
            continue
        facts, files = next(answers)
        for name, content in files.items():
            write_whole(trial.task.folder / name, content)
        found += facts
    return found


def packed(work: Work, trial: Trial) -> Parcel:
    """Pack a bag."""
    seen, = trial.bags
    path = trial.task.place(seen)
    try:
        files = ({file.name: _content(file) for file in sorted(path.iterdir()) if file.is_file()}
                 if path.is_dir() else {'': _content(path)})
    except OSError as err:
        raise BagError(f'cannot be read ({err.strerror})', place=str(seen.choice),
                       remedy='leave the bags where they are until the fit is done') from None
    return Parcel(work, trial, path.name, files)


def unpacked(parcel: Parcel, count: Count) -> tuple[Found, dict[str, bytes]]:
    """Unpack a bag, and do the work on it."""
    seen, = parcel.trial.bags
    with TemporaryDirectory(prefix='tudor_') as scratch:
        bag, kept = Path(scratch) / 'sent' / Path(parcel.name).name, Path(scratch) / 'kept'
        (bag.parent if '' in parcel.files else bag).mkdir(parents=True)
        for name, content in parcel.files.items():
            (bag / Path(name).name if name else bag).write_bytes(content)
        kept.mkdir()
        task = replace(parcel.trial.task, folder=kept, sent={seen.choice.path: bag})
        found = parcel.work(replace(parcel.trial, task=task), count)
        files = {file.name: file.read_bytes() for file in kept.iterdir()}
    return [replace(item, why=item.why.replace(str(bag), seen.choice.path))
            if isinstance(item, Unused) else item for item in found], files


def _content(file: Path) -> bytes:
    with open_regular(file) as opened:
        return opened.read()


# -- The passes over many bags: seen, multiplied out, judged; one bag after the other, and kept

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
        try:
            bag = open_bag(path)
            known = payloads.get(str(path.resolve()))
            return Sight(choice, bag.checksum(),
                         bag.payload() if known is None else known)
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
    if parallel.sends():
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
