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

"""Equations of motion of flexible links, internal loads at sections, point forces."""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.mechanics import chain as at
from tudor_dynamics.mechanics.chain import (
    add, backward, Chain, cross, exponential, forward, left_jacobian, put_vector, Rotation,
    rotation_at, sub, times, turn, turn_back, turn_symmetric, Vector, vector_at)


# -- Equations of motion of a mechanism of flexible links, as generalised forces.
#
# Eq. (4) of Gasparetto et al. (2013) with the nodal displacements in the frame of their own link:
# T is constant, M_G2, M_C2 and M_C3 vanish, and what is left,
#
#     M (r'' + u'') + 2 M_G u' + M_C u + K u + (alpha M + beta K) u' = f + M g,
#     M_G = int N^T S(w) N,    M_C = int N^T (S(w') + S(w)^2) N,
#
# is integrated exactly over each element. The second row of Eq. (6) is the virtual work of the
# rigid motion at the displaced place of each particle, where the paper takes the undisplaced one;
# with it the motion of a chain conserves its energy at any amplitude. ``erls`` has the paper's own
# form.
#
# The frame of a link is clamped to its hub, which pins the equivalent rigid-link system, so that
# the mass matrix is regular.

Four = tuple[float, float, float, float]


@compiled
def hermite_mass(c: Four, length: float, density: float) -> Four:
    """Give int H H^T density ds c: cubic shape functions of one element."""
    m = density * length / 420.0
    a, b = length * c[1], length * c[3]
    return (m * (156.0 * c[0] + 22.0 * a + 54.0 * c[2] - 13.0 * b),
            m * length * (22.0 * c[0] + 4.0 * a + 13.0 * c[2] - 3.0 * b),
            m * (54.0 * c[0] + 13.0 * a + 156.0 * c[2] - 22.0 * b),
            m * length * (-13.0 * c[0] - 3.0 * a - 22.0 * c[2] + 4.0 * b))


@compiled
def hermite_stiffness(c: Four, length: float, bending: float) -> Four:
    """Give int H'' H''^T bending ds c."""
    k = bending / (length * length * length)
    a, b = length * c[1], length * c[3]
    d = 12.0 * (c[0] - c[2]) + 6.0 * (a + b)
    return (k * d, k * length * (6.0 * (c[0] - c[2]) + 4.0 * a + 2.0 * b), -k * d,
            k * length * (6.0 * (c[0] - c[2]) + 2.0 * a + 4.0 * b))


@compiled
def hermite_slope(c: Four, length: float) -> Four:
    """Give int H' H'^T ds c, the geometric stiffness of a unit normal force."""
    a, b = length * c[1], length * c[3]
    d = 36.0 * (c[0] - c[2]) + 3.0 * (a + b)
    k = 1.0 / (30.0 * length)
    return (k * d, k * length * (3.0 * (c[0] - c[2]) + 4.0 * a - b), -k * d,
            k * length * (3.0 * (c[0] - c[2]) - a + 4.0 * b))


@compiled
def shape_function(j: int) -> Four:
    """Give the coefficients of the cubic function j alone."""
    return (1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0,
            1.0 if j == 3 else 0.0)


@compiled
def node_values(v: NDArray, first: int, node: int) -> tuple[float, ...]:
    """Read the six values of a node; the clamped node 0 has none."""
    if node == 0:
        return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    k = first + 6 * (node - 1)
    return (v[k], v[k + 1], v[k + 2], v[k + 3], v[k + 4], v[k + 5])


@compiled
def blend(a0: float, row: Vector, x: Four, y: Four, z: Four, turn: Vector, dx: Four, dy: Four,
          dz: Four, ddr: Four) -> Four:
    """Give one component of the acceleration field as coefficients of the cubic functions."""
    return (a0 + row[0] * x[0] + row[1] * y[0] + row[2] * z[0] + turn[0] * dx[0]
            + turn[1] * dy[0] + turn[2] * dz[0] + ddr[0],
            row[0] * x[1] + row[1] * y[1] + row[2] * z[1] + turn[0] * dx[1]
            + turn[1] * dy[1] + turn[2] * dz[1] + ddr[1],
            a0 + row[0] * x[2] + row[1] * y[2] + row[2] * z[2] + turn[0] * dx[2]
            + turn[1] * dy[2] + turn[2] * dz[2] + ddr[2],
            row[0] * x[3] + row[1] * y[3] + row[2] * z[3] + turn[0] * dx[3]
            + turn[1] * dy[3] + turn[2] * dz[3] + ddr[3])


