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
Full parameters that can exist, nearest to the data and, where these say nothing, to a description.

The data say ``y = Y chi`` with base parameters ``chi = M pi``, where many full parameters pi give
the same chi, and an estimate of chi need not belong to any bodies that can exist. So the sum of
squares of the data themselves, kept as factors, is minimised over log-Cholesky parameters of the
bodies, together with their distance from the description in units of how far that can be trusted.
Where the data speak, thousands of samples outweigh it; bodies that they cannot tell apart share
what they show by the description's proportions, for the distance is one of logarithms.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import FitError
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.consistent.bodies import Prior, prior_of
from tudor_dynamics.models.consistent.problem import Problem, Solution
from tudor_dynamics.models.estimation.products import Products
from tudor_dynamics.typing import FloatArray

SEARCHES = ((1e-4, 1e2), (1e-2, 1e3), (1e-1, 1e3), (1.0, 1e3), (1.0, 1e4))
"""Part of their weight that the data have in each search, and how strictly friction has to take
energy: with all of both from the beginning, the way to the solution is a winding valley."""
ENOUGH = 1e-9
"""Relative change of the sum of squares at which a search ends."""
EVALUATIONS = 300


def solve_consistent(
    arm: Arm, model: AnalyticalModel, products: Sequence[Sequence[Products]],
    prior: Prior | None = None,
) -> Solution:
    """
    Find the bodies and drives behind the base parameters of an effort model.

    prior: from the description by default.
    """
    problem = Problem(arm, model, products, prior or prior_of(arm))
    x = problem.start()
    for search, (problem.trusted, problem.strict) in enumerate(SEARCHES, start=1):
        if search == len(SEARCHES):
            problem.reweigh(x)
        x = optimize.least_squares(
            problem.residual, x, problem.jacobian, method='lm', x_scale='jac', ftol=ENOUGH,
            xtol=ENOUGH, gtol=1e-12, max_nfev=EVALUATIONS).x
    if not np.all(np.isfinite(x)):
        msg = (f'{arm.name}: no bodies that can exist explain these recordings; see what '
               '`tudor info` says of them')
        raise FitError(msg)
    return problem.solution(x)


def solve_drives(
    arm: Arm, model: AnalyticalModel, products: Sequence[Sequence[Products]], prior: Prior,
) -> Solution:
    """Find the drives and torque constants that suit bodies as they are described."""
    problem = Problem(arm, model, products, prior)
    problem.trusted, problem.strict = SEARCHES[-1]
    x = problem.start()
    first = problem.first

    def whole(part: FloatArray) -> FloatArray:
        return np.concatenate([x[:first], part])

    found = optimize.least_squares(
        lambda part: problem.residual(whole(part)),
        x[first:], lambda part: problem.jacobian(whole(part))[:, first:], method='lm',
        x_scale='jac', ftol=ENOUGH, xtol=ENOUGH, gtol=1e-12, max_nfev=EVALUATIONS).x
    return problem.solution(whole(found))


def full_of(solution: Solution, scaled: NDArray[np.bool_]) -> FloatArray:
    """
    Give the full parameters of each channel, as a model's regressor takes them.

    scaled (columns,); returns (channels, columns).
    """
    full = np.concatenate([solution.bodies.ravel(), solution.drives])
    return np.array([full * np.where(scaled, 1.0 / constant, 1.0)
                     for constant in solution.constants])
