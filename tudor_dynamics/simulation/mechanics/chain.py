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

"""Forward pass: placement, velocity and acceleration of each body; backward pass of forces."""

from __future__ import annotations

from typing import NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.vector import (
    about_axis, add, cross, exponential, left_jacobian, left_jacobian_rate, product, Rotation, sub,
    times, turn, turn_back, Vector)

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
ZERO = (0.0, 0.0, 0.0)


class Chain(NamedTuple):
    """Tables of a mechanism, what acts on it from outside, and what its motion amounts to."""

    # Mechanism, see `layout`.
    body_int: NDArray
    body_float: NDArray
    coordinate: NDArray
    base: NDArray  # acceleration of the base less gravity, in the base frame, (3,) [m/s^2]
    wrench: NDArray  # (points, 6): force [N] and moment [N m] on each node, in the base frame
    moving: NDArray  # (bodies, MOVING): motion of each body, and the forces on it; overwritten
    # (bodies, 6): force and moment about each joint that the carrier exerts, in its axes;
    # overwritten.
    reaction: NDArray


@compiled
def vector_at(row: NDArray, k: int) -> Vector:
    """Read three numbers."""
    return (row[k], row[k + 1], row[k + 2])


@compiled
def rotation_at(row: NDArray, k: int) -> Rotation:
    """Read nine numbers."""
    return (row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4], row[k + 5], row[k + 6],
            row[k + 7], row[k + 8])


@compiled
def put_vector(row: NDArray, k: int, a: Vector) -> None:
    """Write three numbers."""
    row[k], row[k + 1], row[k + 2] = a


@compiled
def put_rotation(row: NDArray, k: int, a: Rotation) -> None:
    """Write nine numbers."""
    for i in range(9):
        row[k + i] = a[i]


@compiled
def forward(z: NDArray, dz: NDArray, ddz: NDArray, chain: Chain, damped: float) -> None:
    """
    Follow the chain outwards: each body stands on the displaced node of the one before.

    The frame of the next link takes the full rotation of the node, not its linear part, so that
    links of large elastic rotation carry the others where they really are.

    z, dz, ddz (n,); damped: 0 for true accelerations.
    """
    body_int, body_float, moving = chain.body_int, chain.body_float, chain.moving
    for b in range(body_int.shape[0]):
        ints, floats, here = body_int[b], body_float[b], moving[b]
        parent, node = ints[at.PARENT], ints[at.NODE]
        turned, jacobian, node_at = IDENTITY, IDENTITY, ZERO
        world, origin, velocity, omega, angular = IDENTITY, ZERO, ZERO, ZERO, ZERO
        acceleration = vector_at(chain.base, 0)
        if parent >= 0:
            carrier = moving[parent]
            world = rotation_at(carrier, at.WORLD)
            origin = vector_at(carrier, at.ORIGIN)
            velocity = vector_at(carrier, at.VELOCITY)
            omega = vector_at(carrier, at.OMEGA)
            angular = vector_at(carrier, at.ANGULAR)
            acceleration = vector_at(carrier, at.ACCELERATION)
            if node > 0:
                k = body_int[parent, at.FIRST] + 6 * (node - 1)
                theta, rate = vector_at(z, k + 3), vector_at(dz, k + 3)
                turned, jacobian = exponential(theta), left_jacobian(theta)
                node_at = (node * body_float[parent, at.LENGTH] + z[k], z[k + 1], z[k + 2])
                moved = vector_at(dz, k)
                alpha = damped * body_float[parent, at.ALPHA]
                rise_at = add(vector_at(ddz, k), times(alpha, moved))
                twist_at = add(vector_at(ddz, k + 3), times(alpha, rate))
                spin = turn(jacobian, rate)
                swept = cross(omega, node_at)
                acceleration = add(add(acceleration, cross(angular, node_at)), add(
                    cross(omega, add(swept, times(2.0, moved))), rise_at))
                velocity = add(velocity, add(swept, moved))
                angular = add(add(angular, turn(jacobian, twist_at)), add(
                    left_jacobian_rate(theta, rate), cross(omega, spin)))
                omega = add(omega, spin)
        arm = turn(turned, vector_at(floats, at.JOINT_PLACE))
        frame = product(turned, rotation_at(floats, at.JOINT_ROTATION))
        axis = vector_at(floats, at.AXIS)
        axis_at = turn(frame, axis)
        kind, q, spring = ints[at.JOINT], ints[at.Q], ints[at.SPRING]
        angle, speed, rise = 0.0, 0.0, 0.0
        if q >= 0:
            angle, speed, rise = z[q], dz[q], ddz[q]
        if spring >= 0:
            angle, speed, rise = angle + z[spring], speed + dz[spring], rise + ddz[spring]
        if kind == at.PRISMATIC:
            arm = add(arm, times(angle, axis_at))
        acceleration = add(acceleration, add(
            cross(angular, arm), cross(omega, cross(omega, arm))))
        velocity = add(velocity, cross(omega, arm))
        if kind == at.REVOLUTE:
            frame = product(frame, about_axis(axis, angle))
            spin = times(speed, axis_at)
            angular = add(angular, add(times(rise, axis_at), cross(omega, spin)))
            omega = add(omega, spin)
        elif kind == at.PRISMATIC:
            acceleration = add(acceleration, add(
                times(rise, axis_at), times(2.0 * speed, cross(omega, axis_at))))
            velocity = add(velocity, times(speed, axis_at))
        offset = turn(frame, vector_at(floats, at.BODY_PLACE))
        acceleration = add(acceleration, add(
            cross(angular, offset), cross(omega, cross(omega, offset))))
        velocity = add(velocity, cross(omega, offset))
        frame = product(frame, rotation_at(floats, at.BODY_ROTATION))
        joint_at = add(node_at, arm)
        place = add(joint_at, offset)
        put_rotation(here, at.TO_PARENT, frame)
        put_vector(here, at.PLACE, place)
        put_vector(here, at.JOINT_AT, joint_at)
        put_vector(here, at.NODE_AT, node_at)
        put_vector(here, at.AXIS_AT, axis_at)
        put_rotation(here, at.JACOBIAN, jacobian)
        put_rotation(here, at.WORLD, product(world, frame))
        put_vector(here, at.ORIGIN, add(origin, turn(world, place)))
        put_vector(here, at.VELOCITY, turn_back(frame, velocity))
        put_vector(here, at.OMEGA, turn_back(frame, omega))
        put_vector(here, at.ANGULAR, turn_back(frame, angular))
        put_vector(here, at.ACCELERATION, turn_back(frame, acceleration))


