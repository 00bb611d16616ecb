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
The search for the parameters of an elastic arm: frequencies first, then damping, then the rest.

The error of a simulated oscillation has a minimum wherever it is in phase now and then, so the
search starts from several stiffnesses: a scan of one common factor over a short piece, the best of
them improved by stiffness and damping alone, and only the winner by everything.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic_coordinates import Straight
from tudor_dynamics.identification.elastic_problem import Knowledge, Problem, Record
from tudor_dynamics.identification.elastic_result import (
    fit_percent, Identified, result_of, reweight)
from tudor_dynamics.simulation.driven import DrivenArm, INNER_STEP

FloatArray = NDArray[np.float64]
Progress = Callable[[str], None]

WIDTHS = {'bending': 0.5, 'density': 0.1, 'lumped': 0.5, 'payload': 1.5, 'gear': 1.0,
          'play': 1.0, 'tight': 1.5, 'loose': 2.0, 'beta': 1.5}
"""How well one knows a parameter from drawings and data sheets: std of its logarithm."""
LEAST = {'payload': 0.05, 'play': 0.002, 'tight': 0.1, 'loose': 0.1, 'beta': 3e-4}
"""Starting values where the description says nothing or zero, in SI units."""
LOOSER = (1.0, 0.4, 0.15, 0.05, 0.02)
"""Factors on the damping inside the plays, tried after a first search: with little of it the
error has so many small minima that a search cannot begin there."""
FACTORS = np.exp(np.linspace(-0.9, 0.9, 37))
"""Of all stiffnesses, tried one by one: 5 % apart, 2.5 % in frequency."""
STARTS = 3
"""Of the factors, improved before one is chosen."""
EXCERPT = 60.0
"""Length of what starts are compared on, all pieces together [s]."""
PIECES = 4
ENOUGH = 100.0
"""Length of what the first search by all parameters is done on [s]."""
COARSE = 5e-3
"""Inner step while starts are compared [s]."""
ROUNDS = 2
"""Searches with new weights each."""
EVALUATIONS = 10
"""Of the residuals in a round, at most."""
FARTHEST = 6.0
"""From the prior's centre, in its standard deviations."""


def knowledge_of(arm: Arm, *, payload: bool) -> Knowledge:
    """
    Collect starting values and their widths.

    Parameters
    ----------
    arm : Arm
        Arm with ``links``.
    payload : bool
        Whether the payload is to be searched.

    Returns
    -------
    Knowledge
        Parameters to be searched.

    """
    start: dict[str, float] = {}
    width: dict[str, float] = {}
    for name, value in DrivenArm(arm).parameters.items():
        kind = name.partition('(')[0]
        if kind not in WIDTHS or (kind == 'payload' and not payload):
            continue
        start[name] = value if value > 0.0 else LEAST.get(kind, 0.0)
        width[name] = WIDTHS[kind]
        if start[name] <= 0.0:
            del start[name], width[name]
    return Knowledge(start, width)


def identify(
    arm: Arm, records: Sequence[Record], *, warm: dict[str, float] | None = None,
    knowledge: Knowledge | None = None, progress: Progress = lambda _: None,
) -> Identified:
    """
    Identify the physical parameters of an elastic arm from strain.

    Parameters
    ----------
    arm : Arm
        Arm with ``links`` and gauges.
    records : sequence of Record
        Gapless stretches.
    warm : dict of str to float, optional
        Parameters of an arm that is nearly this one: the search begins there, without scan.
    knowledge : Knowledge, optional
        Starting values and widths; those of the description by default.
    progress : callable
        Told what is done next.

    Returns
    -------
    Identified
        Parameters, gauges, and how well they explain the records.

    Raises
    ------
    FitError
        If there is nothing to compare with, or nothing could be simulated.

    """
    if not records or not arm.gauges:
        msg = (f'{arm.source}: the elastic model is identified from strain, and there is none; '
               'give gauges and bags with their readings')
        raise FitError(msg)
    known = knowledge or knowledge_of(
        arm, payload=any(record.payload is None for record in records))
    names = tuple(known.start)
    center = np.log([known.start[name] for name in names])
    width = np.array([known.width[name] for name in names])
    starts: tuple[tuple[float, float], ...] = ()
    runs = 0
    if warm is not None:
        x = np.log([max(warm.get(name, known.start[name]), 1e-12) for name in names])
    else:
        pieces = _pieces(records)
        x, starts, runs = _compare_starts(arm, pieces, names, center, width, progress)
    if warm is None:
        progress('elastic model, all parameters')
        first = Problem(arm, _some(records), names, {}, center, width, inner=COARSE)
        reweight(first, x)
        x = _improve(first, x, 12)
        x = _improve(first, _loosen(first, x), 10)
        first.close()
        runs += first.runs
    problem = Problem(arm, records, names, {}, center, width, inner=INNER_STEP)
    try:
        for number in range(ROUNDS):
            progress(f'elastic model, all parameters, round {number + 1} of {ROUNDS}')
            reweight(problem, x)
            x = _improve(problem, x, EVALUATIONS)
        moments = problem.moments(x)
        if moments is None:
            msg = (f'{arm.name}: the elastic model cannot be simulated along these bags; check '
                   'links and motors of the arm description')
            raise FitError(msg)
        reweight(problem, x)
        return result_of(problem, x, moments, starts, runs)
    finally:
        problem.close()


