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
A force at any place of a link, compiled: what its nodes carry, and what sections feel of it.

Consistent loads on the two nodes of an element bend them exactly as the force itself does. What a
section between a node and the force carries, they do not say; `add_to_sections` does.
"""

from __future__ import annotations

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain, put_vector, rotation_at, vector_at
from tudor_dynamics.simulation.mechanics.loads import shape
from tudor_dynamics.simulation.mechanics.vector import add, cross, times, turn, turn_back, Vector


@compiled
def put_force(chain: Chain, body: int, distance: float, force: Vector) -> None:
    """
    Add a force to the wrenches of the nodes beside its place.

    distance [m]; force: in the base frame [N].
    """
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
    """
    Give place and velocity of one node in the base frame, after a forward pass [m, m/s].

    z, dz (n,); body, node: 0 for the origin of its frame.
    """
    here = chain.moving[body]
    p, dp = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    if node > 0:
        k = chain.body_int[body, at.FIRST] + 6 * (node - 1)
        p = (node * chain.body_float[body, at.LENGTH] + z[k], z[k + 1], z[k + 2])
        dp = vector_at(dz, k)
    world = rotation_at(here, at.WORLD)
    swept = add(vector_at(here, at.VELOCITY), add(cross(vector_at(here, at.OMEGA), p), dp))
    return add(vector_at(here, at.ORIGIN), turn(world, p)), turn(world, swept)
