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

"""Improving the parameters of an elastic arm from where they are, in one search or several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tudor_dynamics.identification.elastic.coordinates import Straight
from tudor_dynamics.identification.elastic.ladder import minimised
from tudor_dynamics.identification.elastic.problem import Problem
from tudor_dynamics.identification.elastic.result import reweight
from tudor_dynamics.models.elastic.parameters import kind_of
from tudor_dynamics.typing import FloatArray

GAIN = 0.3
"""Typical change of a gauge's gain, as a logarithm."""
FARTHEST = 6.0
"""From the prior's centre, in its standard deviations."""


@dataclass(frozen=True)
class SearchPhase:
    """A search by all parameters."""

    # How strongly the simulation is drawn towards the measured strain, see `Problem.draw` [1/s].
    bandwidth: float
    inner: float  # longest inner step [s]
    steps: int  # steps to take at most, each the best of a ladder
    enough: float  # part of the sum of squares: a step that gains less ends the search


def improve(
    problem: Problem, x: FloatArray, steps: int, enough: float = 1e-4,
) -> FloatArray:
    """Search by all parameters of the problem: x (names,) or (unknowns,); returns (unknowns,)."""
    straight = Straight(problem.names, problem.center)
    n = len(problem.names)

    def of(u: FloatArray) -> FloatArray:
        return np.concatenate([straight.back(u[:n]), u[n:]])

    def slope(u: FloatArray) -> FloatArray:
        return np.concatenate([straight.slope(u[:n]), np.ones(len(u) - n)])

    start = problem.extended(x)
    free = np.full(len(start) - n, np.inf)
    with np.errstate(divide='ignore'):  # 0 has the logarithm -inf: no bound
        low, high = np.log([kind_of(name).bounds for name in problem.names]).T
    bounds = np.sort([np.concatenate([straight.of(np.clip(
        problem.center + sign * FARTHEST * problem.width, low, high)), sign * free])
        for sign in (-1.0, 1.0)], axis=0)
    begin = np.clip(np.concatenate([straight.of(start[:n]), start[n:]]), *bounds)
    return of(minimised(
        lambda several: problem.residuals([of(u) for u in several]),
        lambda u: problem.jacobian(of(u)) * slope(u), begin, (bounds[0], bounds[1]),
        np.concatenate([problem.width, np.full(len(free), GAIN)]), steps=steps,
        enough=enough))


def descend(
    problem: Problem, x: FloatArray, stages: Sequence[SearchPhase], told: Callable[[int], None],
) -> FloatArray:
    """Improve the parameters stage by stage: x (names,); returns (names,)."""
    for number, stage in enumerate(stages):
        told(number)
        problem.inner = stage.inner
        x = problem.draw(x, stage.bandwidth)
        reweight(problem, x)
        x = improve(problem, x, stage.steps, stage.enough)
    return problem.draw(x, 0.0)
