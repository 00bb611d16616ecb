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

"""The driven elastic arm, compiled: gears with play, beam shortening, statics, small motion."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled, unowned
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import Chain, cholesky, solve
from tudor_dynamics.mechanics.equations import hermite_slope, inverse_dynamics, section_loads
from tudor_dynamics.mechanics.integrator import alpha_step, averaged, place_after, speed_after
from tudor_dynamics.mechanics.matrices import Composite, mass_matrix
from tudor_dynamics.typing import FloatArray


# -- Elastic gears with play, its edges rounded so that the torque is smooth, compiled

STIFF = 0  # of the gear [N m/rad]
PLAY = 1  # half of the backlash [rad]
ROUND = 2  # over which the edge of the play is rounded [rad]
TIGHT = 3  # damping where the teeth touch [N m s/rad]
LOOSE = 4  # damping inside the play [N m s/rad]
BLUR = 5  # of an edge by the speed of the twist: a quarter of the inner step [s]
SPRING_FLOATS = 6


class Gears(NamedTuple):
    """Gears of the driven joints."""

    springs: NDArray  # stiffness, play and damping of each, (springs, SPRING_FLOATS)
    place: NDArray  # coordinate of each, (springs,)
    # Position and speed of the drives, (springs,).
    aim: NDArray
    aim_rate: NDArray


@compiled
def gear(row: NDArray, twist: float, rate: float) -> tuple[float, float, float]:
    """Give torque, stiffness and damping of a gear with play at a twist [N m, per rad(/s)]."""
    # An edge between two steps acts by its mean over a step, which rounds it by the way of the
    # twist in a quarter of it; sharp, each crossing would give or take energy.
    below, above, passed = twist - row[PLAY], twist + row[PLAY], row[BLUR] * rate
    rounded = row[ROUND] * row[ROUND] + passed * passed
    low = math.sqrt(below * below + rounded)
    high = math.sqrt(above * above + rounded)
    share = 1.0 + 0.5 * (below / low - above / high)
    damping = row[LOOSE] + (row[TIGHT] - row[LOOSE]) * share
    torque = row[STIFF] * (twist + 0.5 * (low - high)) + damping * rate
    return torque, row[STIFF] * share, damping


# -- Beams of one element that keep their length: bending draws the end in, and pressure bends on.
#
# The axial coordinate is no freedom of its own but follows from bending, in motion, forces and
# mass matrix alike. A beam whose STRETCH is below zero is linear, and nothing draws it in.

BENT = (1, 5, 2, 4)  # coordinates of the end of a beam that bend it


@compiled
def shortening_rows(v: NDArray, first: int, length: float) -> tuple[float, float, float, float]:
    """Give what bending does along a beam of one element, by the coordinates `BENT`."""
    gy = hermite_slope((0.0, 0.0, v[first + 1], v[first + 5]), length)
    gz = hermite_slope((0.0, 0.0, v[first + 2], -v[first + 4]), length)
    return gy[2], gy[3], gz[2], -gz[3]


@compiled
def shorten(z: NDArray, dz: NDArray, ddz: NDArray, body_int: NDArray, body_float: NDArray) -> None:
    """Draw the ends of bent beams in, before ``inverse_dynamics``."""
    # A beam keeps its length, so bending by w draws its end in by s = w' G w / 2: the axial
    # coordinate is no freedom but -s, its rates those of -s.
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k, length = body_int[b, at.FIRST], body_float[b, at.LENGTH]
        g1, g5, g2, g4 = shortening_rows(z, k, length)
        r1, r5, r2, r4 = shortening_rows(dz, k, length)
        z[k] = -0.5 * (g1 * z[k + 1] + g5 * z[k + 5] + g2 * z[k + 2] + g4 * z[k + 4])
        dz[k] = -(g1 * dz[k + 1] + g5 * dz[k + 5] + g2 * dz[k + 2] + g4 * dz[k + 4])
        ddz[k] = -(g1 * ddz[k + 1] + g5 * ddz[k + 5] + g2 * ddz[k + 2] + g4 * ddz[k + 4]
                   + r1 * dz[k + 1] + r5 * dz[k + 5] + r2 * dz[k + 2] + r4 * dz[k + 4])


@compiled
def add_shortening(z: NDArray, body_int: NDArray, body_float: NDArray, force: NDArray) -> None:
    """
    Add what a beam's normal force does to its bending, after ``inverse_dynamics``.

    The row of the axial displacement holds the force that the end needs along the beam; by
    virtual work it acts on each bending coordinate times the rate at which that draws the end in.
    """
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k = body_int[b, at.FIRST]
        pressure, g = -force[k], shortening_rows(z, k, body_float[b, at.LENGTH])
        for i in range(4):
            force[k + BENT[i]] += pressure * g[i]


@compiled
def shorten_mass(z: NDArray, body_int: NDArray, body_float: NDArray, mass: NDArray) -> None:
    """Turn the mass matrix into that of beams which keep their length."""
    # A congruence, so it stays positive: with the shortening in the forces alone, the corrections
    # of a strongly bent arm would not converge.
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 0 or body_float[b, at.STRETCH] < 0.0:
            continue
        k = body_int[b, at.FIRST]
        g = shortening_rows(z, k, body_float[b, at.LENGTH])
        for j in range(mass.shape[0]):
            for i in range(4):
                mass[k + BENT[i], j] -= g[i] * mass[k, j]
        for j in range(mass.shape[0]):
            for i in range(4):
                mass[j, k + BENT[i]] -= g[i] * mass[j, k]


# -- What is missing for a driven arm's motion to be a true one, and how it rests, compiled

Z, DZ, DDZ, ACC, FORCE, DELTA, OLD_DDZ, OLD_ACC = range(8)
VECTORS = 8
MASS, STIFFNESS, DAMPING = range(3)
MATRICES = 3


class Equations(NamedTuple):
    """State of a driven arm, and what its equations are solved with."""

    vectors: NDArray  # state of all coordinates, (VECTORS, n)
    matrices: NDArray  # stiffness and damping, and room for the mass matrix, (MATRICES, n, n)
    # Working memory of the factorisation, (m, m).
    factor: NDArray
    delta: NDArray
    free: NDArray  # coordinates that move, (m,)


@compiled
def needed(vectors: NDArray, chain: Chain, loaded: bool) -> None:
    """Write into FORCE what the motion needs at every coordinate, without the gears."""
    z, dz, force = vectors[Z], vectors[DZ], vectors[FORCE]
    shorten(z, dz, vectors[DDZ], chain.body_int, chain.body_float)
    inverse_dynamics(z, dz, vectors[DDZ], chain, loaded, 1.0, force)
    add_shortening(z, chain.body_int, chain.body_float, force)


@compiled
def residual(vectors: NDArray, gears: Gears, chain: Chain, loaded: bool) -> None:
    """Write into FORCE what is missing for the present motion to be a true one."""
    z, dz, force = vectors[Z], vectors[DZ], vectors[FORCE]
    needed(vectors, chain, loaded)
    for s in range(gears.place.shape[0]):
        i = gears.place[s]
        force[i] += gear(gears.springs[s], z[i] - gears.aim[s], dz[i] - gears.aim_rate[s])[0]


@compiled
def factorise(equations: Equations, gears: Gears, speed_gain: float, place_gain: float) -> bool:
    """Factorise M + speed_gain C + place_gain K over the free coordinates."""
    matrices, factor, free = equations.matrices, equations.factor, equations.free
    mass, stiffness, damping = matrices[MASS], matrices[STIFFNESS], matrices[DAMPING]
    for a in range(free.shape[0]):
        i = free[a]
        for c in range(a + 1):
            j = free[c]
            factor[a, c] = (speed_gain * damping[i, j] + place_gain * stiffness[i, j])
            if speed_gain > 0.0:
                factor[a, c] += mass[i, j]
    for s in range(gears.place.shape[0]):
        i = gears.place[s]
        _, slope, rate_slope = gear(
            gears.springs[s], equations.vectors[Z, i] - gears.aim[s],
            equations.vectors[DZ, i] - gears.aim_rate[s])
        for a in range(free.shape[0]):
            if free[a] == i:
                factor[a, a] += speed_gain * rate_slope + place_gain * slope
    return cholesky(factor)


@compiled
def settle(equations: Equations, gears: Gears, chain: Chain, loaded: bool) -> bool:
    """Bend gears and links as they rest where the drives stand; False without an equilibrium."""
    vectors, factor, delta, free = (
        equations.vectors, equations.factor, equations.delta, equations.free)
    for row in (DZ, DDZ, ACC, OLD_DDZ, OLD_ACC):
        vectors[row, :] = 0.0
    for a in range(free.shape[0]):
        vectors[Z, free[a]] = 0.0
    for s in range(gears.place.shape[0]):
        vectors[Z, gears.place[s]] = gears.aim[s]
    residual(vectors, gears, chain, loaded)
    for _ in range(200):
        if not factorise(equations, gears, 0.0, 1.0):
            return False
        for a in range(free.shape[0]):
            delta[a] = -vectors[FORCE, free[a]]
        solve(factor, delta)
        largest, downhill = 0.0, 0.0
        for a in range(free.shape[0]):
            largest = max(largest, abs(delta[a]))
            downhill += delta[a] * vectors[FORCE, free[a]]
        if not math.isfinite(largest):
            return False
        # A weak part or a play lets it overshoot: back to where the way down ends.
        done, step = 0.0, min(1.0, 0.2 / max(largest, 1e-300))
        for _ in range(30):
            for a in range(free.shape[0]):
                vectors[Z, free[a]] += (step - done) * delta[a]
            done = step
            residual(vectors, gears, chain, loaded)
            uphill = 0.0
            for a in range(free.shape[0]):
                uphill += delta[a] * vectors[FORCE, free[a]]
            if largest < 1e-9 or uphill <= -0.5 * downhill:
                break
            step *= min(0.9, max(0.1, downhill / (downhill - uphill)))
        if largest < 1e-9:
            return True
    return False


# -- Small motion of a driven arm about an equilibrium: what it is linear in, drives held

NUDGE = 1e-6
"""Of coordinates and rates, for the differences: far below a play's rounding [rad, m, 1/s]."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """Small motion about an equilibrium, drives held."""

    # (m, m): of the coordinates that move; with weight, and with the gears as they stand there.
    mass: FloatArray
    damping: FloatArray
    stiffness: FloatArray


