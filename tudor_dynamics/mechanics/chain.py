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

"""Forward and backward pass over a chain of bodies, and the layout of its tables."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import NDArray
from tudor_dynamics.compiled import compiled


# -- Vectors and rotations of three dimensions as tuples, for compiled code.
#
# A vector is (x, y, z), a rotation its nine entries row by row. Tuples live in registers: no
# memory is allocated.

Vector = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """Give a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def sub(a: Vector, b: Vector) -> Vector:
    """Give a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def times(s: float, a: Vector) -> Vector:
    """Give s a."""
    return (s * a[0], s * a[1], s * a[2])


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Give the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """Give the vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def turn(r: Rotation | NDArray, a: Vector) -> Vector:
    """Give R a."""
    return (r[0] * a[0] + r[1] * a[1] + r[2] * a[2],
            r[3] * a[0] + r[4] * a[1] + r[5] * a[2],
            r[6] * a[0] + r[7] * a[1] + r[8] * a[2])


@compiled
def turn_back(r: Rotation | NDArray, a: Vector) -> Vector:
    """Give R^T a."""
    return (r[0] * a[0] + r[3] * a[1] + r[6] * a[2],
            r[1] * a[0] + r[4] * a[1] + r[7] * a[2],
            r[2] * a[0] + r[5] * a[1] + r[8] * a[2])


@compiled
def product(a: Rotation, b: Rotation) -> Rotation:
    """Give A B."""
    return (a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
            a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
            a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
            a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
            a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
            a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
            a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
            a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
            a[6] * b[2] + a[7] * b[5] + a[8] * b[8])


@compiled
def turn_symmetric(row: NDArray, k: int, a: Vector) -> Vector:
    """Give S a; the entries xx, yy, zz, xy, xz, yz of S stand in a row from k on."""
    xx, yy, zz, xy, xz, yz = row[k], row[k + 1], row[k + 2], row[k + 3], row[k + 4], row[k + 5]
    return (xx * a[0] + xy * a[1] + xz * a[2], xy * a[0] + yy * a[1] + yz * a[2],
            xz * a[0] + yz * a[1] + zz * a[2])


@compiled
def about_axis(axis: Vector, angle: float) -> Rotation:
    """Give the rotation about a unit vector by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis
    d = 1.0 - c
    return (c + x * x * d, x * y * d - z * s, x * z * d + y * s,
            y * x * d + z * s, c + y * y * d, y * z * d - x * s,
            z * x * d - y * s, z * y * d + x * s, c + z * z * d)


@compiled
def coefficients(x: float) -> tuple[float, float, float, float, float]:
    """Give sin(f)/f, (1 - cos f)/f^2, (f - sin f)/f^3 and the last two's derivatives by f^2."""
    # Taylor series in x = f^2: no division at zero, and exact to 1e-12 for angles below 1 rad, far
    # above what a beam of small displacements allows.
    s = 1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (1.0 - x / 110.0))))
    a = 0.5 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0 * (1.0 - x / 90.0 * (
        1.0 - x / 132.0)))))
    b = (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0 * (1.0 - x / 110.0 * (
        1.0 - x / 156.0))))) / 6.0
    da = -1.0 / 24.0 + x / 360.0 - x * x / 13440.0 + x * x * x / 907200.0
    db = -1.0 / 120.0 + x / 2520.0 - x * x / 120960.0 + x * x * x / 9979200.0
    return (s, a, b, da, db)


@compiled
def skewed(t: Vector, s: float, a: float) -> Rotation:
    """Give I + s S(t) + a S(t)^2, S(t) being the vector product with t."""
    x, y, z = t
    return (1.0 - a * (y * y + z * z), a * x * y - s * z, a * x * z + s * y,
            a * x * y + s * z, 1.0 - a * (x * x + z * z), a * y * z - s * x,
            a * x * z - s * y, a * y * z + s * x, 1.0 - a * (x * x + y * y))


