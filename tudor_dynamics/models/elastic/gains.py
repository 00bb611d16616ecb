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

"""Gains of the observer along a motion, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.kernel import begin, driven_of, move, sense
from tudor_dynamics.models.elastic.observer import (
    correct, FORCES, propagate, reduce_matrices, tip_directions)
from tudor_dynamics.simulation.mechanics.cholesky import cholesky, solve


@compiled
def observe(
    q: NDArray, dt: NDArray, inner: float, loaded: bool, measured: NDArray, variance: NDArray,
    noise: float, stands: float, tip: int, seen: NDArray, gains: NDArray, *arrays: NDArray,
) -> int:
    """
    Follow a stretch of samples, corrected by what gauges show, and write the gains down.

    measured (samples, gauges) [N m], variance (gauges,) [N^2 m^2 s], noise [N^2 s], stands [s],
    seen (gauges, 2 m) [N m]; writes gains (samples, 3, m, gauges).
    """
    driven = driven_of(arrays)
    equations, gears = driven.equations, driven.gears
    m, gauges = equations.free.shape[0], measured.shape[1]
    mass, damping, stiffness = np.zeros((m, m)), np.zeros((m, m)), np.zeros((m, m))
    pushed, covariance = np.zeros((m, FORCES)), np.zeros((2 * m, 2 * m))
    moment, torque, reading = np.zeros(gauges), np.zeros(q.shape[1]), np.zeros(gauges)
    spread, bent = np.zeros(gauges), np.zeros(m)
    shown = np.ascontiguousarray(seen[:, :m])
    for k in range(q.shape[0]):
        step = dt[k]
        if step <= 0.0:
            covariance[:], step = 0.0, stands
            good = begin(driven, q[k], loaded)
        else:
            good = move(driven, q[k], step, inner, loaded)
        if not good:
            return k
        sense(driven, loaded, moment, torque)
        reduce_matrices(equations, gears, mass, damping, stiffness)
        tip_directions(equations, gears, driven.chain, loaded, tip, pushed)
        for g in range(gauges):
            spread[g] = variance[g] / step
            moment[g] = measured[k, g] - moment[g]
        if not propagate(covariance, mass, damping, stiffness, pushed, shown, step, noise, 0.0):
            return k
        if not correct(covariance, seen, spread, moment, mass, damping, stiffness,
                       equations.vectors, equations.free, reading):
            return k
        if not cholesky(mass):
            return k
        for g in range(gauges):
            for i in range(2 * m):
                total = 0.0
                for a in range(2 * m):
                    total += covariance[i, a] * seen[g, a]
                gains[k, i // m, i % m, g] = total / spread[g]
            for a in range(m):
                bent[a] = 0.0
                for c in range(m):
                    bent[a] -= (stiffness[a, c] * gains[k, 0, c, g]
                                + damping[a, c] * gains[k, 1, c, g])
            solve(mass, bent)
            for a in range(m):
                gains[k, 2, a, g] = bent[a]
    return q.shape[0]