@compiled
def tangents(
    equations: Equations, gears: Gears, chain: Chain, loaded: bool, result: NDArray,
) -> None:
    """Write the derivatives (3, m, m) of missing forces by state and accelerations, from rest."""
    vectors, free = equations.vectors, equations.free
    force = vectors[FORCE]
    for kind in range(3):
        # linear in the accelerations: there a large nudge is as exact, and rounds less
        nudge = 1.0 if kind == 2 else NUDGE
        row = vectors[Z] if kind == 0 else (vectors[DZ] if kind == 1 else vectors[DDZ])
        for c in range(free.shape[0]):
            here = row[free[c]]
            for side in range(2):
                sign = 1.0 - 2.0 * side
                row[free[c]] = here + sign * nudge
                residual(vectors, gears, chain, loaded)
                for a in range(free.shape[0]):
                    result[kind, a, c] += sign * force[free[a]] / (2.0 * nudge)
            row[free[c]] = here
    # what follows from the coordinates that move is still that of the last nudge
    residual(vectors, gears, chain, loaded)


# -- A mechanism whose joints follow measured positions through elastic gears, compiled.
#
# The drive's side of each gear is given as a path, so the links' side is a coordinate with a
# spring to a moving end; no acceleration of the measured joint enters. Generalised-alpha steps of
# fixed cost: the mass matrix once a sample, two Newton corrections a step, whatever the state.
# That keeps the result a smooth function of the parameters, which are identified by differences.