@compiled
def exponential(t: Vector) -> Rotation:
    """Give the rotation of a rotation vector [rad]."""
    s, a, _, _, _ = coefficients(dot(t, t))
    return skewed(t, s, a)


@compiled
def left_jacobian(t: Vector) -> Rotation:
    """Give the matrix from the rate of a rotation vector to the angular velocity."""
    _, a, b, _, _ = coefficients(dot(t, t))
    return skewed(t, a, b)


@compiled
def left_jacobian_rate(t: Vector, dt: Vector) -> Vector:
    """Give (d/dt left_jacobian) dt: the part of the angular acceleration due to rates."""
    _, _, b, da, db = coefficients(dot(t, t))
    rate = 2.0 * dot(t, dt)
    first = cross(t, dt)
    return add(times(da * rate, first),
               add(times(db * rate, cross(t, first)), times(b, cross(dt, first))))


# -- Small dense systems in compiled code: a call of LAPACK costs more than the work

@compiled
def cholesky(a: NDArray) -> bool:
    """Factorise a symmetric matrix in place (lower triangle); False if it is not definite."""
    n = a.shape[0]
    for j in range(n):
        row = a[j]
        for k in range(j):
            other = a[k]
            total = row[k]
            for i in range(k):
                total -= row[i] * other[i]
            row[k] = total * other[k]
        total = row[j]
        for i in range(j):
            total -= row[i] * row[i]
        if not total > 0.0:
            return False
        row[j] = 1.0 / math.sqrt(total)  # the inverse saves divisions later
    return True


@compiled
def solve(a: NDArray, b: NDArray) -> None:
    """Solve with the factors of ``cholesky``, in place."""
    n = a.shape[0]
    for j in range(n):
        total = b[j]
        row = a[j]
        for i in range(j):
            total -= row[i] * b[i]
        b[j] = total * row[j]
    for j in range(n - 1, -1, -1):
        row = a[j]
        value = b[j] * row[j]
        b[j] = value
        for i in range(j):
            b[i] -= row[i] * value


@compiled
def factor_norm(a: NDArray, v: NDArray) -> float:
    """Give v^T A v from the factors of A."""
    n = a.shape[0]
    total = 0.0
    for j in range(n):
        part = v[j] / a[j, j]
        for i in range(j + 1, n):
            part += a[i, j] * v[i]
        total += part * part
    return total


# -- Columns of the arrays in which a mechanism is handed to compiled code.
#
# A body is a link or a rigid part fixed to a node. Its frame stands at the start of its beam, x
# along the beam, y along the section's height; a rigid body uses its joint's frame. Coordinates
# are, body by body, the joint, the spring of the joint, and the nodes 1..n of the beam with three
# displacements and three rotations each, all in the body's frame.

# body_int[body, ...]
FLEXIBLE = 0  # 1 for a beam, 0 for a rigid body
PARENT = 1  # body that carries it, -1 for the ground
NODE = 2  # node of the parent that carries it; 0 or less: the parent's own frame
JOINT = 3  # kind of joint
Q = 4  # coordinate of the joint, -1 for none
SPRING = 5  # coordinate of the joint's spring, -1 for none
FIRST = 6  # first elastic coordinate
ELEMENTS = 7  # number of elements
POINT = 8  # number of its frame among all nodes of the mechanism; its nodes follow
INTS = 9

WELD, REVOLUTE, PRISMATIC = 0, 1, 2