def _pieces(records: Sequence[Record]) -> list[Record]:
    """Take the beginnings of a few records, from the liveliest to the calmest."""
    order = sorted(records, key=lambda r: -float(np.std(r.strain)))
    chosen = [order[i] for i in np.unique(np.linspace(0, len(order) - 1, PIECES).astype(int))]
    return [record.head(EXCERPT / len(chosen)) for record in chosen]


def _loosen(problem: Problem, x: FloatArray) -> FloatArray:
    """Choose the damping inside the plays among a few multiples."""
    inside = [i for i, name in enumerate(problem.names) if name.startswith('loose(')]
    tried = []
    for factor in LOOSER:
        other = x.copy()
        other[inside] += np.log(factor)
        tried.append((float(np.sum(problem.residual(other) ** 2)), factor, other))
    return min(tried, key=lambda item: item[:2])[2]


def _some(records: Sequence[Record]) -> list[Record]:
    """Take as much of each record as makes ENOUGH together."""
    total = sum(float(record.dt[1:].sum()) for record in records)
    if total <= ENOUGH:
        return list(records)
    return [record.head(float(record.dt[1:].sum()) * ENOUGH / total) for record in records]


def _stiff(names: tuple[str, ...]) -> NDArray[np.intp]:
    return np.array([i for i, name in enumerate(names)
                     if name.startswith(('bending(', 'gear('))], dtype=np.intp)


def _compare_starts(
    arm: Arm, pieces: list[Record], names: tuple[str, ...], center: FloatArray,
    width: FloatArray, progress: Progress,
) -> tuple[FloatArray, tuple[tuple[float, float], ...], int]:
    progress('elastic model, stiffness')
    scan = Problem(arm, pieces, names, {}, center, width, inner=COARSE)
    stiff = _stiff(names)
    found = []
    for factor in FACTORS:
        x = center.copy()
        x[stiff] += np.log(factor)
        moments = scan.moments(x)
        found.append(-np.inf if moments is None else fit_percent(
            scan.errors(moments), scan.strain))
    scan.close()
    values = np.array(found)
    if not np.isfinite(values).any():
        msg = (f'{arm.name}: the elastic model cannot be simulated along these bags with any '
               'stiffness; check links and motors of the arm description')
        raise FitError(msg)
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    peaks = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:])
                           & np.isfinite(values))
    peaks = peaks[np.argsort(-values[peaks])][:STARTS]
    some = tuple(name for name in names
                 if name.startswith(('bending(', 'gear(', 'tight(', 'loose(', 'beta', 'payload')))
    index = np.array([names.index(name) for name in some], dtype=np.intp)
    best: tuple[float, FloatArray] | None = None
    starts: list[tuple[float, float]] = []
    runs = scan.runs
    for peak in peaks:
        progress('elastic model, stiffness and damping')
        x = center.copy()
        x[stiff] += np.log(FACTORS[peak])
        fixed = {name: float(np.exp(v)) for name, v in zip(names, x, strict=True)
                 if name not in some}
        part = Problem(arm, pieces, some, fixed, x[index], width[index], inner=COARSE)
        x[index] = _improve(part, x[index], 8)
        moments = part.moments(x[index])
        part.close()
        runs += part.runs
        reached = -np.inf if moments is None else fit_percent(part.errors(moments), part.strain)
        starts.append((float(FACTORS[peak]), reached))
        if best is None or reached > best[0]:
            best = reached, x
    assert best is not None
    return best[1], tuple(starts), runs


def _improve(problem: Problem, x: FloatArray, evaluations: int) -> FloatArray:
    straight = Straight(problem.names, problem.center)
    bounds = np.sort([straight.of(problem.center + sign * FARTHEST * problem.width)
                      for sign in (-1.0, 1.0)], axis=0)
    found = optimize.least_squares(
        lambda u: problem.residual(straight.back(u)), straight.of(x),
        lambda u: problem.jacobian(straight.back(u)) * straight.slope(u),
        x_scale=problem.width, method='trf', bounds=bounds, ftol=1e-4, xtol=1e-4, gtol=1e-12,
        max_nfev=evaluations)
    return straight.back(found.x)