@compiled
def inner(a: Four, b: Four) -> float:
    """Give the inner product of two sets of coefficients."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@compiled
def plus(a: Four, k: float, b: Four) -> Four:
    """Give a + k b."""
    return (a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2], a[3] + k * b[3])


@compiled
def along(a: float, b: float, length: float) -> Four:
    """Give the coefficients of a linear function by its end values."""
    return (a, (b - a) / length, b, (b - a) / length)


@compiled
def rate_matrix(omega: Vector, angular: Vector) -> Rotation:
    """Give S(w') + S(w)^2, the matrix of M_C."""
    x, y, z = omega
    return (-y * y - z * z, x * y - angular[2], x * z + angular[1],
            x * y + angular[2], -x * x - z * z, y * z - angular[0],
            x * z - angular[1], y * z + angular[0], -x * x - y * y)


@compiled
def element_motion(
    u1: tuple[float, ...], u2: tuple[float, ...], v1: tuple[float, ...], v2: tuple[float, ...],
    w1: tuple[float, ...], w2: tuple[float, ...], e: int, length: float, alpha: float,
    a0: Vector, c: Rotation, omega: Vector,
) -> tuple[Four, ...]:
    """Give x, y, z, y', z', and accelerations with damping, of an element by its functions."""
    x = along(e * length + u1[0], (e + 1) * length + u2[0], length)
    dx = along(v1[0], v2[0], length)
    y, dy = (u1[1], u1[5], u2[1], u2[5]), (v1[1], v1[5], v2[1], v2[5])
    s, ds = (u1[2], -u1[4], u2[2], -u2[4]), (v1[2], -v1[4], v2[2], -v2[4])
    ax = plus(along(w1[0], w2[0], length), alpha, dx)
    ay = plus((w1[1], w1[5], w2[1], w2[5]), alpha, dy)
    az = plus((w1[2], -w1[4], w2[2], -w2[4]), alpha, ds)
    wx, wy, wz = 2.0 * omega[0], 2.0 * omega[1], 2.0 * omega[2]
    return (x, y, s, dy, ds,
            blend(a0[0], (c[0], c[1], c[2]), x, y, s, (0.0, -wz, wy), dx, dy, ds, ax),
            blend(a0[1], (c[3], c[4], c[5]), x, y, s, (wz, 0.0, -wx), dx, dy, ds, ay),
            blend(a0[2], (c[6], c[7], c[8]), x, y, s, (-wy, wx, 0.0), dx, dy, ds, az))


@compiled
def add_node(force: NDArray, first: int, node: int, values: tuple[float, ...]) -> None:
    """Add six values to the rows of a node; the clamped node has none."""
    if node > 0:
        k = first + 6 * (node - 1)
        for i in range(6):
            force[k + i] += values[i]


@compiled
def beam_forces(
    z: NDArray, dz: NDArray, ddz: NDArray, ints: NDArray, floats: NDArray, elastic: float,
    here: NDArray, force: NDArray,
) -> None:
    """Add inertia, stiffness and damping of one beam to its nodal rows and to its frame."""
    first, length, density = ints[at.FIRST], floats[at.LENGTH], floats[at.DENSITY]
    alpha, beta = floats[at.ALPHA], floats[at.BETA]
    a0, omega = vector_at(here, at.ACCELERATION), vector_at(here, at.OMEGA)
    angular = vector_at(here, at.ANGULAR)
    c = rate_matrix(omega, angular)
    push, moment = vector_at(here, at.FORCE), vector_at(here, at.MOMENT)
    for e in range(ints[at.ELEMENTS]):
        u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
        v1, v2 = node_values(dz, first, e), node_values(dz, first, e + 1)
        w1, w2 = node_values(ddz, first, e), node_values(ddz, first, e + 1)
        x, y, s, dy, ds, px, py, pz = element_motion(
            u1, u2, v1, v2, w1, w2, e, length, alpha, a0, c, omega)
        hx = hermite_mass(px, length, density)
        hy = hermite_mass(py, length, density)
        hz = hermite_mass(pz, length, density)
        # Torsion: only the polar inertia about the beam's own axis.
        polar = floats[at.POLAR] * length
        t1, t2 = (angular[0] + w1[3] + alpha * v1[3], angular[0] + w2[3] + alpha * v2[3])
        m1, m2 = polar * (2.0 * t1 + t2) / 6.0, polar * (t1 + 2.0 * t2) / 6.0
        spin = polar * (omega[0] + 0.5 * (v1[3] + v2[3]))
        push = add(push, (hx[0] + hx[2], hy[0] + hy[2], hz[0] + hz[2]))
        moment = add(moment, (
            inner(y, hz) - inner(s, hy) + m1 + m2, inner(s, hx) - inner(x, hz) + omega[2] * spin,
            inner(x, hy) - inner(y, hx) - omega[1] * spin))
        # Stiffness and its share of the damping act on u + beta u'.
        stretch = elastic * floats[at.EA] / length * (
            u2[0] - u1[0] + beta * (v2[0] - v1[0])) + (hx[1] + hx[3]) / length
        torsion = elastic * floats[at.GJ] / length * (u2[3] - u1[3] + beta * (v2[3] - v1[3]))
        ky = hermite_stiffness(plus(y, beta, dy), length, elastic * floats[at.EIZ])
        kz = hermite_stiffness(plus(s, beta, ds), length, elastic * floats[at.EIY])
        if floats[at.STRETCH] > 0.0:
            gy, gz = hermite_slope(y, length), hermite_slope(s, length)
            more = elastic * floats[at.EA] / length * (
                0.5 * (inner(y, gy) + inner(s, gz)) + beta * (inner(dy, gy) + inner(ds, gz)))
            stretch += more
            normal = stretch - (hx[1] + hx[3]) / length
            ky, kz = plus(ky, normal, gy), plus(kz, normal, gz)
        add_node(force, first, e, (
            hx[0] - stretch, hy[0] + ky[0], hz[0] + kz[0], m1 - torsion, -hz[1] - kz[1],
            hy[1] + ky[1]))
        add_node(force, first, e + 1, (
            hx[2] + stretch, hy[2] + ky[2], hz[2] + kz[2], m2 + torsion, -hz[3] - kz[3],
            hy[3] + ky[3]))
    put_vector(here, at.FORCE, push)
    put_vector(here, at.MOMENT, moment)


@compiled
def rigid_forces(floats: NDArray, here: NDArray) -> None:
    """Add the inertia of a rigid body to its frame (Newton and Euler)."""
    mass, c = floats[at.MASS], vector_at(floats, at.CENTER)
    omega, angular = vector_at(here, at.OMEGA), vector_at(here, at.ANGULAR)
    push = times(mass, add(vector_at(here, at.ACCELERATION), add(
        cross(angular, c), cross(omega, cross(omega, c)))))
    spin = turn_symmetric(floats, at.INERTIA, omega)
    rise = turn_symmetric(floats, at.INERTIA, angular)
    moment = add(add(rise, cross(omega, spin)), cross(c, push))
    put_vector(here, at.FORCE, add(vector_at(here, at.FORCE), push))
    put_vector(here, at.MOMENT, add(vector_at(here, at.MOMENT), moment))


@compiled
def outer_forces(
    z: NDArray, ints: NDArray, floats: NDArray, wrench: NDArray, here: NDArray, force: NDArray,
) -> None:
    """Subtract forces and moments given at the points of a body in the base frame."""
    frame = rotation_at(here, at.WORLD)
    count = ints[at.ELEMENTS] + 1 if ints[at.FLEXIBLE] == 1 else 1
    for node in range(count):
        row = wrench[ints[at.POINT] + node]
        push = turn_back(frame, vector_at(row, 0))
        moment = turn_back(frame, vector_at(row, 3))
        place = (0.0, 0.0, 0.0)
        if node > 0:
            k = ints[at.FIRST] + 6 * (node - 1)
            place = (node * floats[at.LENGTH] + z[k], z[k + 1], z[k + 2])
            twist = turn_back(left_jacobian(vector_at(z, k + 3)), moment)
            for i in range(3):
                force[k + i] -= push[i]
                force[k + 3 + i] -= twist[i]
        put_vector(here, at.FORCE, sub(vector_at(here, at.FORCE), push))
        put_vector(here, at.MOMENT, sub(
            vector_at(here, at.MOMENT), add(moment, cross(place, push))))


@compiled
def inverse_dynamics(
    z: NDArray, dz: NDArray, ddz: NDArray, chain: Chain, loaded: bool, elastic: float,
    force: NDArray,
) -> None:
    """Write the force (n,) that a motion needs: zero at elastic rows of a true motion."""
    forward(z, dz, ddz, chain, 1.0)
    body_int, body_float, coordinate = chain.body_int, chain.body_float, chain.coordinate
    for i in range(z.shape[0]):
        force[i] = (coordinate[i, at.HUB] * ddz[i] + coordinate[i, at.DAMPING] * dz[i]
                    + elastic * coordinate[i, at.STIFFNESS] * z[i])
    for b in range(body_int.shape[0]):
        ints, here = body_int[b], chain.moving[b]
        for i in range(6):
            here[at.FORCE + i] = 0.0
        if ints[at.FLEXIBLE] == 1:
            beam_forces(z, dz, ddz, ints, body_float[b], elastic, here, force)
        else:
            rigid_forces(body_float[b], here)
        if loaded:
            outer_forces(z, ints, body_float[b], chain.wrench, here, force)
    backward(chain, force)


# -- Motion of nodes in the base frame and internal loads at sections, compiled

# Gauss points and weights on (0, 1): exact for the seventh power, the moment has the sixth.
GAUSS = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263)
WEIGHT = (0.17392742256872692, 0.32607257743127307, 0.32607257743127307, 0.17392742256872692)
LOADS = 9  # force (3), moment (3), rates of twist and of the curvatures about y and z


