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
Which motor positions put bent links where they are wanted, point by point, compiled.

Links and gears follow their load at once: the load of the wanted motion, weight and inertia, bends
them as if it were at rest (the rigid load). For springs in the joints with masses behind them that
is the inversion of De Luca, "Decoupling and feedback linearization of robots with mixed rigid/
elastic joints", IEEE ICRA 1996, Eq. (8), without the inertia of what bends: vibrations are none of
its business, but a motion that follows it does not begin any, as far as they are slower than it.

Bending is found by Newton's steps with the stiffness of the links alone; the joints turn by what
brings the ends of the flexible links, and the tip, nearest to where those of a rigid arm are. All
ends count, not the tip alone: of a stretched arm that could be had by large turns only.
"""

from __future__ import annotations

from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.models.elastic.gear import gear, Gears
from tudor_dynamics.models.elastic.kernel import driven_of
from tudor_dynamics.models.elastic.shortening import add_shortening, shorten
from tudor_dynamics.models.elastic.statics import DDZ, DZ, FORCE, STIFFNESS, Z
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain, forward, rotation_at, vector_at
from tudor_dynamics.simulation.mechanics.cholesky import cholesky, solve
from tudor_dynamics.simulation.mechanics.equations import inverse_dynamics
from tudor_dynamics.simulation.mechanics.vector import add, cross, sub, turn, Vector
from tudor_dynamics.small_arrays import unowned

STEPS = 40
SETTLED = 1e-6
"""Change of a coordinate at which an arm has settled: a micrometre at its end [rad or m]."""
LITTLE = 1e-6
"""Part of the largest lever below which a joint cannot move the ends, and is left alone."""


class Inverse(NamedTuple):
    """What the inversion needs beside the arm."""

    bends: NDArray  # coordinates of the links that bend, (bends,)
    # (ends,): bodies whose ends are put where they are wanted: flexible links, and what is at the
    # tip.
    ends: NDArray
    joint: NDArray  # body behind each driven joint, (joints,)
    moved: NDArray  # 1 where a joint moves an end, (ends, joints)
    # Working memory for the stiffness, (bends, bends).
    factor: NDArray
    delta: NDArray
    # Working memory for the joints, (joints, joints).
    normal: NDArray
    step: NDArray
    # Working memory for places and levers, (ends, 3).
    wanted: NDArray
    levers: NDArray


@compiled
def end_of(chain: Chain, z: NDArray, body: int) -> Vector:
    """Give where the end of a beam, or the frame of a rigid body, is in the base frame [m]."""
    here = chain.moving[body]
    place = vector_at(here, at.ORIGIN)
    if chain.body_int[body, at.FLEXIBLE] == 0:
        return place
    k = chain.body_int[body, at.FIRST]
    along = (chain.body_float[body, at.LENGTH] + z[k], z[k + 1], z[k + 2])
    return add(place, turn(rotation_at(here, at.WORLD), along))


@compiled
def twist_of(row: NDArray, torque: float) -> float:
    """Give the twist at which a gear with play holds a torque at rest [rad]; inverse of `gear`."""
    edge = row[1] if torque > 0.0 else -row[1]
    twist = torque / row[0] + edge
    for _ in range(50):
        found, slope, _ = gear(row, twist, 0.0)
        change = (torque - found) / max(slope, 0.02 * row[0])
        twist += change
        if abs(change) < 1e-12:
            break
    return twist


@compiled
def _load(vectors: NDArray, chain: Chain) -> None:
    """Write into FORCE what the motion needs at every coordinate, without the gears."""
    z, dz, force = vectors[Z], vectors[DZ], vectors[FORCE]
    shorten(z, dz, vectors[DDZ], chain.body_int, chain.body_float)
    inverse_dynamics(z, dz, vectors[DDZ], chain, False, 1.0, force)
    add_shortening(z, chain.body_int, chain.body_float, force)


@compiled
def _aim(tables: Inverse, chain: Chain, z: NDArray) -> bool:
    """Find by how much the joints have to turn for the ends to be nearest to where wanted."""
    n = tables.joint.shape[0]
    tables.normal[:, :] = 0.0
    tables.step[:] = 0.0
    for e in range(tables.ends.shape[0]):
        end = end_of(chain, z, tables.ends[e])
        missing = sub(vector_at(tables.wanted[e], 0), end)
        for j in range(n):
            lever = (0.0, 0.0, 0.0)
            if tables.moved[e, j] > 0.0:
                lever = _lever(chain, tables.joint[j], end)
            for i in range(3):
                tables.levers[j, i] = lever[i]
        for j in range(n):
            for i in range(3):
                tables.step[j] += tables.levers[j, i] * missing[i]
            for k in range(j + 1):
                for i in range(3):
                    tables.normal[j, k] += tables.levers[j, i] * tables.levers[k, i]
    largest = 0.0
    for j in range(n):
        largest = max(largest, tables.normal[j, j])
    for j in range(n):
        tables.normal[j, j] += LITTLE * largest + 1e-30
    if not cholesky(tables.normal):
        return False
    solve(tables.normal, tables.step)
    return True


@compiled
def _lever(chain: Chain, body: int, end: Vector) -> Vector:
    """Give how fast an end moves with the joint in front of a body [m/rad, or 1]."""
    here, parent = chain.moving[body], chain.body_int[body, at.PARENT]
    axis, place = vector_at(here, at.AXIS_AT), vector_at(here, at.JOINT_AT)
    if parent >= 0:
        frame = rotation_at(chain.moving[parent], at.WORLD)
        axis = turn(frame, axis)
        place = add(vector_at(chain.moving[parent], at.ORIGIN), turn(frame, place))
    if chain.body_int[body, at.JOINT] == at.PRISMATIC:
        return axis
    return cross(axis, sub(end, place))


@compiled
def _solve_point(
    tables: Inverse, vectors: NDArray, gears: Gears, chain: Chain, reach: bool, q: NDArray,
) -> bool:
    """Bend the links under their load, and turn the joints; the state begins at the last point."""
    z, force, bends, delta = vectors[Z], vectors[FORCE], tables.bends, tables.delta
    for _ in range(STEPS):
        _load(vectors, chain)
        largest = 0.0
        if reach and not _aim(tables, chain, z):
            return False
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            if reach:
                change = tables.step[s]
            else:
                change = q[s] + twist_of(gears.springs[s], -force[i]) - z[i]
            z[i] += change
            largest = max(largest, abs(change))
        for a in range(bends.shape[0]):
            delta[a] = -force[bends[a]]
        solve(tables.factor, delta)
        for a in range(bends.shape[0]):
            z[bends[a]] += delta[a]
            largest = max(largest, abs(delta[a]))
        if largest < SETTLED:
            return True
        if not largest < 10.0:
            return False
    return False


@compiled
def invert(
    q: NDArray, dq: NDArray, ddq: NDArray, reach: bool, motor: NDArray, torque: NDArray,
    tables: tuple[NDArray, ...], *arrays: NDArray,
) -> int:
    """
    Invert points, each by itself.

    q, dq, ddq (points, joints) [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; writes motor
    (points, joints) [rad or m], torque (points, joints) [N m or N].
    """
    driven, own = driven_of(arrays), Inverse(*unowned(tables))
    equations, gears, chain = driven.equations, driven.gears, driven.chain
    vectors, bends = equations.vectors, own.bends
    z = vectors[Z]
    stiffness = equations.matrices[STIFFNESS]
    for a in range(bends.shape[0]):
        for c in range(a + 1):
            own.factor[a, c] = stiffness[bends[a], bends[c]]
    if not cholesky(own.factor):
        return 0
    for k in range(q.shape[0]):
        for row in (DZ, DDZ):
            vectors[row, :] = 0.0
        # the bends of the point before are where the search begins
        for a in range(bends.shape[0]):
            own.delta[a], z[bends[a]] = z[bends[a]], 0.0
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            z[i], vectors[DZ, i], vectors[DDZ, i] = q[k, s], dq[k, s], ddq[k, s]
        if reach:
            shorten(z, vectors[DZ], vectors[DDZ], chain.body_int, chain.body_float)
            forward(z, vectors[DZ], vectors[DDZ], chain, 0.0)
            for e in range(own.ends.shape[0]):
                end = end_of(chain, z, own.ends[e])
                for i in range(3):
                    own.wanted[e, i] = end[i]
        if k > 0:
            for a in range(bends.shape[0]):
                z[bends[a]] = own.delta[a]
        if not _solve_point(own, vectors, gears, chain, reach, q[k]):
            return k
        _load(vectors, chain)
        for s in range(gears.place.shape[0]):
            i = gears.place[s]
            torque[k, s] = vectors[FORCE, i]
            motor[k, s] = z[i] - twist_of(gears.springs[s], -vectors[FORCE, i])
    return q.shape[0]
