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
A mechanism whose joints follow measured positions through elastic gears, compiled.

The drive's side of each gear is given as a path, so the links' side is a coordinate with a spring
to a moving end; no acceleration of the measured joint enters. Generalised-alpha steps of fixed
cost: the mass matrix once a sample, two Newton corrections a step, whatever the state. That keeps
the result a smooth function of the parameters, which are identified by differences.
"""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.gear import gear
from tudor_dynamics.models.elastic.shortening import lean_mass
from tudor_dynamics.models.elastic.statics import (
    ACC, DDZ, DZ, factorise, FORCE, MASS, OLD_ACC, OLD_DDZ, residual, settle, Z)
from tudor_dynamics.simulation.mechanics.cholesky import solve
from tudor_dynamics.simulation.mechanics.loads import section_loads
from tudor_dynamics.simulation.mechanics.mass import mass_matrix

CORRECTIONS = 2
RHO = 0.8  # of the integrator: waves that no sample shows die out


@compiled
def advance(
    vectors: NDArray, matrices: NDArray, factor: NDArray, delta: NDArray, free: NDArray,
    path: NDArray, aim: NDArray, aim_rate: NDArray, dt: float, steps: int, springs: NDArray,
    spring_at: NDArray, base: NDArray, wrench: NDArray, loaded: bool, columns: NDArray,
    owner: NDArray, inertias: NDArray, body_int: NDArray, body_float: NDArray,
    coordinate: NDArray, moving: NDArray, reaction: NDArray,
) -> bool:
    """
    Advance from one sample to the next.

    Parameters
    ----------
    vectors : ndarray of shape (VECTORS, n)
        State of all coordinates, overwritten.
    matrices : ndarray of shape (MATRICES, n, n)
        Stiffness and damping, and room for the mass matrix.
    factor, delta : ndarray of shape (m, m) and (m,)
        Working memory of the factorisation.
    free : ndarray of int, shape (m,)
        Coordinates that move.
    path : ndarray of shape (n_springs, 3)
        Position of each drive as a polynomial of the time since the last sample, constant first.
    aim, aim_rate : ndarray of shape (n_springs,)
        Position and speed of the drives at the end.
    dt : float
        Time between the samples [s].
    steps : int
        Steps to take.
    springs : ndarray of shape (n_springs, SPRING_FLOATS)
        Stiffness, damping and play of each gear.
    spring_at : ndarray of int, shape (n_springs,)
        Coordinate of each gear.
    base, wrench, loaded, body_int, body_float, coordinate, moving, reaction
        As in ``inverse_dynamics``.
    columns, owner, inertias
        As in ``mass_matrix``.

    Returns
    -------
    bool
        False where the state is no longer finite.

    """
    m = free.shape[0]
    h = dt / steps
    alpha_m, alpha_f = (2.0 * RHO - 1.0) / (RHO + 1.0), RHO / (RHO + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    gain = (1.0 - alpha_f) / (1.0 - alpha_m)
    speed_gain, place_gain = h * gamma * gain, h * h * beta * gain
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_ddz, old_acc, force = vectors[OLD_DDZ], vectors[OLD_ACC], vectors[FORCE]
    for step in range(steps):
        tau = (step + 1) * h
        for s in range(springs.shape[0]):
            aim[s] = path[s, 0] + tau * (path[s, 1] + tau * path[s, 2])
            aim_rate[s] = path[s, 1] + 2.0 * tau * path[s, 2]
        for a in range(m):
            i = free[a]
            old_ddz[i], old_acc[i] = ddz[i], acc[i]
            acc[i] = ((1.0 - alpha_f) * ddz[i] + alpha_f * old_ddz[i]
                      - alpha_m * old_acc[i]) / (1.0 - alpha_m)
            z[i] += h * (dz[i] + h * ((0.5 - beta) * old_acc[i] + beta * acc[i]))
            dz[i] += h * ((1.0 - gamma) * old_acc[i] + gamma * acc[i])
        for correction in range(CORRECTIONS):
            residual(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded, body_int,
                     body_float, coordinate, moving, reaction)
            if step == 0 and correction == 0:
                mass_matrix(z, body_int, body_float, coordinate, moving, columns, owner,
                            inertias, matrices[MASS])
                lean_mass(z, body_int, body_float, matrices[MASS])
            if not factorise(vectors, matrices, factor, free, speed_gain, place_gain, aim,
                             springs, spring_at):
                return False
            for a in range(m):
                delta[a] = -force[free[a]]
            solve(factor, delta)
            for a in range(m):
                i = free[a]
                ddz[i] += delta[a]
                acc[i] += gain * delta[a]
                z[i] += place_gain * delta[a]
                dz[i] += speed_gain * delta[a]
    total = 0.0
    for a in range(m):
        total += abs(z[free[a]]) + abs(dz[free[a]])
    return total < 1e6  # also False for NaN


@compiled
def sense(
    vectors: NDArray, aim: NDArray, aim_rate: NDArray, springs: NDArray, spring_at: NDArray,
    base: NDArray, wrench: NDArray, loaded: bool, body_int: NDArray, body_float: NDArray,
    coordinate: NDArray, moving: NDArray, reaction: NDArray, gauge_body: NDArray,
    gauge_place: NDArray, gauge_axis: NDArray, gauge_gain: NDArray, loads: NDArray,
    moment: NDArray, torque: NDArray,
) -> None:
    """
    Read the gauges and the gears.

    Parameters
    ----------
    vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded
        As in ``advance``.
    body_int, body_float, coordinate, moving, reaction
        As in ``advance``.
    gauge_body, gauge_place, gauge_axis : ndarray of shape (n_gauges,)
        Body, distance along its beam [m], and component of the moment that bends the gauge.
    gauge_gain : ndarray of shape (n_gauges, 2)
        Factors of the moment, and of the rate of curvature, which takes its damping off again.
    loads : ndarray of shape (n_gauges, LOADS)
        Working memory for the loads at the gauges.
    moment : ndarray of shape (n_gauges,)
        Result: moment that bends each gauge [N m].
    torque : ndarray of shape (n_springs,)
        Result: torque through each gear on the links [N m or N].

    """
    residual(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded, body_int,
             body_float, coordinate, moving, reaction)
    section_loads(vectors[Z], vectors[DZ], vectors[DDZ], wrench, body_int, body_float, moving,
                  gauge_body, gauge_place, loads)
    for g in range(moment.shape[0]):
        moment[g] = (gauge_gain[g, 0] * loads[g, 3 + gauge_axis[g]]
                     + gauge_gain[g, 1] * loads[g, 6 + gauge_axis[g]])
    for s in range(springs.shape[0]):
        i = spring_at[s]
        torque[s] = -gear(springs[s], vectors[Z, i] - aim[s], vectors[DZ, i] - aim_rate[s])[0]


@compiled
def parabola(
    before: float, last: float, now: float, dt_before: float, dt: float, path: NDArray,
) -> None:
    """Lay a path through three samples, time counted from the middle one; a line without."""
    slope = (now - last) / dt
    if dt_before <= 0.0:
        path[0], path[1], path[2] = last, slope, 0.0
        return
    bend = (slope - (last - before) / dt_before) / (dt + dt_before)
    path[0], path[1], path[2] = last, slope - bend * dt, bend


@compiled
def begin(
    q: NDArray, vectors: NDArray, matrices: NDArray, factor: NDArray, delta: NDArray,
    free: NDArray, past: NDArray, aim: NDArray, aim_rate: NDArray, springs: NDArray,
    spring_at: NDArray, base: NDArray, wrench: NDArray, loaded: bool, body_int: NDArray,
    body_float: NDArray, coordinate: NDArray, moving: NDArray, reaction: NDArray,
) -> bool:
    """Rest where the drives stand; arguments as in ``follow``, ``q`` of one sample."""
    for s in range(springs.shape[0]):
        aim[s], aim_rate[s] = q[s], 0.0
        past[0, s] = past[1, s] = q[s]
    past[2, 0] = 0.0
    return settle(vectors, matrices, factor, delta, free, aim, aim_rate, springs, spring_at, base,
                  wrench, loaded, body_int, body_float, coordinate, moving, reaction)


@compiled
def move(
    q: NDArray, dt: float, inner: float, vectors: NDArray, matrices: NDArray, factor: NDArray,
    delta: NDArray, free: NDArray, past: NDArray, path: NDArray, aim: NDArray,
    aim_rate: NDArray, springs: NDArray, spring_at: NDArray, base: NDArray, wrench: NDArray,
    loaded: bool, columns: NDArray, owner: NDArray, inertias: NDArray, body_int: NDArray,
    body_float: NDArray, coordinate: NDArray, moving: NDArray, reaction: NDArray,
) -> bool:
    """Go to the next sample; arguments as in ``follow``, ``q`` and ``dt`` of one sample."""
    for s in range(springs.shape[0]):
        parabola(past[0, s], past[1, s], q[s], past[2, 0], dt, path[s])
        past[0, s], past[1, s] = past[1, s], q[s]
    past[2, 0] = dt
    steps = max(1, int(math.ceil(dt / inner - 1e-6)))
    return advance(vectors, matrices, factor, delta, free, path, aim, aim_rate, dt, steps,
                   springs, spring_at, base, wrench, loaded, columns, owner, inertias, body_int,
                   body_float, coordinate, moving, reaction)


@compiled
def follow(
    q: NDArray, dt: NDArray, inner: float, vectors: NDArray, matrices: NDArray, factor: NDArray,
    delta: NDArray, free: NDArray, past: NDArray, path: NDArray, aim: NDArray,
    aim_rate: NDArray, springs: NDArray, spring_at: NDArray, base: NDArray, wrench: NDArray,
    loaded: bool, columns: NDArray, owner: NDArray, inertias: NDArray, body_int: NDArray,
    body_float: NDArray, coordinate: NDArray, moving: NDArray, reaction: NDArray,
    gauge_body: NDArray, gauge_place: NDArray, gauge_axis: NDArray, gauge_gain: NDArray,
    loads: NDArray, moment: NDArray, torque: NDArray,
) -> int:
    """
    Follow a stretch of samples.

    Parameters
    ----------
    q : ndarray of shape (n_samples, n_springs)
        Position of the drives.
    dt : ndarray of shape (n_samples,)
        Time since the sample before [s]; 0 begins anew, from rest.
    inner : float
        Longest step [s].
    past : ndarray of shape (3, n_springs)
        Positions of the two samples before, and the time between them.
    moment : ndarray of shape (n_samples, n_gauges)
        Result as in ``sense``.
    torque : ndarray of shape (n_samples, n_springs)
        Result as in ``sense``.
    vectors, matrices, factor, delta, free, path, aim, aim_rate, springs, spring_at, base
        As in ``advance``.
    wrench, loaded, columns, owner, inertias, body_int, body_float, coordinate, moving, reaction
        As in ``advance``.
    gauge_body, gauge_place, gauge_axis, gauge_gain, loads
        As in ``sense``.

    Returns
    -------
    int
        Samples done; fewer than given where the state is no longer finite.

    """
    for k in range(q.shape[0]):
        if dt[k] <= 0.0:
            good = begin(q[k], vectors, matrices, factor, delta, free, past, aim, aim_rate,
                         springs, spring_at, base, wrench, loaded, body_int, body_float,
                         coordinate, moving, reaction)
        else:
            good = move(q[k], dt[k], inner, vectors, matrices, factor, delta, free, past, path,
                        aim, aim_rate, springs, spring_at, base, wrench, loaded, columns, owner,
                        inertias, body_int, body_float, coordinate, moving, reaction)
        if not good:
            return k
        sense(vectors, aim, aim_rate, springs, spring_at, base, wrench, loaded, body_int,
              body_float, coordinate, moving, reaction, gauge_body, gauge_place, gauge_axis,
              gauge_gain, loads, moment[k], torque[k])
    return q.shape[0]
