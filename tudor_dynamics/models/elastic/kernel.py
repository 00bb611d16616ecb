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
from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.gear import gear, Gears
from tudor_dynamics.models.elastic.shortening import shorten_mass
from tudor_dynamics.models.elastic.statics import (
    ACC, DDZ, DZ, Equations, factorise, FORCE, MASS, OLD_ACC, OLD_DDZ, residual, settle, Z)
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.cholesky import solve
from tudor_dynamics.simulation.mechanics.generalised_alpha import (
    alpha_step, averaged, place_after, speed_after)
from tudor_dynamics.simulation.mechanics.loads import section_loads
from tudor_dynamics.simulation.mechanics.mass import Composite, mass_matrix
from tudor_dynamics.small_arrays import unowned

CORRECTIONS = 2
RHO = 0.8  # of the integrator: waves that no sample shows die out


class Drives(NamedTuple):
    """How the drives move, as far as samples tell."""

    past: NDArray  # (3, springs): positions of the two samples before, and the time between them
    # (springs, 3): position of each drive as a polynomial of the time since the last sample,
    # constant first.
    path: NDArray


class Gauges(NamedTuple):
    """Gauges on the links."""

    # (gauges,): body, distance along its beam [m], and component of the moment that bends the
    # gauge.
    body: NDArray
    place: NDArray
    axis: NDArray
    # (gauges, 2): factors of the moment, and of the rate of curvature, which takes its damping off
    # again.
    gain: NDArray
    loads: NDArray  # working memory for the loads at the gauges, (gauges, LOADS)


class Driven(NamedTuple):
    """An arm that follows positions."""

    equations: Equations  # state, matrices and working memory
    gears: Gears  # gears of the driven joints
    drives: Drives  # how the other ends of the gears move
    chain: Chain  # tables of the mechanism
    composite: Composite  # working memory of the mass matrix
    gauges: Gauges


@compiled
def tables_of(bare: tuple[NDArray, ...]) -> Driven:
    """Put the arrays of an arm into their tables; tuples of tuples are slow to hand over."""
    return Driven(Equations(*bare[:5]), Gears(*bare[5:9]), Drives(*bare[9:11]),
                  Chain(*bare[11:18]), Composite(*bare[18:21]), Gauges(*bare[21:26]))


@compiled
def driven_of(arrays: tuple[NDArray, ...]) -> Driven:
    """Give the tables of an arm from arrays that Python holds."""
    return tables_of(unowned(arrays))


@compiled
def advance(driven: Driven, dt: float, steps: int, loaded: bool) -> bool:
    """
    Advance from one sample to the next.

    dt [s]; returns False where the state is no longer finite.
    """
    equations, gears, chain = driven.equations, driven.gears, driven.chain
    vectors, free, delta = equations.vectors, equations.free, equations.delta
    path, aim, aim_rate = driven.drives.path, gears.aim, gears.aim_rate
    m = free.shape[0]
    h = dt / steps
    alpha = alpha_step(RHO, h)
    gain, speed_gain, place_gain = alpha.gain, alpha.speed_gain, alpha.place_gain
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_ddz, old_acc, force = vectors[OLD_DDZ], vectors[OLD_ACC], vectors[FORCE]
    for step in range(steps):
        tau = (step + 1) * h
        for s in range(aim.shape[0]):
            aim[s] = path[s, 0] + tau * (path[s, 1] + tau * path[s, 2])
            aim_rate[s] = path[s, 1] + 2.0 * tau * path[s, 2]
        for a in range(m):
            i = free[a]
            old_ddz[i], old_acc[i] = ddz[i], acc[i]
            acc[i] = averaged(alpha, ddz[i], old_ddz[i], old_acc[i])
            z[i] = place_after(alpha, z[i], dz[i], old_acc[i], acc[i])
            dz[i] = speed_after(alpha, dz[i], old_acc[i], acc[i])
        for correction in range(CORRECTIONS):
            residual(vectors, gears, chain, loaded)
            if step == 0 and correction == 0:
                mass_matrix(z, chain, driven.composite, equations.matrices[MASS])
                shorten_mass(z, chain.body_int, chain.body_float, equations.matrices[MASS])
            if not factorise(equations, gears, speed_gain, place_gain):
                return False
            for a in range(m):
                delta[a] = -force[free[a]]
            solve(equations.factor, delta)
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
def sense(driven: Driven, loaded: bool, moment: NDArray, torque: NDArray) -> None:
    """
    Read the gauges and the gears.

    Writes moment (gauges,) [N m], torque (springs,) [N m or N].
    """
    vectors, gears, gauges = driven.equations.vectors, driven.gears, driven.gauges
    residual(vectors, gears, driven.chain, loaded)
    section_loads(vectors[Z], vectors[DZ], vectors[DDZ], driven.chain, gauges.body, gauges.place,
                  gauges.loads)
    for g in range(moment.shape[0]):
        moment[g] = (gauges.gain[g, 0] * gauges.loads[g, 3 + gauges.axis[g]]
                     + gauges.gain[g, 1] * gauges.loads[g, 6 + gauges.axis[g]])
    for s in range(gears.place.shape[0]):
        i = gears.place[s]
        torque[s] = -gear(gears.springs[s], vectors[Z, i] - gears.aim[s],
                          vectors[DZ, i] - gears.aim_rate[s])[0]


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
def begin(driven: Driven, q: NDArray, loaded: bool) -> bool:
    """Rest where the drives stand; arguments as in ``follow``, ``q`` of one sample."""
    gears, past = driven.gears, driven.drives.past
    for s in range(q.shape[0]):
        gears.aim[s], gears.aim_rate[s] = q[s], 0.0
        past[0, s] = past[1, s] = q[s]
    past[2, 0] = 0.0
    return settle(driven.equations, gears, driven.chain, loaded)