@compiled
def backward(chain: Chain, force: NDArray) -> None:
    """
    Follow the chain inwards: hand each body's force and moment to joint, node and carrier.

    force (n,).
    """
    body_int, moving, reaction = chain.body_int, chain.moving, chain.reaction
    for b in range(body_int.shape[0] - 1, -1, -1):
        ints, here = body_int[b], moving[b]
        frame = rotation_at(here, at.TO_PARENT)
        place, joint_at = vector_at(here, at.PLACE), vector_at(here, at.JOINT_AT)
        push = turn(frame, vector_at(here, at.FORCE))
        moment = turn(frame, vector_at(here, at.MOMENT))
        about = add(moment, cross(sub(place, joint_at), push))
        put_vector(reaction[b], 0, push)
        put_vector(reaction[b], 3, about)
        kind, q, spring = ints[at.JOINT], ints[at.Q], ints[at.SPRING]
        if kind != at.WELD:
            axis = vector_at(here, at.AXIS_AT)
            work = about if kind == at.REVOLUTE else push
            share = axis[0] * work[0] + axis[1] * work[1] + axis[2] * work[2]
            if q >= 0:
                force[q] += share
            if spring >= 0:
                force[spring] += share
        parent, node = ints[at.PARENT], ints[at.NODE]
        if parent < 0:
            continue
        carrier = moving[parent]
        put_vector(carrier, at.FORCE, add(vector_at(carrier, at.FORCE), push))
        put_vector(carrier, at.MOMENT, add(
            vector_at(carrier, at.MOMENT), add(moment, cross(place, push))))
        if node > 0:
            k = body_int[parent, at.FIRST] + 6 * (node - 1)
            node_at = vector_at(here, at.NODE_AT)
            at_node = add(moment, cross(sub(place, node_at), push))
            twist = turn_back(rotation_at(here, at.JACOBIAN), at_node)
            for i in range(3):
                force[k + i] += push[i]
                force[k + 3 + i] += twist[i]
