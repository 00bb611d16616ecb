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
One step of the generalised-alpha method for a mechanism, compiled.

Arnold and Bruels (Multibody System Dynamics 18, 2007): second order, stable for beams of any
stiffness, with damping of the highest frequencies chosen by rho (1: none, 0: all in one step;
1 is Newmark's average acceleration). The equations hold at the end of the step. Newton's iteration
keeps its factorised matrix over as many steps as it converges well with it.
"""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.cholesky import cholesky, factor_norm, solve
from tudor_dynamics.simulation.mechanics.equations import inverse_dynamics
from tudor_dynamics.simulation.mechanics.mass import mass_matrix
from tudor_dynamics.simulation.mechanics.stiffness import add_stretch

# Rows of the array of vectors.
Z, DZ, DDZ, ACC, FORCE, DELTA, OLD_Z, OLD_DZ, OLD_DDZ, OLD_ACC, BEFORE = range(11)
VECTORS = 11
# Slices of the array of matrices.
MASS, STIFFNESS, DAMPING, FACTOR = range(4)
MATRICES = 4
# Entries of the settings.
STEP, RHO, TOLERANCE, FACTORED, CONTRACTION, PEAK, ITERATIONS, FACTORS, LARGEST = range(9)
SETTINGS = 9

OK, NOT_CONVERGED, NOT_FINITE, BAD_INPUT, TOO_BENT, SINGULAR = range(6)
MAX_ROTATION = 1.2  # rad: far beyond what a linear beam can mean
MAX_ITERATIONS = 40


@compiled
def _free_elastic(z: NDArray, body_int: NDArray) -> bool:
    """Whether all elastic rotations are small enough to mean anything."""
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 1:
            for node in range(body_int[b, at.ELEMENTS]):
                k = body_int[b, at.FIRST] + 6 * node + 3
                if z[k] * z[k] + z[k + 1] * z[k + 1] + z[k + 2] * z[k + 2] > MAX_ROTATION**2:
                    return False
    return True


@compiled
def build_factor(
    vectors: NDArray, matrices: NDArray, prescribed: NDArray, speed_gain: float,
    place_gain: float, columns: NDArray, owner: NDArray, inertias: NDArray, moving: NDArray,
    body_int: NDArray, body_float: NDArray, coordinate: NDArray,
) -> bool:
    """Factorise M + speed_gain C + place_gain K; prescribed coordinates are cut out."""
    n = prescribed.shape[0]
    mass, factor = matrices[MASS], matrices[FACTOR]
    mass_matrix(vectors[Z], body_int, body_float, coordinate, moving, columns, owner, inertias,
                mass)
    stiffness, damping = matrices[STIFFNESS], matrices[DAMPING]
    for i in range(n):
        for j in range(i + 1):
            if prescribed[i] or prescribed[j]:
                factor[i, j] = 1.0 if i == j else 0.0
            else:
                factor[i, j] = (mass[i, j] + speed_gain * damping[i, j]
                                + place_gain * stiffness[i, j])
    if place_gain > 0.0:
        # Rows of prescribed coordinates are joints: no elastic row is touched that is cut out.
        add_stretch(vectors[Z], body_int, body_float, place_gain, speed_gain, factor)
    for b in range(body_int.shape[0]):
        alpha = body_float[b, at.ALPHA]
        if body_int[b, at.FLEXIBLE] == 1 and alpha > 0.0:
            first = body_int[b, at.FIRST]
            last = first + 6 * body_int[b, at.ELEMENTS]
            for i in range(first, last):
                for j in range(first, i + 1):
                    factor[i, j] += speed_gain * alpha * mass[i, j]
    return cholesky(factor)


@compiled
def report(
    vectors: NDArray, prescribed: NDArray, torque: NDArray, q_index: NDArray, bodies: NDArray,
    reaction: NDArray, moving: NDArray, body_int: NDArray, coordinate: NDArray, joints: NDArray,
) -> None:
    """
    Write position, velocity, acceleration and effort of the joints into four rows.

    Parameters
    ----------
    vectors, prescribed, torque, reaction, moving, body_int, coordinate
        As in ``step``.
    q_index, bodies : ndarray of int, shape (n_joints,)
        Coordinate of each joint and the body behind it.
    joints : ndarray of shape (4, n_joints)
        Result; the effort is the reaction where the motion is given.

    """
    for number in range(q_index.shape[0]):
        q, b = q_index[number], bodies[number]
        speed, rise = vectors[DZ, q], vectors[DDZ, q]
        joints[0, number], joints[1, number], joints[2, number] = vectors[Z, q], speed, rise
        effort = torque[q]
        if prescribed[q]:
            start = 0 if body_int[b, at.JOINT] == at.PRISMATIC else 3
            effort = coordinate[q, at.HUB] * rise + coordinate[q, at.DAMPING] * speed
            for i in range(3):
                effort += reaction[b, start + i] * moving[b, at.AXIS_AT + i]
        joints[3, number] = effort


@compiled
def _attempt(
    guess: float, vectors: NDArray, matrices: NDArray, settings: NDArray,
    prescribed: NDArray, torque: NDArray, motion: NDArray, base: NDArray, wrench: NDArray,
    loaded: bool,
    columns: NDArray, owner: NDArray, inertias: NDArray, moving: NDArray, reaction: NDArray,
    body_int: NDArray, body_float: NDArray, coordinate: NDArray,
) -> int:
    """Predict the end of the step and iterate; ``step`` has kept the old state."""
    n = prescribed.shape[0]
    dt, rho = settings[STEP], settings[RHO]
    alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    gain = (1.0 - alpha_f) / (1.0 - alpha_m)
    speed_gain, place_gain = dt * gamma * gain, dt * dt * beta * gain
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_z, old_dz = vectors[OLD_Z], vectors[OLD_DZ]
    old_ddz, old_acc = vectors[OLD_DDZ], vectors[OLD_ACC]
    before, force, delta = vectors[BEFORE], vectors[FORCE], vectors[DELTA]
    for i in range(n):
        # Predict by a straight line through the last two accelerations, or from rest.
        ddz[i] = guess * (2.0 * old_ddz[i] - before[i])
        acc[i] = ((1.0 - alpha_f) * ddz[i] + alpha_f * old_ddz[i] - alpha_m * old_acc[i]) / (
            1.0 - alpha_m)
        z[i] = old_z[i] + dt * (old_dz[i] + dt * ((0.5 - beta) * old_acc[i] + beta * acc[i]))
        dz[i] = old_dz[i] + dt * ((1.0 - gamma) * old_acc[i] + gamma * acc[i])
        if prescribed[i]:
            z[i], dz[i], ddz[i], acc[i] = motion[0, i], motion[1, i], motion[2, i], motion[2, i]
    status, size, last, fresh = NOT_CONVERGED, 0.0, 0.0, False
    contraction, since = settings[CONTRACTION], 0
    for iteration in range(MAX_ITERATIONS):
        inverse_dynamics(z, dz, ddz, base, wrench, loaded, 1.0, body_int, body_float,
                         coordinate, moving, reaction, force)
        if settings[FACTORED] == 0.0:
            if not build_factor(vectors, matrices, prescribed, speed_gain, place_gain, columns,
                                owner, inertias, moving, body_int, body_float, coordinate):
                status = SINGULAR if iteration == 0 else NOT_CONVERGED
                break
            settings[FACTORED], fresh, since = 1.0, True, 0
            settings[FACTORS] += 1.0
            settings[LARGEST] = 0.0
            for i in range(n):
                settings[LARGEST] += 1.0 / matrices[FACTOR, i, i] ** 2
            contraction = 0.5
        for i in range(n):
            delta[i] = 0.0 if prescribed[i] else torque[i] - force[i]
        residual_work = 0.0
        for i in range(n):
            force[i] = delta[i]
        solve(matrices[FACTOR], delta)
        for i in range(n):
            residual_work += force[i] * delta[i]
            ddz[i] += delta[i]
            acc[i] += gain * delta[i]
            z[i] += place_gain * delta[i]
            dz[i] += speed_gain * delta[i]
        settings[ITERATIONS] += 1.0
        if not math.isfinite(residual_work):
            status = NOT_FINITE
            break
        last, size = size, math.sqrt(max(residual_work, 0.0))
        if since > 0 and last > 0.0:
            contraction = size / last
        since += 1
        if iteration == 0:
            scale = factor_norm(matrices[FACTOR], ddz)
            settings[PEAK] = max(scale, settings[PEAK])
            target = settings[TOLERANCE] * math.sqrt(max(scale, 1e-8 * settings[PEAK]))
            # At rest there is no scale: accelerations of 1e-9 m/s^2 or rad/s^2 are none.
            target = max(target, 1e-9 * math.sqrt(settings[LARGEST]))
        if size == 0.0 or (contraction < 1.0
                           and size * contraction / (1.0 - contraction) <= target):
            status = OK
            break
        if since > 2 and contraction > (0.5 if fresh else 0.2):
            settings[FACTORED] = 0.0  # a matrix of the state that the iteration has come to
    settings[CONTRACTION] = min(max(contraction, 0.02), 0.9)
    if contraction > 0.3 and not fresh:
        settings[FACTORED] = 0.0  # a new matrix in the next step
    return status


@compiled
def step(
    vectors: NDArray, matrices: NDArray, settings: NDArray, prescribed: NDArray,
    torque: NDArray, motion: NDArray, base: NDArray, wrench: NDArray, loaded: bool,
    columns: NDArray, owner: NDArray, inertias: NDArray, moving: NDArray, reaction: NDArray,
    body_int: NDArray, body_float: NDArray, coordinate: NDArray,
) -> int:
    """
    Advance one step.

    Parameters
    ----------
    vectors : ndarray of shape (VECTORS, n)
        State, overwritten; put back where the step fails.
    matrices : ndarray of shape (MATRICES, n, n)
        Stiffness and damping, and working memory.
    settings : ndarray of shape (SETTINGS,)
        Step [s], rho, tolerance, and what one step tells the next.
    prescribed : ndarray of bool, shape (n,)
        Coordinates whose motion is given.
    torque : ndarray of shape (n,)
        Generalised force at the end of the step [N m or N].
    motion : ndarray of shape (3, n)
        Position, velocity, acceleration of prescribed coordinates at the end of the step.
    base, wrench, loaded, body_int, body_float, coordinate, moving, reaction
        As in ``inverse_dynamics``.
    columns, owner, inertias : ndarray
        As in ``mass_matrix``.

    Returns
    -------
    int
        OK, or what went wrong.

    """
    n = prescribed.shape[0]
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_z, old_dz = vectors[OLD_Z], vectors[OLD_DZ]
    old_ddz, old_acc, before = vectors[OLD_DDZ], vectors[OLD_ACC], vectors[BEFORE]
    for i in range(n):
        if not (math.isfinite(torque[i]) and math.isfinite(motion[0, i])
                and math.isfinite(motion[1, i]) and math.isfinite(motion[2, i])):
            return BAD_INPUT
    for i in range(n):
        before[i] = old_ddz[i]
        old_z[i], old_dz[i], old_ddz[i], old_acc[i] = z[i], dz[i], ddz[i], acc[i]
    status = _attempt(
        1.0, vectors, matrices, settings, prescribed, torque, motion, base, wrench, loaded,
        columns, owner, inertias, moving, reaction, body_int, body_float, coordinate)
    if status != OK:
        # After a blow the line leads astray: once more from rest, with a matrix of its own.
        settings[FACTORED] = 0.0
        status = _attempt(
            0.0, vectors, matrices, settings, prescribed, torque, motion, base, wrench, loaded,
            columns, owner, inertias, moving, reaction, body_int, body_float, coordinate)
    if status == OK and not _free_elastic(z, body_int):
        status = TOO_BENT
    if status != OK:
        for i in range(n):
            z[i], dz[i], ddz[i], acc[i] = old_z[i], old_dz[i], old_ddz[i], old_acc[i]
            old_ddz[i] = before[i]
        settings[FACTORED] = 0.0
    return status


@compiled
def step_and_report(
    vectors: NDArray, matrices: NDArray, settings: NDArray, prescribed: NDArray,
    torque: NDArray, motion: NDArray, base: NDArray, wrench: NDArray, loaded: bool,
    columns: NDArray, owner: NDArray, inertias: NDArray, moving: NDArray, reaction: NDArray,
    body_int: NDArray, body_float: NDArray, coordinate: NDArray, q_index: NDArray,
    bodies: NDArray, joints: NDArray,
) -> int:
    """Do ``step`` and then ``report``, in one call from Python."""
    status = step(vectors, matrices, settings, prescribed, torque, motion, base, wrench, loaded,
                  columns, owner, inertias, moving, reaction, body_int, body_float, coordinate)
    if status == OK:
        report(vectors, prescribed, torque, q_index, bodies, reaction, moving, body_int,
               coordinate, joints)
    return status


@compiled
def accelerations(
    vectors: NDArray, matrices: NDArray, prescribed: NDArray, torque: NDArray, base: NDArray,
    wrench: NDArray, loaded: bool, columns: NDArray, owner: NDArray, inertias: NDArray,
    moving: NDArray, reaction: NDArray, body_int: NDArray, body_float: NDArray,
    coordinate: NDArray,
) -> bool:
    """
    Solve the equations for the accelerations at a given state.

    Parameters
    ----------
    vectors, matrices, prescribed, torque, base, wrench, loaded
        As in ``step``; rows Z and DZ are given, DDZ of prescribed coordinates too. The result is
        in row DDZ. Destroys the factors of the step.
    columns, owner, inertias, moving, reaction, body_int, body_float, coordinate
        As in ``step``.

    Returns
    -------
    bool
        False where the mass matrix is singular.

    """
    n = prescribed.shape[0]
    ddz, force = vectors[DDZ], vectors[FORCE]
    for i in range(n):
        if not prescribed[i]:
            ddz[i] = 0.0
    inverse_dynamics(vectors[Z], vectors[DZ], ddz, base, wrench, loaded, 1.0, body_int,
                     body_float, coordinate, moving, reaction, force)
    if not build_factor(vectors, matrices, prescribed, 0.0, 0.0, columns, owner, inertias,
                        moving, body_int, body_float, coordinate):
        return False
    for i in range(n):
        force[i] = 0.0 if prescribed[i] else torque[i] - force[i]
    solve(matrices[FACTOR], force)
    for i in range(n):
        ddz[i] += force[i]
    return True
