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


"""What a search for elastic parameters amounts to: weights, values, honest standard errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tudor_dynamics.errors import FitError
from tudor_dynamics.identification.elastic.explained import fit_percent, robust_scale
from tudor_dynamics.identification.elastic.problem import Problem
from tudor_dynamics.models.elastic.fitted import PhysicalParameter
from tudor_dynamics.models.elastic.parameters import physical_unit
from tudor_dynamics.typing import FloatArray

HUBER = 2.0
"""Errors beyond this many standard deviations count less."""
TOGETHER = 0.25
"""Errors nearer than this count as one in the search, against the prior [s]."""
SMOOTH = 1.0
"""How strongly simulations are drawn for standard errors [1/s]: slopes of an arm that follows
positions alone over its plays are rough, and rough slopes promise too much."""
CLUSTER = 2.0
"""Errors nearer than this belong together, for the standard errors [s]."""


@dataclass(frozen=True)
class Start:
    """A start that was tried."""

    factor: float  # on all stiffnesses
    share: float | None  # of the compliance that lies in the gears; None as described
    fit: float  # that it came to on the pieces compared, stiffness and damping improved [%]


@dataclass(frozen=True, eq=False)
class Identified:
    """What was found out about an elastic arm."""

    # Parameters, with what the description knew of those that were not searched.
    physical: tuple[PhysicalParameter, ...]
    # (gauges, 2): gain and offset of each gauge, and their standard deviations.
    gauges: FloatArray
    gauge_errors: FloatArray
    # Standard deviation of what is left over, without outliers, (gauges,) [unit of the gauge].
    noise: FloatArray
    fit: float  # of the strain on the records themselves, all channels together [%]
    starts: tuple[Start, ...]  # starts compared, with the fit each came to
    runs: int  # simulations done in all
    # Stiffnesses that searches from different starts end at different values of, as good.
    untold: tuple[str, ...] = ()


def reweight(problem: Problem, x: FloatArray) -> None:
    """Weigh each gauge by its own error, outliers less (Huber): x (unknowns,)."""
    moments = problem.moments(x)
    if moments is None:
        return
    errors = problem.errors(moments, x)
    scale = robust_scale(errors, problem.strain)
    size = np.abs(errors) / scale
    dt = float(np.median(np.concatenate([record.dt[1:] for record in problem.records])))
    weight = np.minimum(1.0, HUBER / np.maximum(size, 1e-12)) * min(1.0, dt / TOGETHER)
    problem.weights = np.sqrt(weight) / scale


def result_of(
    problem: Problem, x: FloatArray, starts: tuple[Start, ...], runs: int,
    untold: tuple[str, ...] = (),
) -> Identified:
    """Collect what was found: x (names,)."""
    for _ in range(2):  # outliers that count less move gains, and these the errors
        reweight(problem, x)
    drawn = problem.draw(x, SMOOTH)
    reweight(problem, drawn)
    covariance = _covariance(problem, drawn)
    x = problem.draw(drawn, 0.0)
    moments = problem.moments(x)
    if moments is None:
        raise FitError(_impossible(problem))
    errors = problem.errors(moments, x)
    gains = problem.gauges(moments, x)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    physical = []
    for i, name in enumerate(problem.names):
        value = float(np.exp(x[i]))
        physical.append(PhysicalParameter(
            name, value, physical_unit(problem.arm, name), float(value * deviation[i]),
            bool(deviation[i] < 0.5 * problem.width[i] and deviation[i] < 0.5
                 and name not in untold)))
    n = len(problem.names)
    gauge_errors = np.sqrt(np.maximum(np.diag(covariance)[n:], 0.0)).reshape(-1, 2)
    return Identified(tuple(physical), gains, gauge_errors, robust_scale(errors, problem.strain),
                      fit_percent(errors, problem.strain), starts, runs + problem.runs, untold)


def _impossible(problem: Problem) -> str:
    return (f'{problem.arm.name}: the elastic model cannot be simulated along these bags; check '
            'links and motors of the arm description')


def _covariance(problem: Problem, x: FloatArray) -> FloatArray:
    """
    Covariance of the logarithms, gains and offsets.

    The errors of neighbouring samples belong together, so each cluster of them counts as one
    observation (Liang and Zeger 1986); plain least squares would promise ten times too much.
    """
    slopes = problem.slopes(x)
    moments = problem.moments(x)
    if moments is None:
        raise FitError(_impossible(problem))
    errors = problem.errors(moments, x)
    gains = problem.gauges(moments, x)
    n, gauges = len(problem.names), gains.shape[0]
    p = n + 2 * gauges
    # gains act on the moments as well while these are drawn
    through = np.zeros((p, *moments.shape))
    through[:n] = slopes[:n]
    for h, slope in enumerate(slopes[n:]):
        through[n + 2 * h] = slope / gains[h, 0]
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
                rows = (through[:, part, g] * gains[g, 0] * w).T
                rows[:, n + 2 * g] += moments[part, g] * w
                rows[:, n + 2 * g + 1] = w
                information += rows.T @ rows
                score += rows.T @ (errors[part, g] * w)
            meat += np.outer(score, score)
        begin += count
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    clustered = inverse @ meat @ inverse
    # Where the errors say too little to have a scatter, the prior's width is what remains.
    prior = inverse[:, :n] @ np.diag(1.0 / problem.width**2) @ inverse[:n]
    return np.asarray(clustered + prior)
