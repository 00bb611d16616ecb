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
Nonlinear least squares within bounds, where several trial steps cost hardly more than one.

Levenberg (1944) and Marquardt (1963): the step is that of the linearised problem, shorter the more
it is damped. How much is not guessed from step to step: a ladder of dampings is tried at once, and
what lowers the sum of squares most is taken. Steps that go farther than the linearised problem
asks for are on it too: slopes by differences feel every crossing of a play, and what they have too
much makes steps too short, one after the other in the same direction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from tudor_dynamics.typing import FloatArray

LADDER = 4.0 ** np.arange(-4.0, 1.0)
"""Dampings that are tried at once, relative to the last that was best."""
LONGER = (1.5, 2.0, 3.0)
"""Multiples of the least damped step that are tried with them: as many in all as run together."""
LEAST = 0.1
"""Damping below which nothing changes: the prior holds each unknown with 1."""


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
    return np.asarray(lsq_linear(roots[:, None] * axes.T, downhill / roots,
                                 (low, np.maximum(high, low + 1e-12)), method='bvls').x)