@compiled
def shape(xi: float, length: float) -> Four:
    """Give the cubic functions of an element at xi in 0..1."""
    return (1.0 - xi * xi * (3.0 - 2.0 * xi), length * xi * (1.0 - xi) * (1.0 - xi),
            xi * xi * (3.0 - 2.0 * xi), length * xi * xi * (xi - 1.0))


@compiled
def nodal_motion(
    z: NDArray, dz: NDArray, ddz: NDArray, gravity: NDArray, chain: Chain, place: NDArray,
    velocity: NDArray, acceleration: NDArray,
) -> None:
    """Give the motion of all points in the base frame, after a forward pass."""
    body_int, body_float, moving = chain.body_int, chain.body_float, chain.moving
    for b in range(body_int.shape[0]):
        ints, here = body_int[b], moving[b]
        world, origin = rotation_at(here, at.WORLD), vector_at(here, at.ORIGIN)
        v, w = vector_at(here, at.VELOCITY), vector_at(here, at.OMEGA)
        a, r = vector_at(here, at.ACCELERATION), vector_at(here, at.ANGULAR)
        for node in range(ints[at.ELEMENTS] + 1):
            row = ints[at.POINT] + node
            p, dp, ddp = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
            if node > 0:
                k = ints[at.FIRST] + 6 * (node - 1)
                p = (node * body_float[b, at.LENGTH] + z[k], z[k + 1], z[k + 2])
                dp, ddp = vector_at(dz, k), vector_at(ddz, k)
            swept = cross(w, p)
            put_vector(place[row], 0, add(origin, turn(world, p)))
            put_vector(velocity[row], 0, turn(world, add(v, add(swept, dp))))
            total = add(add(a, cross(r, p)), add(cross(w, add(swept, times(2.0, dp))), ddp))
            put_vector(acceleration[row], 0, add(turn(world, total), vector_at(gravity, 0)))


