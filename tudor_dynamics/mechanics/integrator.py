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

"""One step of the generalised-alpha method for a mechanism, compiled."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled, unowned
from tudor_dynamics.mechanics import chain as at, settings as tuned
from tudor_dynamics.mechanics.chain import Chain, cholesky, factor_norm, solve
from tudor_dynamics.mechanics.equations import inverse_dynamics
from tudor_dynamics.mechanics.matrices import add_stretch, Composite, mass_matrix


# -- Weights of the generalised-alpha method, and what a step makes of accelerations.
#
# Arnold and Bruels (Multibody System Dynamics 18, 2007): of second order, damping of the
# highest frequencies chosen by rho. One set for the simulator and for the elastic model.

class AlphaStep(NamedTuple):
    """A step of one length and damping."""

    dt: float  # length of the step [s]
    # Weights of accelerations at both ends, and of what they make of speed and place.
    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float
    # What a correction of the acceleration adds to the method's own acceleration, to the speed [s]
    # and to the place [s^2].
    gain: float
    speed_gain: float
    place_gain: float


@compiled
def alpha_step(rho: float, dt: float) -> AlphaStep:
    """Choose the weights by the spectral radius at high frequencies."""
    alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    beta = 0.25 * (gamma + 0.5) ** 2
    gain = (1.0 - alpha_f) / (1.0 - alpha_m)
    return AlphaStep(dt, alpha_m, alpha_f, gamma, beta, gain, dt * gamma * gain,
                     dt * dt * beta * gain)


@compiled
def averaged(step: AlphaStep, ddz: Any, old_ddz: Any, old_acc: Any) -> Any:
    """Give the method's own acceleration at the end of a step."""
    return ((1.0 - step.alpha_f) * ddz + step.alpha_f * old_ddz - step.alpha_m * old_acc) / (
        1.0 - step.alpha_m)


@compiled
def place_after(step: AlphaStep, z: Any, dz: Any, old_acc: Any, acc: Any) -> Any:
    """Give the place at the end of a step from that and the speed at its begin."""
    return z + step.dt * (dz + step.dt * ((0.5 - step.beta) * old_acc + step.beta * acc))


@compiled
def speed_after(step: AlphaStep, dz: Any, old_acc: Any, acc: Any) -> Any:
    """Give the speed at the end of a step from that at its begin."""
    return dz + step.dt * ((1.0 - step.gamma) * old_acc + step.gamma * acc)


# -- Accelerations that a step begins with: as they went on, by the order that served best before

PAST = 4  # accelerations that are kept
ORDERS = 4  # polynomials to choose from: constant to cubic


@compiled
def extrapolated(past: NDArray, order: int, i: int) -> float:
    """Continue the polynomial through the last accelerations (PAST, n) of a coordinate."""
    a, b, c = past[0, i], past[1, i], past[2, i]
    if order == 0:
        return a
    if order == 1:
        return 2.0 * a - b
    if order == 2:
        return 3.0 * (a - b) + c
    return 4.0 * (a + c) - 6.0 * b - past[3, i]


@compiled
def best_order(found: NDArray, past: NDArray, prescribed: NDArray, factor: NDArray) -> int:
    """Say which order would have come nearest to what a step has found."""
    # a high one suits what moves smoothly, a low one what rings in modes beyond the step
    errors = (0.0, 0.0, 0.0, 0.0)
    for i in range(found.shape[0]):
        if not prescribed[i]:
            a, b, c = past[0, i], past[1, i], past[2, i]
            weight = 1.0 / factor[i, i]
            first = weight * (found[i] - a)
            second = first - weight * (a - b)
            third = second - weight * (a - 2.0 * b + c)
            fourth = third - weight * (a - 3.0 * b + 3.0 * c - past[3, i])
            errors = (errors[0] + first * first, errors[1] + second * second,
                      errors[2] + third * third, errors[3] + fourth * fourth)
    best = 0
    for order in range(1, ORDERS):
        if errors[order] < errors[best]:
            best = order
    return best


# -- One step of the generalised-alpha method for a mechanism, compiled.
#
# Arnold and Bruels (Multibody System Dynamics 18, 2007): second order, stable for beams of any
# stiffness, with damping of the highest frequencies chosen by rho (1: none, 0: all in one step; 1
# is Newmark's average acceleration). The equations hold at the end of the step. Newton's iteration
# keeps its factorised matrix over as many steps as it converges well with it.

