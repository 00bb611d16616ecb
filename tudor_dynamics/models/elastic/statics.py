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

"""What is missing for a driven arm's motion to be a true one, and how it rests, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.gear import gear, Gears
from tudor_dynamics.models.elastic.shortening import add_shortening, shorten
from tudor_dynamics.simulation.mechanics.chain import Chain
from tudor_dynamics.simulation.mechanics.cholesky import cholesky, solve
from tudor_dynamics.simulation.mechanics.equations import inverse_dynamics

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
def residual(vectors: NDArray, gears: Gears, chain: Chain, loaded: bool) -> None:
    """Write into FORCE what is missing for the present motion to be a true one."""
    z, dz, force = vectors[Z], vectors[DZ], vectors[FORCE]
    shorten(z, dz, vectors[DDZ], chain.body_int, chain.body_float)
    inverse_dynamics(z, dz, vectors[DDZ], chain, loaded, 1.0, force)
    add_shortening(z, chain.body_int, chain.body_float, force)
    for s in range(gears.place.shape[0]):
        i = gears.place[s]
        force[i] += gear(gears.springs[s], z[i] - gears.aim[s], dz[i] - gears.aim_rate[s])[0]


@compiled
def factorise(
    equations: Equations, gears: Gears, speed_gain: float, place_gain: float,
) -> bool:
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
            gears.springs[s], equations.vectors[Z, i] - gears.aim[s], 0.0)
        for a in range(free.shape[0]):
            if free[a] == i:
                factor[a, a] += speed_gain * rate_slope + place_gain * slope
    return cholesky(factor)


@compiled
def settle(equations: Equations, gears: Gears, chain: Chain, loaded: bool) -> bool:
    """
    Bend gears and links as they rest where the drives stand.

    Returns False where no equilibrium was found.
    """
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