@compiled
def joint_reactions(
    z: NDArray, dz: NDArray, ddz: NDArray, chain: Chain, loaded: bool, force: NDArray,
    bodies: NDArray, result: NDArray,
) -> None:
    """Do ``inverse_dynamics``; each joint's load (joints, 6) in the base frame [N, N m]."""
    inverse_dynamics(z, dz, ddz, chain, loaded, 1.0, force)
    for number in range(bodies.shape[0]):
        b = bodies[number]
        push, moment = vector_at(chain.reaction[b], 0), vector_at(chain.reaction[b], 3)
        parent = chain.body_int[b, at.PARENT]
        if parent >= 0:
            world = rotation_at(chain.moving[parent], at.WORLD)
            push, moment = turn(world, push), turn(world, moment)
        put_vector(result[number], 0, push)
        put_vector(result[number], 3, moment)


@compiled
def section_loads(
    z: NDArray, dz: NDArray, ddz: NDArray, chain: Chain, bodies: NDArray, places: NDArray,
    loads: NDArray,
) -> None:
    """
    Give the internal loads at sections from the balance of all that lies outboard.

    The balance holds for any number of elements, where EI times the curvature of the shape
    functions would jump at nodes. To be called after ``inverse_dynamics``.
    """
    body_int, body_float, moving = chain.body_int, chain.body_float, chain.moving
    for s in range(bodies.shape[0]):
        b = bodies[s]
        ints, floats, here = body_int[b], body_float[b], moving[b]
        first, length, count = ints[at.FIRST], floats[at.LENGTH], ints[at.ELEMENTS]
        alpha, density = floats[at.ALPHA], floats[at.DENSITY]
        cut = min(max(int(places[s] / length), 0), count - 1)
        begin = places[s] / length - cut
        a0, omega = vector_at(here, at.ACCELERATION), vector_at(here, at.OMEGA)
        angular = vector_at(here, at.ANGULAR)
        c = rate_matrix(omega, angular)
        push, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        point, turned = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for e in range(cut, count):
            u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
            v1, v2 = node_values(dz, first, e), node_values(dz, first, e + 1)
            w1, w2 = node_values(ddz, first, e), node_values(ddz, first, e + 1)
            x, y, q, dy, dq, px, py, pz = element_motion(
                u1, u2, v1, v2, w1, w2, e, length, alpha, a0, c, omega)
            low = begin if e == cut else 0.0
            for g in range(4):
                xi = low + (1.0 - low) * GAUSS[g]
                h = shape(xi, length)
                part = density * length * (1.0 - low) * WEIGHT[g]
                f = (part * inner(px, h), part * inner(py, h), part * inner(pz, h))
                r = (inner(x, h), inner(y, h), inner(q, h))
                polar = floats[at.POLAR] * length * (1.0 - low) * WEIGHT[g]
                rise = (angular[0] + (1.0 - xi) * (w1[3] + alpha * v1[3])
                        + xi * (w2[3] + alpha * v2[3]))
                spin = polar * (omega[0] + (1.0 - xi) * v1[3] + xi * v2[3])
                push = add(push, f)
                moment = add(moment, add(cross(r, f), (
                    polar * rise, omega[2] * spin, -omega[1] * spin)))
            if e == cut:
                h = shape(begin, length)
                point = (inner(x, h), inner(y, h), inner(q, h))
                d0, d1 = 6.0 * begin * (begin - 1.0) / length, 1.0 - begin * (4.0 - 3.0 * begin)
                d3 = begin * (3.0 * begin - 2.0)
                turned = ((1.0 - begin) * u1[3] + begin * u2[3],
                          -(d0 * (q[0] - q[2]) + d1 * q[1] + d3 * q[3]),
                          d0 * (y[0] - y[2]) + d1 * y[1] + d3 * y[3])
                b0 = (12.0 * begin - 6.0) / (length * length)
                b1, b3 = (6.0 * begin - 4.0) / length, (6.0 * begin - 2.0) / length
                loads[s, 6] = (v2[3] - v1[3]) / length
                loads[s, 7] = -(b0 * (dq[0] - dq[2]) + b1 * dq[1] + b3 * dq[3])
                loads[s, 8] = b0 * (dy[0] - dy[2]) + b1 * dy[1] + b3 * dy[3]
        frame = rotation_at(here, at.WORLD)
        for node in range(cut + 1, count + 1):
            row = chain.wrench[ints[at.POINT] + node]
            k = first + 6 * (node - 1)
            f = turn_back(frame, vector_at(row, 0))
            place = (node * length + z[k], z[k + 1], z[k + 2])
            push = sub(push, f)
            moment = sub(moment, add(turn_back(frame, vector_at(row, 3)), cross(place, f)))
        for child in range(b + 1, body_int.shape[0]):
            if body_int[child, at.PARENT] == b and body_int[child, at.NODE] > cut:
                row = moving[child]
                to_parent = rotation_at(row, at.TO_PARENT)
                f = turn(to_parent, vector_at(row, at.FORCE))
                push = add(push, f)
                moment = add(moment, add(turn(to_parent, vector_at(row, at.MOMENT)),
                                         cross(vector_at(row, at.PLACE), f)))
        section = exponential(turned)
        put_vector(loads[s], 0, turn_back(section, times(-1.0, push)))
        put_vector(loads[s], 3, turn_back(section, sub(cross(point, push), moment)))


