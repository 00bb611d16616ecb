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
Bags that travel with the work to be done on them, to workers that do not see the same paths.

A parcel is packed when its turn comes, so that only a few bags are held at a time. What a worker
keeps of a bag comes back, and stands where it would stand had the worker seen this path.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import overload

from tudor_dynamics.errors import BagError
from tudor_dynamics.files import open_regular, write_whole
from tudor_dynamics.identification.bag_facts import BagFacts, Unused
from tudor_dynamics.identification.streamed.task import Sight, Trial
from tudor_dynamics.parallel import Count, in_processes

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
