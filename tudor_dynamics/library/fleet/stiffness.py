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

"""Stiffnesses of a fleet: a search for the elastic model of each arm at each of its dates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import datetime
from pathlib import Path
import warnings

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.errors import TudorError, TudorWarning
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.bag_facts import Unused
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.identification.elastic.record import records_of
from tudor_dynamics.identification.elastic.search import identify
from tudor_dynamics.identification.fleet.quantities import Quantity, stiffness_quantities
from tudor_dynamics.library.fleet.outcome import Seen
from tudor_dynamics.parallel import Count, in_processes

Loads = Sequence[tuple[BagChoice, float | None]]
"""Bags, and what the arm carried in each [kg]."""


@dataclass(frozen=True, eq=False)
class _Piece:
    """The dates of an arm, in order."""

    arm: Arm
    spec: PreprocessingSpec
    base: Path
    dates: tuple[Loads, ...]


def stiffnesses(
    arms: Mapping[str, Arm], bags: Mapping[tuple[str, datetime.date], Loads],
    spec: PreprocessingSpec, base: Path, jobs: int, progress: Callable[[int], None],
) -> tuple[list[Seen], list[Unused]]:
    """
    Search for the stiffnesses of arms over time.

    Parameters
    ----------
    arms : mapping of str to Arm
        Arms by name.
    bags : mapping of (str, date) to sequence of (BagChoice, float or None)
        What was recorded of an arm at a date.
    spec : PreprocessingSpec
        Filters and rate.
    base : Path
        Directory that names are relative to.
    jobs : int
        Number of processes.
    progress : callable
        Told how many searches are done.

    Returns
    -------
    list of Seen, list of Unused
        Stiffnesses that the recordings have told; dates of which none were found.

    """
    whens = [sorted(when for when in bags if when[0] == name) for name in arms]
    found = in_processes(_over_time, [
        _Piece(arm, spec, base, tuple(bags[when] for when in mine))
        for arm, mine in zip(arms.values(), whens, strict=True)], jobs, progress)
    seen: list[Seen] = []
    unused: list[Unused] = []
    for when, told in ((when, told) for mine, some in zip(whens, found, strict=True)
                       for when, told in zip(mine, some, strict=True)):
        if isinstance(told, str):
            unused.append(Unused(f'{when[0]} {when[1]}', f'no stiffness: {told}'))
        else:
            seen += [Seen(*when, 'elastic', item) for item in told]
    return seen, unused


def _over_time(piece: _Piece, count: Count) -> list[list[Quantity] | str]:
    found: list[list[Quantity] | str] = []
    warm: dict[str, float] | None = None
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        for bags in piece.dates:
            try:
                known = identify(piece.arm, records_of([
                    load(replace(choice, path=str(piece.base / choice.path)), piece.arm,
                         piece.spec, payload=mass) for choice, mass in bags]), warm=warm)
            except TudorError as err:
                found.append(err.advice)
            else:
                # it is the same arm: the next date begins where this one ended
                warm = {item.name: item.value for item in known.physical}
                found.append(stiffness_quantities(known.physical))
            count(1)
    return found