# -- A force at any place of a link, compiled: what its nodes carry, and what sections feel of it.
#
# Consistent loads on the two nodes of an element bend them exactly as the force itself does. What
# a section between a node and the force carries, they do not say; `add_to_sections` does.

@compiled
def put_force(chain: Chain, body: int, distance: float, force: Vector) -> None:
    """Add a force [N], in the base frame, to the nodes around its place at a distance [m]."""
    body_int, wrench = chain.body_int, chain.wrench
    first = body_int[body, at.POINT]
    if body_int[body, at.FLEXIBLE] == 0:
        put_vector(wrench[first], 0, add(vector_at(wrench[first], 0), force))
        return
    length = chain.body_float[body, at.LENGTH]
    element = min(int(distance / length), body_int[body, at.ELEMENTS] - 1)
    xi = distance / length - element
    h = shape(xi, length)
    here = chain.moving[body]
    axis = (here[at.WORLD], here[at.WORLD + 3], here[at.WORLD + 6])
    along = force[0] * axis[0] + force[1] * axis[1] + force[2] * axis[2]
    across = add(force, times(-along, axis))
    turned = cross(axis, across)  # turning by dx of the beam's axis: x cross f
    for end in range(2):
        node = wrench[first + element + end]
        line = (1.0 - xi) if end == 0 else xi
        put_vector(node, 0, add(vector_at(node, 0), add(
            times(line * along, axis), times(h[2 * end], across))))
        put_vector(node, 3, add(vector_at(node, 3), times(h[2 * end + 1], turned)))


