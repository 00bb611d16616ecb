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
Extended Kalman filter for a driven arm: strain corrects twists and bending.

Between samples the covariance follows the arm linearised where it is, by the implicit midpoint
rule, which is stable for the stiffest mode at any sample rate. The unknown is a white force at the
tip, that lets the state follow what nobody modelled.
Readings that lag the moments are states themselves, and the gauges show these.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.mechanics.chain import Chain, cholesky, solve
from tudor_dynamics.models.elastic.kernel import (
    ACC, begin, DAMPING, DDZ, driven_of, DZ, Equations, FORCE, gear, Gears, Linearised, MASS, move,
    residual, sense, STIFFNESS, Z)
from tudor_dynamics.typing import FloatArray

FORCES = 3  # components of the force at the tip, base axes


@compiled
def tip_directions(
    equations: Equations, gears: Gears, chain: Chain, loaded: bool, tip: int, pushed: NDArray,
) -> None:
    """Write the generalised forces of a unit force at the tip, shape (m, FORCES)."""
    vectors, free, wrench = equations.vectors, equations.free, chain.wrench
    force = vectors[FORCE]
    residual(vectors, gears, chain, loaded)
    for a in range(free.shape[0]):
        for j in range(FORCES):
            pushed[a, j] = force[free[a]]
    for j in range(FORCES):
        wrench[tip, j] += 1.0
        residual(vectors, gears, chain, True)
        wrench[tip, j] -= 1.0
        for a in range(free.shape[0]):
            pushed[a, j] -= force[free[a]]


@compiled
def reduce_matrices(
    equations: Equations, gears: Gears, mass: NDArray, damping: NDArray, stiffness: NDArray,
) -> None:
    """Copy mass, damping and stiffness of the free coordinates, gears as they stand."""
    # They are those of `residual` without what weight adds to the stiffness: that changes the
    # first frequency by less than a tenth, which a covariance does not show.
    matrices, free = equations.matrices, equations.free
    for a in range(free.shape[0]):
        for c in range(free.shape[0]):
            i, j = free[a], free[c]
            mass[a, c] = matrices[MASS, i, j]
            damping[a, c] = matrices[DAMPING, i, j]
            stiffness[a, c] = matrices[STIFFNESS, i, j]
    for s in range(gears.place.shape[0]):
        i = gears.place[s]
        _, slope, rate_slope = gear(gears.springs[s], equations.vectors[Z, i] - gears.aim[s], 0.0)
        for a in range(free.shape[0]):
            if free[a] == i:
                stiffness[a, a] += slope
                damping[a, a] += rate_slope


@compiled
def linearise(
    loaded: bool, tip: int, mass: NDArray, damping: NDArray, stiffness: NDArray,
    pushed: NDArray, *arrays: NDArray,
) -> None:
    """Do ``reduce_matrices`` and ``tip_directions``, with the arrays of ``driven_of``."""
    driven = driven_of(arrays)
    reduce_matrices(driven.equations, driven.gears, mass, damping, stiffness)
    tip_directions(driven.equations, driven.gears, driven.chain, loaded, tip, pushed)


