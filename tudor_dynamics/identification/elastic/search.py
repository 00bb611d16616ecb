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
The search for the parameters of an elastic arm.

Starts are compared first (``starts``). Then everything is searched in stages, in which the
simulated arm is drawn towards the measured strain less and less: each begins where the one before
has left errors small enough. It is drawn to the last: see ``LAST``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic.descent import descend, SearchPhase
from tudor_dynamics.identification.elastic.problem import Problem
from tudor_dynamics.identification.elastic.record import Knowledge, Record
from tudor_dynamics.identification.elastic.result import Identified, result_of, Start
from tudor_dynamics.identification.elastic.starts import CANDIDATES, COARSE, compare_starts
from tudor_dynamics.models.elastic.arm import DrivenArm, INNER_STEP
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.parallel import shared_out
from tudor_dynamics.typing import FloatArray, Progress

ENOUGH = 100.0
"""Length of what the first stages are done on [s]."""
FIRST = (SearchPhase(2.0, COARSE, 6, 1e-3), SearchPhase(1.0, COARSE, 6, 1e-3))
"""On part of the records: from where the scan ends, errors must be forgotten soon."""
LAST = (SearchPhase(0.7, INNER_STEP, 7, 1e-3), SearchPhase(0.7, INNER_STEP, 7, 1e-4))
"""On all of them. What draws the arm belongs to the parameters it began with: so it is renewed.
A last phase in which nothing draws, as the model will be used, explains the training bags better
and those of a real arm worse; of an arm that crosses its plays undamped, parameters that differ by
a tenth of their standard errors explain a recording better or worse by points of fit."""
LATE = 0.03
"""Lag of the gauges that is tried [s]: without, damping of the links takes its place."""
CLEARLY = 0.9
"""Part of the error that another start must not exceed: less says nothing about unseen motion."""
AS_GOOD, APART = 1.05, 0.2
"""Ends of searches with errors up to the former times the best tell nothing about a stiffness in
which they differ by more than the latter, as a logarithm."""


def knowledge_of(arm: Arm, *, payload: bool) -> Knowledge:
    """Collect starting values and their widths."""
    start: dict[str, float] = {}
    width: dict[str, float] = {}
    for name, value in DrivenArm(arm).parameters.items():
        kind = kind_of(name)
        value = value if value > 0.0 else kind.least
        if kind.width is not None and value > 0.0 and (name != 'payload' or payload):
            start[name], width[name] = value, kind.width
    return Knowledge(start, width)


def identify(
    arm: Arm, records: Sequence[Record], *, warm: dict[str, float] | None = None,
    knowledge: Knowledge | None = None, progress: Progress = lambda _: None,
) -> Identified:
    """
    Identify the physical parameters of an elastic arm from strain.

    knowledge: those of the description by default.
    """
    if not records or not arm.gauges:
        msg = (f'{arm.source}: the elastic model is identified from strain, and there is none; '
               'give gauges and bags with their readings')
        raise FitError(msg)
    known = knowledge or knowledge_of(
        arm, payload=any(record.payload is None for record in records))
    starts: tuple[Start, ...] = ()
    untold: tuple[str, ...] = ()
    runs = 0
    if warm is not None:
        known = known if warm.get('lag') else known.without('lag')
        finalists = [(known, np.log([max(warm.get(name, value), 1e-12)
                                     for name, value in known.start.items()]))]
    else:
        prompt = known.without('lag')
        compared = compare_starts(arm, records, prompt.names, prompt.center, prompt.width_of,
                                  progress)
        some = [record.thinned(2.0 * COARSE) for record in _some(records)]
        first = shared_out(_descended, [
            _Descent('first search', arm, some, prompt, start, FIRST)
            for start in compared.best[:CANDIDATES]], progress)
        fits = [end.fit for end in first]
        starts = compared.compared
        untold = rivals(prompt.names, [end.x for end in first], fits)
        finalists = [(prompt, first[0].x)]
        best = int(np.argmax(fits))
        if best:
            finalists.append((prompt, first[best].x))
        if 'lag' in known.start:
            found = dict(zip(prompt.names, first[best].x.tolist(), strict=True))
            late = _descended(_Descent('search with a lag', arm, some, known, np.array([
                found.get(name, np.log(LATE)) for name in known.names]), FIRST), progress)
            first.append(late)
            if chosen((fits[best], late.fit)):
                finalists.append((known, late.x))
        runs = compared.runs + sum(end.runs for end in first)
    done = shared_out(_descended, [
        _Descent('all parameters', arm, records, known, x, LAST) for known, x in finalists],
        progress)
    which = chosen([end.fit for end in done])
    known, end = finalists[which][0], done[which]
    return result_of(_problem(arm, records, known), end.x, starts,
                     runs + sum(end.runs for end in done), untold)


@dataclass(frozen=True, eq=False)
class _Descent:
    """Search from one start; also a worker of a cluster can do it."""

    name: str
    arm: Arm
    records: Sequence[Record]
    known: Knowledge
    start: FloatArray
    stages: Sequence[SearchPhase]


@dataclass(frozen=True, eq=False)
class _End:
    x: FloatArray
    fit: float
    runs: int


def _problem(arm: Arm, records: Sequence[Record], known: Knowledge) -> Problem:
    return Problem(arm, records, known.names, {}, known.center, known.width_of)


def _descended(task: _Descent, told: Progress) -> _End:
    problem = _problem(task.arm, task.records, task.known)
    x = descend(problem, task.start, task.stages, lambda k: told(
        f'elastic model, {task.name}, stage {k + 1} of {len(task.stages)}'))
    fit, = problem.fits([x])
    return _End(x, fit, problem.runs)


def taken_over(arm: Arm, records: Sequence[Record], found: Identified) -> Identified:
    """
    Take over what a search found out of the same bags behind another filter.

    The arm is the same whatever its recordings pass; gauges and errors are those of these records.
    """
    known = knowledge_of(arm, payload=any(record.payload is None for record in records))
    values = {p.name: p.value for p in found.physical}
    known = known if 'lag' in values else known.without('lag')
    x = np.log([values[name] for name in known.names])
    return result_of(_problem(arm, records, known), x, found.starts, found.runs, found.untold)


def chosen(fits: Sequence[float]) -> int:
    """Choose the first of several searches, or the best that explains clearly more: fits [%]."""
    best = int(np.argmax(fits))
    return best if 100.0 - fits[best] < CLEARLY * (100.0 - fits[0]) else 0


def rivals(
    names: tuple[str, ...], ends: Sequence[FloatArray], fits: Sequence[float],
) -> tuple[str, ...]:
    """
    Name stiffnesses that searches end at different values of, with errors as small.

    ends (names,), fits [%].
    """
    best = chosen(fits)
    good = [end for end, fit in zip(ends, fits, strict=True)
            if 100.0 - fit <= AS_GOOD * (100.0 - fits[best])]
    apart = np.ptp(good, axis=0)
    return tuple(name for name, width in zip(names, apart, strict=True)
                 if kind_of(name).adds < 0 and width > APART)


def _some(records: Sequence[Record]) -> list[Record]:
    """Take as much of each record as makes ENOUGH together."""
    total = sum(float(record.dt[1:].sum()) for record in records)
    if total <= ENOUGH:
        return list(records)
    return [record.head(float(record.dt[1:].sum()) * ENOUGH / total) for record in records]