CORRECTIONS = 2
RHO = 0.8  # of the integrator: waves that no sample shows die out


class Drives(NamedTuple):
    """How the drives move, as far as samples show."""

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
    """Advance from one sample to the next; False where the state is no longer finite."""
    equations, gears, chain = driven.equations, driven.gears, driven.chain
    vectors, free, delta = equations.vectors, equations.free, equations.delta
    path, aim, aim_rate = driven.drives.path, gears.aim, gears.aim_rate
    m = free.shape[0]
    h = dt / steps
    alpha = alpha_step(RHO, h)
    gain, speed_gain, place_gain = alpha.gain, alpha.speed_gain, alpha.place_gain
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_ddz, old_acc, force = vectors[OLD_DDZ], vectors[OLD_ACC], vectors[FORCE]
    for s in range(aim.shape[0]):
        gears.springs[s, BLUR] = 0.25 * h
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
    """Read the gauges [N m] and the gears [N m or N]."""
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
def look(
    driven: Driven, loaded: bool, k: int, measured: NDArray, gains: NDArray, moment: NDArray,
    torque: NDArray,
) -> None:
    """Read gauges and gears at sample k, and correct the state after it; see ``follow``."""
    sense(driven, loaded, moment[k], torque[k])
    vectors, free = driven.equations.vectors, driven.equations.free
    for g in range(measured.shape[1]):
        unexpected = measured[k, g] - moment[k, g]
        for a in range(free.shape[0]):
            i = free[a]
            vectors[Z, i] += gains[k, 0, a, g] * unexpected
            vectors[DZ, i] += gains[k, 1, a, g] * unexpected
            vectors[DDZ, i] += gains[k, 2, a, g] * unexpected
            vectors[ACC, i] += gains[k, 2, a, g] * unexpected


@compiled
def follow(
    q: NDArray, dt: NDArray, inner: float, loaded: bool, measured: NDArray, gains: NDArray,
    moment: NDArray, torque: NDArray, *arrays: NDArray,
) -> int:
    """Follow a stretch of samples, corrected after each by given gains (samples, 3, m, gauges)."""
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