@compiled
def unsaid(distance: float, place: float, length: float, elements: int) -> float:
    """Give the lever of a force about a section, less that of its consistent loads [m]."""
    element = min(int(distance / length), elements - 1)
    cut = min(max(int(place / length), 0), elements - 1)
    if element != cut:
        return 0.0
    h = shape(distance / length - element, length)
    return max(distance - place, 0.0) - ((element + 1) * length - place) * h[2] - h[3]


@compiled
def add_to_sections(
    chain: Chain, bodies: NDArray, places: NDArray, body: int, distance: float, force: Vector,
    loads: NDArray,
) -> None:
    """Correct ``section_loads`` on the element that a force of ``put_force`` stands on."""
    if chain.body_int[body, at.FLEXIBLE] == 0:
        return
    local = turn_back(rotation_at(chain.moving[body], at.WORLD), force)
    for s in range(bodies.shape[0]):
        if bodies[s] == body:
            lever = unsaid(distance, places[s], chain.body_float[body, at.LENGTH],
                           chain.body_int[body, at.ELEMENTS])
            loads[s, 4] -= lever * local[2]
            loads[s, 5] += lever * local[1]


@compiled
def point_motion(
    z: NDArray, dz: NDArray, chain: Chain, body: int, node: int,
) -> tuple[Vector, Vector]:
    """Give place and velocity of a node, 0 for its frame, after a forward pass [m, m/s]."""
    here = chain.moving[body]
    p, dp = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if node > 0:
        k = chain.body_int[body, at.FIRST] + 6 * (node - 1)
        p = (node * chain.body_float[body, at.LENGTH] + z[k], z[k + 1], z[k + 2])
        dp = vector_at(dz, k)
    world = rotation_at(here, at.WORLD)
    swept = add(vector_at(here, at.VELOCITY), add(cross(vector_at(here, at.OMEGA), p), dp))
    return add(vector_at(here, at.ORIGIN), turn(world, p)), turn(world, swept)