# body_float[body, ...]
JOINT_ROTATION = 0  # 9: axes of the joint frame (at q = 0) in those of the carrying node
JOINT_PLACE = 9  # 3: its origin from the carrying node [m]
AXIS = 12  # 3: joint axis in the joint frame
BODY_ROTATION = 15  # 9: axes of the body in those of the moved joint frame
BODY_PLACE = 24  # 3: origin of the body in the moved joint frame [m]
MASS = 27  # rigid: mass [kg]
CENTER = 28  # 3: rigid: centre of mass in the body frame [m]
INERTIA = 31  # 6: rigid: xx yy zz xy xz yz about the centre [kg m^2]
LENGTH = 27  # flexible: length of one element [m]
DENSITY = 28  # mass per length [kg/m]
POLAR = 29  # polar inertia per length [kg m]
EA = 30  # [N]
EIY = 31  # bending about y [N m^2]
EIZ = 32  # bending about z [N m^2]
GJ = 33  # torsion [N m^2]
ALPHA = 37  # Rayleigh damping by mass [1/s]
BETA = 38  # Rayleigh damping by stiffness [s]
STRETCH = 39  # 1 where bending shortens the beam and its normal force stiffens it, else 0
FLOATS = 40

# coordinate[index, ...]
HUB = 0  # inertia on the diagonal [kg m^2 or kg]
STIFFNESS = 1  # spring to ground or of the joint [N m/rad or N/m]
DAMPING = 2  # viscous [N m s/rad or N s/m]

# moving[body, ...]: what the forward pass leaves for the backward pass
TO_PARENT = 0  # 9: axes of the body in the parent's
PLACE = 9  # 3: origin of the body in the parent's frame [m]
JOINT_AT = 12  # 3: joint in the parent's frame [m]
NODE_AT = 15  # 3: carrying node in the parent's frame [m]
AXIS_AT = 18  # 3: joint axis in the parent's axes
JACOBIAN = 21  # 9: left Jacobian of the carrying node's rotation
WORLD = 30  # 9: axes of the body in the base frame
OMEGA = 39  # 3: angular velocity, body axes [rad/s]
ACCELERATION = 42  # 3: of the origin, gravity subtracted, body axes [m/s^2]
ANGULAR = 45  # 3: angular acceleration, body axes [rad/s^2]
FORCE = 48  # 3: force that moves the body and all it carries, body axes [N]
MOMENT = 51  # 3: the same about the body's origin [N m]
ORIGIN = 54  # 3: origin in the base frame [m]
VELOCITY = 57  # 3: of the origin, body axes [m/s]
MOVING = 60


