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

"""The search for the parameters of an elastic arm: starts, descent, stages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic_problem import (
    Identified, Knowledge, Problem, Record, result_of, reweight, Start, Straight)
from tudor_dynamics.models.elastic.arm import DrivenArm, reduced_mechanism
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.models.settings import INNER_STEP, RIGID_GEAR
from tudor_dynamics.parallel import shared_out
from tudor_dynamics.typing import FloatArray, Progress


# -- Nonlinear least squares within bounds, where several trial steps cost hardly more than one.
#
# Levenberg (1944) and Marquardt (1963): the step is that of the linearised problem, shorter the
# more it is damped. How much is not guessed from step to step: a ladder of dampings is tried at
# once, and what lowers the sum of squares most is taken. Steps that go farther than the linearised
# problem asks for are on it too: slopes by differences feel every crossing of a play, and what
# they have too much makes steps too short, one after the other in the same direction.

LADDER = 4.0 ** np.arange(-4.0, 1.0)
"""Dampings that are tried at once, relative to the last that was best."""
LONGER = (1.5, 2.0, 3.0)
"""Multiples of the least damped step that are tried with them: as many in all as run together."""
LEAST = 0.1  # damping below which nothing changes: the prior holds each unknown with 1


def minimised(
    residuals: Callable[[Sequence[FloatArray]], list[FloatArray]],
    jacobian: Callable[[FloatArray], FloatArray], begin: FloatArray,
    bounds: tuple[FloatArray, FloatArray], scale: FloatArray, *, steps: int, enough: float,
) -> FloatArray:
    """Search for the least sum of squares: begin, bounds, scale (n,); returns (n,)."""
    x = begin
    now, = residuals([x])
    cost, damping = float(now @ now), LEAST / LADDER[0]
    for _ in range(steps):
        slopes = jacobian(x) * scale
        curvature, axes = np.linalg.eigh(slopes.T @ slopes)
        downhill = -axes.T @ (slopes.T @ now)
        room = tuple((bound - x) / scale for bound in bounds)
        tried = [np.clip(x + scale * _step(np.maximum(curvature, 0.0) + damping * factor, axes,
                                           downhill, room), *bounds) for factor in LADDER]
        tried += [np.clip(x + factor * (tried[0] - x), *bounds) for factor in LONGER]
        found = residuals(tried)
        costs = [float(one @ one) for one in found]
        best = int(np.argmin(costs))
        gained = cost - costs[best]
        if gained <= 0.0:  # shorter steps are left
            damping *= LADDER[-1] / LADDER[0]
            continue
        rung = best if best < len(LADDER) else 0
        damping = max(damping * LADDER[rung], LEAST / LADDER[0])
        x, now, cost = tried[best], found[best], costs[best]
        if gained < enough * cost:
            break
    return x


def _step(
    curvature: FloatArray, axes: FloatArray, downhill: FloatArray, room: tuple[FloatArray, ...],
) -> FloatArray:
    """Solve the damped linear problem, along its axes, within what room there is."""
    step = axes @ (downhill / curvature)
    low, high = room
    if np.all(step >= low) and np.all(step <= high):
        return np.asarray(step)
    roots = np.sqrt(curvature)
    from scipy.optimize import lsq_linear  # slow to import

    return np.asarray(lsq_linear(roots[:, None] * axes.T, downhill / roots,
                                 (low, np.maximum(high, low + 1e-12)), method='bvls').x)


# -- Improving the parameters of an elastic arm from where they are, in one search or several

GAIN = 0.3  # typical change of a gauge's gain, as a logarithm
FARTHEST = 6.0  # from the prior's centre, in its standard deviations


@dataclass(frozen=True)
class SearchPhase:
    """A search by all parameters."""

    bandwidth: float  # of the draw towards measured strain [1/s], see `Problem.draw`
    inner: float  # longest inner step [s]
    steps: int  # steps to take at most, each the best of a ladder
    enough: float  # part of the sum of squares: a step that gains less ends the search


def improve(problem: Problem, x: FloatArray, steps: int, enough: float = 1e-4) -> FloatArray:
    """Search by all parameters of the problem: x (names,) or (unknowns,); returns (unknowns,)."""
    start, n = problem.extended(x), len(problem.names)
    straight = Straight(problem.names, problem.center, len(start) - n)
    with np.errstate(divide='ignore'):  # 0 has the logarithm -inf: no bound
        low, high = np.log([kind_of(name).bounds for name in problem.names]).T
    bounds = np.sort([straight.of(problem.extended(np.clip(
        problem.center + sign * FARTHEST * problem.width, low, high)))
        for sign in (-1.0, 1.0)], axis=0)
    bounds[:, n:] = [[-np.inf], [np.inf]]
    return straight.back(minimised(
        lambda several: problem.residuals([straight.back(u) for u in several]),
        lambda u: problem.jacobian(straight.back(u)) * straight.slope(u),
        np.clip(straight.of(start), *bounds), (bounds[0], bounds[1]),
        np.append(problem.width, np.full(len(start) - n, GAIN)), steps=steps, enough=enough))


def descend(
    problem: Problem, x: FloatArray, stages: Sequence[SearchPhase], report: Callable[[int], None],
) -> FloatArray:
    """Improve the parameters stage by stage: x (names,); returns (names,)."""
    for number, stage in enumerate(stages):
        report(number)
        problem.simulations.inner = stage.inner
        x = problem.draw(x, stage.bandwidth)
        reweight(problem, x)
        x = improve(problem, x, stage.steps, stage.enough)
    return problem.draw(x, 0.0)


# -- Where the search for the parameters of an elastic arm begins: frequencies first, then damping.
#
# The error of a simulated oscillation has a minimum wherever it is in phase now and then, so
# several stiffnesses are tried: a scan of one common factor over short pieces. Gear and link
# after it are springs in a row, of which oscillations show the sum; so the scan is done for
# several ways in which the two share their compliance. The best of each is improved by stiffness
# and damping alone.

FACTORS = np.exp(np.linspace(-0.9, 0.9, 37))
"""Of all stiffnesses, tried one by one: 5 % apart, 2.5 % in frequency."""
STARTS = {None: 3, 0.5: 1, 0.8: 1}
"""By the share of compliance that lies in the gears, first as described: factors to be improved
before one is chosen."""
THIN = 2  # of the factors with other shares than described, every so manieth is tried
EXCERPT = 60.0  # length of what starts are compared on, all pieces together [s]
PIECES = 4
STEPS, MORE = 5, 3
"""With which each is improved, and then the best: between a gear and its link a compliance is
shared out slowly."""
CANDIDATES = 2  # best starts, of different shares, that are improved further
COARSE = 5e-3  # inner step while starts are compared [s]


def shared(arm: Arm, names: tuple[str, ...], x: FloatArray, share: float | None) -> FloatArray:
    """Give gears a share, unless None, of the compliance that each has with the link after it."""
    x = x.copy()
    if share is None:
        return x
    mechanism = reduced_mechanism(arm)
    for joint in mechanism.beams:
        if not {f'gear({joint})', f'bending({joint})'} <= {*names}:
            continue
        gear, bending = names.index(f'gear({joint})'), names.index(f'bending({joint})')
        length = mechanism.length(joint)
        link = length / (3.0 * np.exp(x[bending]))  # slope of a cantilever by moment at its root
        both = link + np.exp(-x[gear])
        x[gear] = -np.log(share * both)
        x[bending] = np.log(length / (3.0 * (1.0 - share) * both))
    return x


def compare_starts(
    arm: Arm, records: Sequence[Record], names: tuple[str, ...], center: FloatArray,
    width: FloatArray, progress: Progress,
) -> tuple[list[FloatArray], tuple[Start, ...]]:  # and those tried
    """Find where to start: logarithms (names,), the best as described, then of other shares."""
    # beginnings of a few records, from the liveliest to the calmest
    lively = sorted(records, key=lambda r: -float(np.std(r.strain)))
    taken = [lively[i] for i in np.unique(np.linspace(0, len(lively) - 1, PIECES).astype(int))]
    pieces = [record.head(EXCERPT / len(taken)).decimated(2.0 * COARSE) for record in taken]
    scan = Problem(arm, pieces, names, {}, center, width, inner=COARSE)
    some = tuple(name for name in names if kind_of(name).early)
    index = np.array([names.index(name) for name in some], dtype=np.intp)
    starts: list[tuple[Start, FloatArray]] = []

    def better(x: FloatArray, steps: int) -> float:
        fixed = {name: float(np.exp(v)) for name, v in zip(names, x, strict=True)
                 if name not in some}
        part = Problem(arm, pieces, some, fixed, x[index], width[index], inner=COARSE)
        x[index] = improve(part, x[index], steps)
        return part.fits([x[index]])[0]

    for share, count in STARTS.items():
        progress('elastic model, stiffness')
        peaks = _peaks(scan, shared(arm, names, center, share),
                       FACTORS if share is None else FACTORS[::THIN])
        for factor, x in peaks[:count]:
            progress('elastic model, stiffness and damping')
            starts.append((Start(factor, share, better(x, STEPS)), x))
    if not starts:
        raise FitError(f'arm {arm.name!r}: the elastic model cannot be simulated on these bags '
                       'with any stiffness; check `links` and `motors` of the arm description')
    starts.sort(key=lambda item: -item[0].fit)
    first: dict[float | None, FloatArray] = {}
    for start, x in starts:
        first.setdefault(start.share, x)
    order = sorted(first, key=lambda share: share is not None)
    for share in order[:CANDIDATES]:
        better(first[share], MORE)
    return [first[share] for share in order], tuple(start for start, _ in starts)


def _peaks(
    scan: Problem, center: FloatArray, factors: FloatArray,
) -> list[tuple[float, FloatArray]]:
    """Give peaks among factors on all stiffnesses, best first, with the parameters they make."""
    stiff = np.array([i for i, name in enumerate(scan.names) if kind_of(name).adds < 0],
                     dtype=np.intp)

    def times(factor: float) -> FloatArray:
        x = center.copy()
        x[stiff] += np.log(factor)
        return x

    values = np.array(scan.fits([times(factor) for factor in factors]))
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]) & np.isfinite(values))
    return [(float(factors[peak]), times(factors[peak]))
            for peak in peaks[np.argsort(-values[peaks])]]


# -- The search for the parameters of an elastic arm.
#
# Starts are compared first (`compare_starts`). Then everything is searched in stages, in which the
# simulated arm is drawn towards the measured strain less and less: each begins where the one
# before has left errors small enough. It is drawn to the last: see ``LAST``.

ENOUGH = 100.0  # length of what the first stages are done on [s]
FIRST = (SearchPhase(2.0, COARSE, 6, 1e-3), SearchPhase(1.0, COARSE, 6, 1e-3))
"""On part of the records: from where the scan ends, errors must be forgotten soon."""
JUDGED = (FIRST[1], SearchPhase(0.7, INNER_STEP, 7, 1e-3))
"""Of gears as described and simple ones, before both are judged."""
LAST = (SearchPhase(0.7, INNER_STEP, 7, 1e-3), SearchPhase(0.7, INNER_STEP, 7, 1e-4))
"""On all of them. What draws the arm belongs to the parameters it began with: so it is renewed.
A last phase in which nothing draws, as the model will be used, explains the training bags better
and those of a real arm worse; of an arm that crosses its plays undamped, parameters that differ by
a tenth of their standard errors explain a recording better or worse by points of fit."""
LATE = 0.03  # lag of the gauges that is tried [s]: without, damping of the links takes its place
CLEARLY = 0.9
"""Part of the error that another start must not exceed: less says nothing about unseen motion."""
AS_GOOD, APART = 1.05, 0.2
"""Ends of searches with errors up to the former times the best say nothing about a stiffness in
which they differ by more than the latter, as a logarithm."""


RIGID_SHARE = 0.1  # of a link's compliance: a gear that has less is tried as rigid, without play
FAR_PLAY = 2.0  # from the described play, in deviations of the prior: such a play is tried as none
LEARNED, SIMPLE = 2.0 / 3.0, 1.2
"""Part of the recordings that simple gears are identified from, and the others again, before both
are judged by the rest, and how many times the error simple ones may leave there. Simple gears
leave up to 1.13 times, others called simple 1.69 or more (bench/other_plant.py --only simple)."""
GEAR_KINDS = ('gear', 'play', 'edge', 'tight', 'loose')


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
    """Identify the physical parameters of an elastic arm, by default as described, from strain."""
    known = knowledge or knowledge_of(
        arm, payload=any(record.payload is None for record in records))
    starts: tuple[Start, ...] = ()
    untold: tuple[str, ...] = ()
    if warm is not None:
        known = known if warm.get('lag') else known.without('lag')
        gears = {name.partition('(')[2] for name, value in warm.items()
                 if value == 0.0 and name.startswith('play')}
        known = known.holding({name: value for name, value in warm.items() if name.startswith(
            GEAR_KINDS) and name.partition('(')[2] in gears})
        finalists = [(known, np.log([max(warm.get(name, value), 1e-12)
                                     for name, value in known.start.items()]))]
    else:
        prompt = known.without('lag')
        begun, starts = compare_starts(
            arm, records, prompt.names, prompt.center, prompt.width_of, progress)
        some = [record.decimated(2.0 * COARSE) for record in _some(records)]
        first = shared_out([
            partial(_descended, 'first search', arm, some, prompt, start, FIRST)
            for start in begun[:CANDIDATES]], progress)
        fits = [end.fit for end in first]
        untold = rivals(prompt.names, [end.x for end in first], fits)
        finalists = [(prompt, first[0].x)]
        best = int(np.argmax(fits))
        if best:
            finalists.append((prompt, first[best].x))
        if 'lag' in known.start:
            found = dict(zip(prompt.names, first[best].x.tolist(), strict=True))
            late = _descended('search with a lag', arm, some, known, np.array([
                found.get(name, np.log(LATE)) for name in known.names]), FIRST, progress)
            first.append(late)
            if chosen((fits[best], late.fit)):
                finalists.append((known, late.x))
    done = shared_out([
        partial(_descended, 'all parameters', arm, records, known, x, LAST)
        for known, x in finalists], progress)
    which = chosen([end.fit for end in done])
    known, end = finalists[which][0], done[which]
    for _ in range(2):  # a gear without play may turn out to be rigid
        simple, from_there = simple_gears(arm, known, end.x)
        if simple.held == known.held:
            break
        ends = _with_simple(arm, records, (known, end.x), (simple, from_there), progress)
        if len(ends) < 3:
            break
        known, end = simple, ends[-1]
        untold = tuple(name for name in untold if name not in simple.held)
    return result_of(_problem(arm, records, known), end.x, starts, untold)


def simple_gears(arm: Arm, known: Knowledge, x: FloatArray) -> tuple[Knowledge, FloatArray]:
    """Say which gears may be simpler than described, and where a search with them begins."""
    mechanism, values = reduced_mechanism(arm), dict(zip(known.names, np.exp(x), strict=True))
    held: dict[str, float] = {}
    for joint in mechanism.beams:
        gear, play, edge, tight, loose = (f'{kind}({joint})' for kind in GEAR_KINDS)
        if not {gear, f'bending({joint})'} <= {*values}:
            continue
        doubt = (float(np.log(values[play] / known.start[play])) / known.width[play]
                 if play in values else 0.0)
        if doubt > FAR_PLAY:  # what yields within it is a spring, softer by the edge
            values[gear] *= 1.0 - 1.0 / np.hypot(1.0, values[edge])
        link = 3.0 * values[f'bending({joint})'] / mechanism.length(joint)
        rigid = link < RIGID_SHARE * values[gear]
        if rigid or abs(doubt) > FAR_PLAY:
            held[play] = 0.0
            held |= {name: float(values[name]) for name in (edge, loose) if name in values}
        if rigid:
            held[gear] = float(max(values[gear], RIGID_GEAR * link))
            held |= {tight: float(values[tight])} if tight in values else {}
    simple = known.holding(held)
    return simple, np.log([values[name] for name in simple.names])


def _with_simple(
    arm: Arm, records: Sequence[Record], found: tuple[Knowledge, FloatArray],
    simple: tuple[Knowledge, FloatArray], progress: Progress,
) -> list[_End]:
    """Search with simple gears, in all records only where a part that is left out allows it."""
    parts, rest = [], []
    for record in records:
        some = record.head(LEARNED * float(record.dt[1:].sum()))
        parts.append(some)
        rest.append(replace(record, skip=max(record.skip, len(some.q))))
    ends = shared_out([
        partial(_descended, name, arm, parts, *begun, JUDGED) for name, begun in (
            ('gears as described', found), ('simple gears', simple))], progress)
    errors = [100.0 - _problem(arm, rest, known).fits([end.x])[0]
              for (known, _), end in zip((found, simple), ends, strict=True)]
    if errors[1] <= SIMPLE * errors[0]:
        ends.append(_descended('simple gears', arm, records, simple[0], ends[1].x, LAST, progress))
    return ends


class _End(NamedTuple):
    x: FloatArray
    fit: float


def _problem(arm: Arm, records: Sequence[Record], known: Knowledge) -> Problem:
    return Problem(arm, records, known.names, known.held, known.center, known.width_of)


def _descended(
    name: str, arm: Arm, records: Sequence[Record], known: Knowledge, start: FloatArray,
    stages: Sequence[SearchPhase], progress: Progress,
) -> _End:
    """Search from one start; also a worker of a cluster can do it."""
    problem = _problem(arm, records, known)
    x = descend(problem, start, stages, lambda k: progress(
        f'elastic model, {name}, stage {k + 1} of {len(stages)}'))
    fit, = problem.fits([x])
    return _End(x, fit)


def taken_over(arm: Arm, records: Sequence[Record], found: Identified) -> Identified:
    """Take over a search after another filter; gauges and errors are those of these records."""
    known = knowledge_of(arm, payload=any(record.payload is None for record in records))
    values = {p.name: p.value for p in found.physical}
    known = known if 'lag' in values else known.without('lag')
    known = known.holding({p.name: p.value for p in found.physical if np.isnan(p.standard_error)})
    x = np.log([values[name] for name in known.names])
    return result_of(_problem(arm, records, known), x, found.starts, found.untold)


def chosen(fits: Sequence[float]) -> int:
    """Choose the first of several searches, or the best that explains clearly more: fits [%]."""
    best = int(np.argmax(fits))
    return best if 100.0 - fits[best] < CLEARLY * (100.0 - fits[0]) else 0


def rivals(
    names: tuple[str, ...], ends: Sequence[FloatArray], fits: Sequence[float],
) -> tuple[str, ...]:
    """Name stiffnesses that searches end at different values of, with fits [%] as good."""
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