@compiled
def move(driven: Driven, q: NDArray, dt: float, inner: float, loaded: bool) -> bool:
    """Go to the next sample; arguments as in ``follow``, ``q`` and ``dt`` of one sample."""
    past = driven.drives.past
    for s in range(q.shape[0]):
        parabola(past[0, s], past[1, s], q[s], past[2, 0], dt, driven.drives.path[s])
        past[0, s], past[1, s] = past[1, s], q[s]
    past[2, 0] = dt
    return advance(driven, dt, max(1, int(math.ceil(dt / inner - 1e-6))), loaded)


@compiled
def apply_gains(equations: Equations, gains: NDArray, unexpected: float, gauge: int) -> None:
    """Change the state by what one gauge reads and nobody predicted, see ``follow``."""
    vectors, free = equations.vectors, equations.free
    for a in range(free.shape[0]):
        i = free[a]
        vectors[Z, i] += gains[0, a, gauge] * unexpected
        vectors[DZ, i] += gains[1, a, gauge] * unexpected
        vectors[DDZ, i] += gains[2, a, gauge] * unexpected
        vectors[ACC, i] += gains[2, a, gauge] * unexpected


@compiled
def look(
    driven: Driven, loaded: bool, k: int, measured: NDArray, gains: NDArray, moment: NDArray,
    torque: NDArray,
) -> None:
    """Read gauges and gears at sample k, and correct the state behind it; see ``follow``."""
    sense(driven, loaded, moment[k], torque[k])
    for g in range(measured.shape[1]):
        apply_gains(driven.equations, gains[k], measured[k, g] - moment[k, g], g)


@compiled
def follow(
    q: NDArray, dt: NDArray, inner: float, loaded: bool, measured: NDArray, gains: NDArray,
    moment: NDArray, torque: NDArray, *arrays: NDArray,
) -> int:
    """
    Follow a stretch of samples, corrected behind each by given gains.

    q (samples, springs), inner [s], gains (samples, 3, m, gauges), dt (samples,) [s], measured
    (samples, gauges) or (samples, 0) [N m]; writes moment (samples, gauges), torque
    (samples, springs).
    """
    driven = driven_of(arrays)
    for k in range(q.shape[0]):
        if dt[k] <= 0.0:
            good = begin(driven, q[k], loaded)
        else:
            good = move(driven, q[k], dt[k], inner, loaded)
        if not good:
            return k
        look(driven, loaded, k, measured, gains, moment, torque)
    return q.shape[0]
