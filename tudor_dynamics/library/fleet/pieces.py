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

"""What is done for each arm of a fleet in a process of its own: ring-downs, and a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import hashlib
import json
from pathlib import Path
import warnings

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.errors import TudorError, TudorWarning
from tudor_dynamics.files import write_whole
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.bag_facts import Unused
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.identification.fleet.quantities import rings
from tudor_dynamics.identification.streamed.task import PARTS
from tudor_dynamics.library.from_bags import fit
from tudor_dynamics.models.storage.bundle_io import load_bundle
from tudor_dynamics.parallel import Count, in_processes
from tudor_dynamics.source_digest import source_digest

Rings = list[tuple[str, float, float]]
RingPiece = tuple[Arm, PreprocessingSpec, Path, tuple[BagChoice, ...]]
Progress = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Model:
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
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        for choice in bags:
            try:
                found += rings(arm, load(replace(choice, path=str(base / choice.path)), arm, spec))
            except TudorError:
                continue  # told of when its parts were gone through
    count(1)
    return found


def model_pieces(
    asked: Sequence[Model], jobs: int, progress: Progress,
) -> list[Path | Unused]:
    """Make the models of arms, those that are not there yet."""
    return in_processes(_model, asked, jobs, progress)


def _model(piece: Model, count: Count) -> Path | Unused:
    out = piece.out / 'models' / piece.name
    mark = piece.out / 'sums' / f'{piece.name}.model'
    depends = hashlib.sha256(json.dumps([
        piece.arm.digest, piece.arm.spec.model_dump_json(), piece.spec.model_dump_json(),
        repr(piece.settings), [str(choice) for choice in piece.bags], piece.checksums,
        source_digest(PARTS)]).encode()).hexdigest()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', TudorWarning)
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