# -- Forward pass: placement, velocity and acceleration of each body; backward pass of forces

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
    """Follow the chain outwards: each body stands on the displaced node of the one before."""
    # The frame of the next link takes the full rotation of the node, not its linear part, so that
    # links of large elastic rotation carry the others where they really are.
    body_int, body_float, moving = chain.body_int, chain.body_float, chain.moving
    for b in range(body_int.shape[0]):
        ints, floats, here = body_int[b], body_float[b], moving[b]
        parent, node = ints[PARENT], ints[NODE]
        turned, jacobian, node_at = IDENTITY, IDENTITY, ZERO
        world, origin, velocity, omega, angular = IDENTITY, ZERO, ZERO, ZERO, ZERO
        acceleration = vector_at(chain.base, 0)
        if parent >= 0:
            carrier = moving[parent]
            world = rotation_at(carrier, WORLD)
            origin = vector_at(carrier, ORIGIN)
            velocity = vector_at(carrier, VELOCITY)
            omega = vector_at(carrier, OMEGA)
            angular = vector_at(carrier, ANGULAR)
            acceleration = vector_at(carrier, ACCELERATION)
            if node > 0:
                k = body_int[parent, FIRST] + 6 * (node - 1)
                theta, rate = vector_at(z, k + 3), vector_at(dz, k + 3)
                turned, jacobian = exponential(theta), left_jacobian(theta)
                node_at = (node * body_float[parent, LENGTH] + z[k], z[k + 1], z[k + 2])
                moved = vector_at(dz, k)
                alpha = damped * body_float[parent, ALPHA]  # 0 for true accelerations
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
        arm = turn(turned, vector_at(floats, JOINT_PLACE))
        frame = product(turned, rotation_at(floats, JOINT_ROTATION))
        axis = vector_at(floats, AXIS)
        axis_at = turn(frame, axis)
        kind, q, spring = ints[JOINT], ints[Q], ints[SPRING]
        angle, speed, rise = 0.0, 0.0, 0.0
        if q >= 0:
            angle, speed, rise = z[q], dz[q], ddz[q]
        if spring >= 0:
            angle, speed, rise = angle + z[spring], speed + dz[spring], rise + ddz[spring]
        if kind == PRISMATIC:
            arm = add(arm, times(angle, axis_at))
        acceleration = add(acceleration, add(cross(angular, arm), cross(omega, cross(omega, arm))))
        velocity = add(velocity, cross(omega, arm))
        if kind == REVOLUTE:
            frame = product(frame, about_axis(axis, angle))
            spin = times(speed, axis_at)
            angular = add(angular, add(times(rise, axis_at), cross(omega, spin)))
            omega = add(omega, spin)
        elif kind == PRISMATIC:
            acceleration = add(acceleration, add(
                times(rise, axis_at), times(2.0 * speed, cross(omega, axis_at))))
            velocity = add(velocity, times(speed, axis_at))
        offset = turn(frame, vector_at(floats, BODY_PLACE))
        acceleration = add(acceleration, add(
            cross(angular, offset), cross(omega, cross(omega, offset))))
        velocity = add(velocity, cross(omega, offset))
        frame = product(frame, rotation_at(floats, BODY_ROTATION))
        joint_at = add(node_at, arm)
        place = add(joint_at, offset)
        put_rotation(here, TO_PARENT, frame)
        put_vector(here, PLACE, place)
        put_vector(here, JOINT_AT, joint_at)
        put_vector(here, NODE_AT, node_at)
        put_vector(here, AXIS_AT, axis_at)
        put_rotation(here, JACOBIAN, jacobian)
        put_rotation(here, WORLD, product(world, frame))
        put_vector(here, ORIGIN, add(origin, turn(world, place)))
        put_vector(here, VELOCITY, turn_back(frame, velocity))
        put_vector(here, OMEGA, turn_back(frame, omega))
        put_vector(here, ANGULAR, turn_back(frame, angular))
        put_vector(here, ACCELERATION, turn_back(frame, acceleration))


@compiled
def backward(chain: Chain, force: NDArray) -> None:
    """Follow the chain inwards: hand each body's force and moment to joint, node and carrier."""
    body_int, moving, reaction = chain.body_int, chain.moving, chain.reaction
    for b in range(body_int.shape[0] - 1, -1, -1):
        ints, here = body_int[b], moving[b]
        frame = rotation_at(here, TO_PARENT)
        place, joint_at = vector_at(here, PLACE), vector_at(here, JOINT_AT)
        push = turn(frame, vector_at(here, FORCE))
        moment = turn(frame, vector_at(here, MOMENT))
        about = add(moment, cross(sub(place, joint_at), push))
        put_vector(reaction[b], 0, push)
        put_vector(reaction[b], 3, about)
        kind, q, spring = ints[JOINT], ints[Q], ints[SPRING]
        if kind != WELD:
            axis = vector_at(here, AXIS_AT)
            work = about if kind == REVOLUTE else push
            share = axis[0] * work[0] + axis[1] * work[1] + axis[2] * work[2]
            if q >= 0:
                force[q] += share
            if spring >= 0:
                force[spring] += share
        parent, node = ints[PARENT], ints[NODE]
        if parent < 0:
            continue
        carrier = moving[parent]
        put_vector(carrier, FORCE, add(vector_at(carrier, FORCE), push))
        put_vector(carrier, MOMENT, add(
            vector_at(carrier, MOMENT), add(moment, cross(place, push))))
        if node > 0:
            k = body_int[parent, FIRST] + 6 * (node - 1)
            node_at = vector_at(here, NODE_AT)
            at_node = add(moment, cross(sub(place, node_at), push))
            twist = turn_back(rotation_at(here, JACOBIAN), at_node)
            for i in range(3):
                force[k + i] += push[i]
                force[k + 3 + i] += twist[i]