# Rows of the array of vectors.
Z, DZ, DDZ, ACC, FORCE, DELTA, OLD_Z, OLD_DZ, OLD_ACC, OLD_DDZ = range(10)
VECTORS = OLD_DDZ + PAST  # those before OLD_DDZ follow it
# Slices of the array of matrices.
MASS, STIFFNESS, DAMPING, FACTOR = range(4)
MATRICES = 4
# Entries of the settings.
STEP, RHO, TOLERANCE, FACTORED, CONTRACTION, PEAK, ITERATIONS, FACTORS, LARGEST, ORDER = range(10)
SETTINGS = 10

OK, NOT_CONVERGED, NOT_FINITE, BAD_INPUT, TOO_BENT, SINGULAR = range(6)


class PlantTables(NamedTuple):
    """State of a plant, its matrices, what drives it, its mechanism: arrays changed in place."""

    vectors: NDArray  # state, and what a step begins with, (VECTORS, n)
    matrices: NDArray  # stiffness and damping, and working memory, (MATRICES, n, n)
    settings: NDArray  # (SETTINGS,): step [s], rho, tolerance, and what one step tells the next
    prescribed: NDArray  # coordinates whose motion is given, (n,)
    torque: NDArray  # generalised force at the end of the step, (n,) [N m or N]
    # (3, n): position, velocity, acceleration of prescribed coordinates at the end of the step.
    motion: NDArray
    chain: Chain  # tables of the mechanism
    composite: Composite  # working memory of the mass matrix


@compiled
def _free_elastic(z: NDArray, body_int: NDArray) -> bool:
    """Whether all elastic rotations are small enough to mean anything."""
    for b in range(body_int.shape[0]):
        if body_int[b, at.FLEXIBLE] == 1:
            for node in range(body_int[b, at.ELEMENTS]):
                k = body_int[b, at.FIRST] + 6 * node + 3
                if z[k] * z[k] + z[k + 1] * z[k + 1] + z[k + 2] * z[k + 2] > tuned.MAX_ROTATION**2:
                    return False
    return True


@compiled
def build_factor(plant: PlantTables, speed_gain: float, place_gain: float) -> bool:
    """Factorise M + speed_gain C + place_gain K; prescribed coordinates are cut out."""
    z, matrices, prescribed = plant.vectors[Z], plant.matrices, plant.prescribed
    body_int, body_float = plant.chain.body_int, plant.chain.body_float
    n = prescribed.shape[0]
    mass, factor = matrices[MASS], matrices[FACTOR]
    mass_matrix(z, plant.chain, plant.composite, mass)
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
        add_stretch(z, body_int, body_float, place_gain, speed_gain, factor)
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
def _attempt(order: int, plant: PlantTables, loaded: bool) -> int:
    """Predict the end of the step, from rest for -1, and iterate; ``step`` keeps the old state."""
    vectors, matrices, settings = plant.vectors, plant.matrices, plant.settings
    prescribed, torque, motion = plant.prescribed, plant.torque, plant.motion
    n = prescribed.shape[0]
    alpha = alpha_step(settings[RHO], settings[STEP])
    gain, speed_gain, place_gain = alpha.gain, alpha.speed_gain, alpha.place_gain
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_z, old_dz = vectors[OLD_Z], vectors[OLD_DZ]
    old_ddz, old_acc, past = vectors[OLD_DDZ], vectors[OLD_ACC], vectors[OLD_DDZ:]
    force, delta = vectors[FORCE], vectors[DELTA]
    for i in range(n):
        ddz[i] = 0.0 if order < 0 else extrapolated(past, order, i)
        acc[i] = averaged(alpha, ddz[i], old_ddz[i], old_acc[i])
        z[i] = place_after(alpha, old_z[i], old_dz[i], old_acc[i], acc[i])
        dz[i] = speed_after(alpha, old_dz[i], old_acc[i], acc[i])
        if prescribed[i]:
            z[i], dz[i], ddz[i], acc[i] = motion[0, i], motion[1, i], motion[2, i], motion[2, i]
    status, size, last, fresh = NOT_CONVERGED, 0.0, 0.0, False
    contraction, since = settings[CONTRACTION], 0
    for iteration in range(tuned.MAX_ITERATIONS):
        inverse_dynamics(z, dz, ddz, plant.chain, loaded, 1.0, force)
        if settings[FACTORED] == 0.0:
            if not build_factor(plant, speed_gain, place_gain):
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
def step(plant: PlantTables, loaded: bool) -> int:
    """Advance one step."""
    vectors, torque, motion = plant.vectors, plant.torque, plant.motion
    n = torque.shape[0]
    z, dz, ddz, acc = vectors[Z], vectors[DZ], vectors[DDZ], vectors[ACC]
    old_z, old_dz = vectors[OLD_Z], vectors[OLD_DZ]
    old_acc, past = vectors[OLD_ACC], vectors[OLD_DDZ:]
    for i in range(n):
        if not (math.isfinite(torque[i]) and math.isfinite(motion[0, i])
                and math.isfinite(motion[1, i]) and math.isfinite(motion[2, i])):
            return BAD_INPUT
    for i in range(n):
        old_z[i], old_dz[i], old_acc[i] = z[i], dz[i], acc[i]
        # the newest accelerations stand before the others
        past[3, i], past[2, i], past[1, i], past[0, i] = past[2, i], past[1, i], past[0, i], ddz[i]
    status = _attempt(int(plant.settings[ORDER]), plant, loaded)
    if status != OK:
        # After a blow the past leads astray: once more from rest, with a matrix of its own.
        plant.settings[FACTORED] = 0.0
        status = _attempt(-1, plant, loaded)
    plant.settings[ORDER] = best_order(ddz, past, plant.prescribed, plant.matrices[FACTOR])
    if status == OK and not _free_elastic(z, plant.chain.body_int):
        status = TOO_BENT
    if status != OK:
        for i in range(n):
            z[i], dz[i], ddz[i], acc[i] = old_z[i], old_dz[i], past[0, i], old_acc[i]
            past[0, i], past[1, i], past[2, i] = past[1, i], past[2, i], past[3, i]
        plant.settings[FACTORED] = 0.0
    return status