@compiled
def propagate(
    covariance: NDArray, mass: NDArray, damping: NDArray, stiffness: NDArray, pushed: NDArray,
    shown: NDArray, dt: float, noise: float, lag: float,
) -> bool:
    """Carry the covariance (n, n) over one sample; False where a matrix is singular."""
    m = mass.shape[0]
    n = covariance.shape[0]
    inner = 2 * m
    s = mass + 0.5 * dt * damping + 0.25 * dt * dt * stiffness
    if not cholesky(s):
        return False
    step, entering = np.zeros((n, n)), np.zeros((n, FORCES))
    column = np.empty(m)
    for j in range(inner + FORCES):
        for a in range(m):
            if j < m:
                column[a] = -dt * stiffness[a, j]
            elif j < inner:
                k = j - m
                column[a] = (mass[a, k] - 0.5 * dt * damping[a, k]
                             - 0.25 * dt * dt * stiffness[a, k])
            else:
                column[a] = dt * pushed[a, j - inner]
        solve(s, column)
        for a in range(m):
            if j < inner:
                step[m + a, j], step[a, j] = column[a], 0.5 * dt * column[a]
            else:
                entering[m + a, j - inner] = column[a]
                entering[a, j - inner] = 0.5 * dt * column[a]
        if j < m:
            step[j, j] += 1.0
        elif j < inner:
            step[j - m, j] += 0.5 * dt
    # a reading follows the new moment, as ``DrivenArm`` lets it
    share = -math.expm1(-dt / lag) if n > inner else 1.0
    for g in range(n - inner):
        step[inner + g, inner + g] = 1.0 - share
        for j in range(inner):
            for a in range(m):
                step[inner + g, j] += share * shown[g, a] * step[a, j]
        for j in range(FORCES):
            for a in range(m):
                entering[inner + g, j] += share * shown[g, a] * entering[a, j]
    covariance[:] = step @ covariance @ step.T + noise / dt * (entering @ entering.T)
    return True


@compiled
def correct(
    covariance: NDArray, shown: NDArray, variance: NDArray, innovation: NDArray, mass: NDArray,
    damping: NDArray, stiffness: NDArray, vectors: NDArray, free: NDArray, reading: NDArray,
) -> bool:
    """Correct the state by what gauges show (gauges, n) [N m]; False if a matrix is singular."""
    m = mass.shape[0]
    n = covariance.shape[0]
    change = np.zeros(n)
    # one gauge after the other: their noise is independent
    done = np.zeros(innovation.shape[0])
    for g in range(innovation.shape[0]):
        if math.isnan(innovation[g]):
            continue
        row = np.zeros(n)
        for i in range(n):
            for a in range(n):
                row[i] += covariance[i, a] * shown[g, a]
        spread = variance[g]
        expected = 0.0
        for a in range(n):
            spread += row[a] * shown[g, a]
            expected += change[a] * shown[g, a]
        left = innovation[g] - expected
        done[g] = left
        for i in range(n):
            change[i] += row[i] / spread * left
        for i in range(n):
            for k in range(n):
                covariance[i, k] -= row[i] * row[k] / spread
    bent = np.empty(m)
    for a in range(m):
        bent[a] = 0.0
        for c in range(m):
            bent[a] -= stiffness[a, c] * change[c] + damping[a, c] * change[m + c]
    factor = mass.copy()
    if not cholesky(factor):
        return False
    solve(factor, bent)
    for a in range(m):
        i = free[a]
        vectors[Z, i] += change[a]
        vectors[DZ, i] += change[m + a]
        vectors[DDZ, i] += bent[a]
        vectors[ACC, i] += bent[a]
    for g in range(n - 2 * m):
        reading[g] += change[2 * m + g]
    return True


def white_force(
    small: Linearised, pushed: FloatArray, shown: FloatArray, bandwidth: float, lag: float = 0.0,
) -> float:
    """Give the density of a white force at the tip, for a filter of a given bandwidth."""
    # an oscillator that a white force of density q drives and white noise of density r hides has a
    # filter with the decay sqrt(q / r) lever w / 2 (spectral factorisation)
    lever = float(np.linalg.norm(shown @ np.linalg.solve(small.stiffness, pushed), 2))
    slowest = float(np.sqrt(np.linalg.eigvals(
        np.linalg.solve(small.mass, small.stiffness)).real.min()))
    lever /= math.hypot(1.0, slowest * lag)
    return float((2.0 * bandwidth / max(lever * slowest, 1e-12)) ** 2)


# -- Gains of the observer along a motion, compiled

@compiled
def observe(
    q: NDArray, dt: NDArray, inner: float, loaded: bool, measured: NDArray, variance: NDArray,
    noise: float, stands: float, tip: int, seen: NDArray, gains: NDArray, *arrays: NDArray,
) -> int:
    """Follow samples, corrected by what gauges show; write the gains (samples, 3, m, gauges)."""
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
