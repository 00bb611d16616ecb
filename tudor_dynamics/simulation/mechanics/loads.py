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

"""Motion of nodes in the base frame and internal loads at sections, compiled."""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain, put_vector, rotation_at, vector_at
from tudor_dynamics.simulation.mechanics.equations import (
    along, blend, inverse_dynamics, node_values, rate_matrix)
from tudor_dynamics.simulation.mechanics.vector import (
    add, cross, exponential, sub, times, turn, turn_back)

# Gauss points and weights on (0, 1): exact for the seventh power, the moment has the sixth.
GAUSS = (0.06943184420297371, 0.33000947820757187, 0.6699905217924281, 0.9305681557970263)
WEIGHT = (0.17392742256872692, 0.32607257743127307, 0.32607257743127307, 0.17392742256872692)
LOADS = 9  # force (3), moment (3), rates of twist and of the curvatures about y and z


@compiled
def shape(xi: float, length: float) -> tuple[float, float, float, float]:
    """Give the cubic functions of an element at xi in 0..1."""
    return (1.0 - xi * xi * (3.0 - 2.0 * xi), length * xi * (1.0 - xi) * (1.0 - xi),
            xi * xi * (3.0 - 2.0 * xi), length * xi * xi * (xi - 1.0))


@compiled
def at_place(c: tuple, h: tuple) -> float:
    """Evaluate a field."""
    return c[0] * h[0] + c[1] * h[1] + c[2] * h[2] + c[3] * h[3]


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
    """
    Do ``inverse_dynamics``, and give what each joint carries in the base frame.

    bodies (joints,); result (joints, 6): force [N] and moment about the joint [N m] that the
    inboard side exerts.
    """
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

    bodies, places (sections,) [m]; writes loads (sections, LOADS).
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
        wx, wy, wz = 2.0 * omega[0], 2.0 * omega[1], 2.0 * omega[2]
        push, moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        point, turned = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for e in range(cut, count):
            u1, u2 = node_values(z, first, e), node_values(z, first, e + 1)
            v1, v2 = node_values(dz, first, e), node_values(dz, first, e + 1)
            w1, w2 = node_values(ddz, first, e), node_values(ddz, first, e + 1)
            x = along(e * length + u1[0], (e + 1) * length + u2[0], length)
            y, q = (u1[1], u1[5], u2[1], u2[5]), (u1[2], -u1[4], u2[2], -u2[4])
            dx = along(v1[0], v2[0], length)
            dy, dq = (v1[1], v1[5], v2[1], v2[5]), (v1[2], -v1[4], v2[2], -v2[4])
            ax = along(w1[0] + alpha * v1[0], w2[0] + alpha * v2[0], length)
            ay = (w1[1] + alpha * v1[1], w1[5] + alpha * v1[5],
                  w2[1] + alpha * v2[1], w2[5] + alpha * v2[5])
            aq = (w1[2] + alpha * v1[2], -w1[4] - alpha * v1[4],
                  w2[2] + alpha * v2[2], -w2[4] - alpha * v2[4])
            px = blend(a0[0], (c[0], c[1], c[2]), x, y, q, (0.0, -wz, wy), dx, dy, dq, ax)
            py = blend(a0[1], (c[3], c[4], c[5]), x, y, q, (wz, 0.0, -wx), dx, dy, dq, ay)
            pz = blend(a0[2], (c[6], c[7], c[8]), x, y, q, (-wy, wx, 0.0), dx, dy, dq, aq)
            low = begin if e == cut else 0.0
            for g in range(4):
                xi = low + (1.0 - low) * GAUSS[g]
                h = shape(xi, length)
                part = density * length * (1.0 - low) * WEIGHT[g]
                f = (part * at_place(px, h), part * at_place(py, h), part * at_place(pz, h))
                r = (at_place(x, h), at_place(y, h), at_place(q, h))
                polar = floats[at.POLAR] * length * (1.0 - low) * WEIGHT[g]
                rise = (angular[0] + (1.0 - xi) * (w1[3] + alpha * v1[3])
                        + xi * (w2[3] + alpha * v2[3]))
                spin = polar * (omega[0] + (1.0 - xi) * v1[3] + xi * v2[3])
                push = add(push, f)
                moment = add(moment, add(cross(r, f), (
                    polar * rise, omega[2] * spin, -omega[1] * spin)))
            if e == cut:
                h = shape(begin, length)
                point = (at_place(x, h), at_place(y, h), at_place(q, h))
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
