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

"""What is done for each arm of a fleet: models, ring-downs, stiffness over dates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
import datetime
import hashlib
import json
from pathlib import Path

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.errors import quiet, TudorError
from tudor_dynamics.files import source_digest, write_whole
from tudor_dynamics.fleet.comparison import Observation, Quantity, rings, stiffness_quantities
from tudor_dynamics.identification.dataset import BagChoice, load, SurveyedBag, Unused
from tudor_dynamics.identification.elastic_problem import records_of
from tudor_dynamics.identification.elastic_search import identify
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.passes import PARTS, Task
from tudor_dynamics.library import fit
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.models.elastic.model import PhysicalParameter
from tudor_dynamics.parallel import Count, in_processes


# -- What is done for each arm of a fleet in a process of its own: ring-downs, and a model

Rings = list[tuple[str, float, float]]
RingPiece = tuple[Arm, PreprocessingSpec, Path, tuple[BagChoice, ...]]
Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class ModelTask:
    """A model to be made."""

    arm: Arm  # arm with its friction
    spec: PreprocessingSpec  # filters and rate
    settings: FitSettings  # settings with nothing left open
    base: Path  # directory that the names of bags are relative to
    bags: tuple[BagChoice, ...]  # bags to learn from
    checksums: tuple[str, ...]  # SHA-256 of each
    out: Path  # folder of the fleet
    name: str  # name of the arm


def ring_pieces(asked: Sequence[RingPiece], jobs: int, progress: Progress) -> list[Rings]:
    """Find the ring-downs of each arm and date; returns gauge, frequency [Hz]."""
    if not any(arm.gauges for arm, *_ in asked):
        return [[] for _ in asked]
    return in_processes(_rings, asked, jobs, progress)


def _rings(piece: RingPiece, count: Count) -> Rings:
    arm, spec, base, bags = piece
    found: Rings = []
    with quiet():
        for choice in bags:
            try:
                found += rings(arm, load(replace(choice, path=str(base / choice.path)), arm, spec))
            except TudorError:
                continue  # named when its parts were gone through
    count(1)
    return found


def made_model(piece: ModelTask, count: Count) -> Path | Unused:
    """Make the model of an arm, unless it is there."""
    out = piece.out / 'models' / piece.name
    mark = piece.out / 'sums' / f'{piece.name}.model'
    depends = hashlib.sha256(json.dumps([
        piece.arm.digest, piece.arm.spec.model_dump_json(), piece.spec.model_dump_json(),
        repr(piece.settings), [str(choice) for choice in piece.bags], piece.checksums,
        source_digest(PARTS)]).encode()).hexdigest()
    try:
        with quiet():
            if not (mark.is_file() and mark.read_text() == depends and _stands(out)):
                fit([str(piece.base / str(choice)) for choice in piece.bags], piece.arm,
                    settings=piece.settings, preprocessing=piece.spec, out=out, overwrite=True)
                write_whole(mark, depends.encode())
    except TudorError as err:
        return Unused(f'model of {piece.name}', err.advice)
    finally:
        count(1)
    return out


def _stands(out: Path) -> bool:
    try:
        load_bundle(out)
    except TudorError:
        return False
    return True


# -- Stiffnesses of a fleet: a search for the elastic model of each arm at each of its dates.
#
# What a search has found is kept with the sums of the bags, under a name of all that it depends
# on: bags, arm, filters, sources, and the date before, where the search began.

SEARCHED_WITH = (*PARTS, 'mechanics')
"""Parts of the package that a search depends on."""
Physical = tuple[PhysicalParameter, ...]
Dates = tuple[Task, tuple[Sequence[SurveyedBag], ...]]
"""What is asked of an arm, and its bags date by date."""


def stiffnesses(
    tasks: Mapping[str, Task], bags: Mapping[tuple[str, datetime.date], Sequence[SurveyedBag]],
    jobs: int, progress: Callable[[int], None],
) -> tuple[list[Observation], list[Unused]]:
    """Search for the stiffnesses of arms over time; what was found before is taken up."""
    whens = [sorted(when for when in bags if when[0] == name) for name in tasks]
    found = in_processes(_over_time, [
        (task, tuple(bags[when] for when in mine))
        for task, mine in zip(tasks.values(), whens, strict=True)], jobs, progress)
    seen: list[Observation] = []
    unused: list[Unused] = []
    for when, answer in ((when, answer) for mine, some in zip(whens, found, strict=True)
                         for when, answer in zip(mine, some, strict=True)):
        if isinstance(answer, str):
            unused.append(Unused(f'{when[0]} {when[1]}', f'no stiffness: {answer}'))
        else:
            seen += [Observation(*when, 'elastic', item) for item in answer]
    return seen, unused


def _over_time(piece: Dates, count: Count) -> list[list[Quantity] | str]:
    task, dates = piece
    found: list[list[Quantity] | str] = []
    warm: dict[str, float] | None = None
    with quiet():
        for bags in dates:
            try:
                known = _known(task, bags, warm)
            except TudorError as err:
                found.append(err.advice)
            else:
                # it is the same arm: the next date begins where this one ended
                warm = {item.name: item.value for item in known}
                found.append(stiffness_quantities(known))
            count(1)
    return found


def _known(task: Task, bags: Sequence[SurveyedBag], warm: dict[str, float] | None) -> Physical:
    """Take up what was found in the bags of a date, or search for it and keep it."""
    name = task.name(bags[0], '.json', json.dumps(
        ['elastic', source_digest(SEARCHED_WITH), warm, [task.name(bag, '') for bag in bags[1:]]]))
    known = _read(task.store.read(name))
    if known is None:
        known = identify(task.arm, records_of([task.read(bag) for bag in bags]),
                         warm=warm).physical
        task.store.write(name, json.dumps([asdict(item) for item in known]).encode())
    return known


def _read(content: bytes | None) -> Physical | None:
    """Read what a search has found; None where nothing whole is there."""
    try:
        return tuple(PhysicalParameter(**item) for item in json.loads(content or b'')) or None
    except (ValueError, TypeError):
        return None
