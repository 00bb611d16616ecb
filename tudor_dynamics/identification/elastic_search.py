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
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic_problem import Knowledge, Problem, Record
from tudor_dynamics.models.elastic import physical_unit, PhysicalParameter
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
HUBER = 2.0
"""Errors beyond this many standard deviations count less."""
ROUNDS = 2
"""Searches with new weights each."""
CLUSTER = 2.0
"""Errors nearer than this belong together, for the standard errors [s]."""


@dataclass(frozen=True, eq=False)
class Identified:
    """
    What was found out about an elastic arm.

    Attributes
    ----------
    physical : tuple of PhysicalParameter
        Parameters, with what the description knew of those that were not searched.
    gauges, gauge_errors : ndarray of shape (n_gauges, 2)
        Gain and offset of each gauge, and their standard deviations.
    noise : ndarray of shape (n_gauges,)
        Standard deviation of what is left over, without outliers [unit of the gauge].
    fit : float
        Of the strain on the records themselves, all channels together [%].
    starts : tuple of (float, float)
        Stiffness factors compared, with the fit each came to [%].
    runs : int
        Simulations done.

    """

    physical: tuple[PhysicalParameter, ...]
    gauges: FloatArray
    gauge_errors: FloatArray
    noise: FloatArray
    fit: float
    starts: tuple[tuple[float, float], ...]
    runs: int


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


def fit_percent(errors: FloatArray, strain: FloatArray) -> float:
    """Give the fit of all channels together, 100 (1 - |e| / |y - mean|) [%]."""
    spread = float(np.linalg.norm(strain - strain.mean(axis=0)))
    return 100.0 * (1.0 - float(np.linalg.norm(errors)) / max(spread, 1e-300))


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
        _reweight(first, x)
        x = _improve(first, x, 12)
        x = _improve(first, _loosen(first, x), 10)
        first.close()
        runs += first.runs
    problem = Problem(arm, records, names, {}, center, width, inner=INNER_STEP)
    try:
        for number in range(ROUNDS):
            progress(f'elastic model, all parameters, round {number + 1} of {ROUNDS}')
            _reweight(problem, x)
            x = _improve(problem, x, 10)
        moments = problem.moments(x)
        if moments is None:
            msg = (f'{arm.name}: the elastic model cannot be simulated along these bags; check '
                   'links and motors of the arm description')
            raise FitError(msg)
        _reweight(problem, x)
        return _result(problem, x, moments, starts, runs)
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


def _reweight(problem: Problem, x: FloatArray) -> None:
    """Weigh each gauge by its own error, outliers less (Huber)."""
    moments = problem.moments(x)
    if moments is None:
        return
    errors = problem.errors(moments)
    scale = _scale(problem, errors)
    size = np.abs(errors) / scale
    problem.weights = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-12))) / scale


def _scale(problem: Problem, errors: FloatArray) -> FloatArray:
    """Give robust standard deviations: half of the errors lie within 0.6745 of them."""
    return np.asarray(np.maximum(np.median(np.abs(errors), axis=0) / 0.6745,
                                 1e-3 * problem.strain.std(axis=0) + 1e-12))


def _improve(problem: Problem, x: FloatArray, evaluations: int) -> FloatArray:
    found = optimize.least_squares(
        problem.residual, x, problem.jacobian, x_scale=problem.width, method='trf',
        bounds=(problem.center - 6.0 * problem.width, problem.center + 6.0 * problem.width),
        ftol=1e-4, xtol=1e-4, gtol=1e-12, max_nfev=evaluations)
    return np.asarray(found.x)


def _result(
    problem: Problem, x: FloatArray, moments: FloatArray,
    starts: tuple[tuple[float, float], ...], runs: int,
) -> Identified:
    errors = problem.errors(moments)
    gains = problem.gauges(moments)
    covariance = _covariance(problem, x, errors)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    physical = []
    for i, name in enumerate(problem.names):
        value = float(np.exp(x[i]))
        physical.append(PhysicalParameter(
            name, value, physical_unit(problem.arm, name), float(value * deviation[i]),
            bool(deviation[i] < 0.5 * problem.width[i] and deviation[i] < 0.5)))
    n = len(problem.names)
    gauge_errors = np.sqrt(np.maximum(np.diag(covariance)[n:], 0.0)).reshape(-1, 2)
    return Identified(tuple(physical), gains, gauge_errors, _scale(problem, errors),
                      fit_percent(errors, problem.strain), starts, runs + problem.runs)


def _covariance(problem: Problem, x: FloatArray, errors: FloatArray) -> FloatArray:
    """
    Covariance of the logarithms, gains and offsets.

    The errors of neighbouring samples belong together, so each cluster of them counts as one
    observation (Liang and Zeger 1986); plain least squares would promise ten times too much.
    """
    slopes = problem.slopes(x)
    moments = problem.moments(x)
    assert moments is not None
    gains = problem.gauges(moments)
    n, gauges = len(x), gains.shape[0]
    p = n + 2 * gauges
    information, meat = np.zeros((p, p)), np.zeros((p, p))
    information[:n, :n] = np.diag(1.0 / problem.width**2)
    begin = 0
    for record in problem.records:
        count = len(record.q) - record.skip
        dt = float(np.median(record.dt[1:]))
        size = max(1, int(round(CLUSTER / dt)))
        for first in range(begin, begin + count, size):
            part = slice(first, min(first + size, begin + count))
            score = np.zeros(p)
            for g in range(gauges):
                w = problem.weights[part, g]
                rows = np.zeros((len(w), p))
                rows[:, :n] = (slopes[:, part, g] * gains[g, 0] * w).T
                rows[:, n + 2 * g] = moments[part, g] * w
                rows[:, n + 2 * g + 1] = w
                information += rows.T @ rows
                score += rows.T @ (errors[part, g] * w)
            meat += np.outer(score, score)
        begin += count
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    clustered = inverse @ meat @ inverse
    # Where the errors say too little to have a scatter, the prior's width is what remains.
    prior = inverse[:n, :n] @ np.diag(1.0 / problem.width**2) @ inverse[:n, :n]
    clustered[:n, :n] += prior
    return np.asarray(clustered)