@compiled
def accelerations(plant: PlantTables, loaded: bool) -> bool:
    """Solve for the accelerations at a given state; False where the mass matrix is singular."""
    vectors, prescribed = plant.vectors, plant.prescribed
    n = prescribed.shape[0]
    ddz, force = vectors[DDZ], vectors[FORCE]
    for i in range(n):
        if not prescribed[i]:
            ddz[i] = 0.0
    inverse_dynamics(vectors[Z], vectors[DZ], ddz, plant.chain, loaded, 1.0, force)
    if not build_factor(plant, 0.0, 0.0):
        return False
    for i in range(n):
        force[i] = 0.0 if prescribed[i] else plant.torque[i] - force[i]
    solve(plant.matrices[FACTOR], force)
    for i in range(n):
        ddz[i] += force[i]
    return True


# -- A step as Python calls it, and what joints do in it

class Joints(NamedTuple):
    """Where joints stand in a plant, and what they do."""

    # Coordinate of each joint and the body after it, (joints,).
    q_index: NDArray
    bodies: NDArray
    state: NDArray  # (4, joints): position, velocity, acceleration and effort of each; overwritten


@compiled
def report(plant: PlantTables, joints: Joints) -> None:
    """Write what the joints do; the effort is the reaction where the motion is given."""
    vectors, chain, state = plant.vectors, plant.chain, joints.state
    for number in range(joints.q_index.shape[0]):
        q, b = joints.q_index[number], joints.bodies[number]
        speed, rise = vectors[DZ, q], vectors[DDZ, q]
        state[0, number], state[1, number], state[2, number] = vectors[Z, q], speed, rise
        effort = plant.torque[q]
        if plant.prescribed[q]:
            start = 0 if chain.body_int[b, at.JOINT] == at.PRISMATIC else 3
            effort = chain.coordinate[q, at.HUB] * rise + chain.coordinate[q, at.DAMPING] * speed
            for i in range(3):
                effort += chain.reaction[b, start + i] * chain.moving[b, at.AXIS_AT + i]
        state[3, number] = effort


@compiled
def step_and_report(loaded: bool, plant: PlantTables, joints: Joints) -> int:
    """Advance one step and report."""
    plant, joints = unowned((plant, joints))
    status = step(plant, loaded)
    if status == OK:
        report(plant, joints)
    return status
