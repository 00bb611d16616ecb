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

"""Eigenfrequencies and mode shapes of a mechanism, joints held or free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import check_type, SimulationError
from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism
from tudor_dynamics.simulation.mechanics.motor_links import with_motors
from tudor_dynamics.simulation.mechanics.stiffness import add_stretch
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Modes:
    """Small vibrations about a configuration."""

    # Undamped frequencies, ascending; negative where gravity makes the state unstable, (modes,)
    # [Hz].
    frequency: FloatArray
    # (modes,): damping ratios by Rayleigh damping and joint damping (its diagonal part).
    damping: FloatArray
    shape: FloatArray  # (modes, n): coordinates, mass-normalised; zero at joints that are held

    def __repr__(self) -> str:
        """Write frequency and damping ratio, one line a mode."""
        return '\n'.join(['Modes', *(
            f'  {number}: {hertz:.3f} Hz, {100.0 * ratio:.2f} % of critical damping'
            for number, (hertz, ratio) in enumerate(
                zip(self.frequency, self.damping, strict=True), start=1))])


def stiffness_about_state(plant: Plant) -> FloatArray:
    """
    Give the tangent stiffness over all coordinates, gravity and stretch included.

    Returns (n, n).
    """
    mechanism = plant.mechanism
    z, zero = plant.coordinates.copy(), np.zeros(mechanism.size)
    elastic = np.tril(plant.stiffness)
    add_stretch(z, mechanism.body_int, mechanism.body_float, 1.0, 0.0, elastic)
    # Differences for gravity alone: those of the stiffness would drown in its large numbers.
    step, columns = 1e-6, []
    for i in range(z.size):
        change = np.zeros_like(z)
        change[i] = step
        columns.append((plant.imbalance(z + change, zero, zero, elastic=False)
                        - plant.imbalance(z - change, zero, zero, elastic=False)) / (2.0 * step))
    weight = np.array(columns)
    return np.asarray(elastic + np.tril(elastic, -1).T + 0.5 * (weight + weight.T))


def damping_about_state(plant: Plant) -> FloatArray:
    """
    Give the tangent damping over all coordinates: Rayleigh's and that of the joints.

    Returns (n, n).
    """
    z, zero = plant.coordinates.copy(), np.zeros(plant.mechanism.size)
    columns = []
    for i in range(z.size):
        rate = np.zeros_like(z)
        rate[i] = 1.0  # what is quadratic in the rates cancels
        columns.append(0.5 * (plant.imbalance(z, rate, zero) - plant.imbalance(z, -rate, zero)))
    return np.array(columns).T


def modes(plant: Plant | Arm, count: int = 8, free_joints: Sequence[str] = ()) -> Modes:
    """
    Solve the eigenvalue problem at the plant's present configuration.

    Parameters
    ----------
    plant : Plant or Arm
        Plant at the configuration wanted, or an arm with ``links`` where its description starts.
    count : int
        Largest number of modes.
    free_joints : sequence of str
        Joints that move freely; the others are held.

    Returns
    -------
    Modes
        Lowest modes.

    Raises
    ------
    SimulationError
        If nothing can vibrate, or there is no such joint.

    """
    if isinstance(plant, Arm):
        plant = Plant(build_mechanism(with_motors(plant)))
    check_type(plant, Plant, 'plant', 'Plant(build_mechanism(arm)), or the arm itself')
    mechanism = plant.mechanism
    unknown = [name for name in free_joints if name not in mechanism.joints]
    if unknown or count < 1:
        msg = (f'{count} modes with the joints {unknown or list(free_joints)} free: expected 1 or '
               f'more, and some of {list(mechanism.joints)}')
        raise SimulationError(msg)
    free = mechanism.elastic.copy()
    for joint in free_joints:
        free[mechanism.q_index[mechanism.joints.index(joint)]] = True
    index = np.flatnonzero(free)
    if index.size == 0:
        msg = f'{mechanism.name}: nothing can vibrate, all links are rigid and all joints held'
        raise SimulationError(msg)
    pick = np.ix_(index, index)
    mass, stiffness = plant.mass_matrix()[pick], stiffness_about_state(plant)[pick]
    try:
        values, vectors = eigh(stiffness, mass)
    except np.linalg.LinAlgError:
        msg = (f'{mechanism.name}: the mass matrix is singular with the joints '
               f'{list(free_joints)} free; give their links a mass, or a hub_inertia')
        raise SimulationError(msg) from None
    count = min(count, index.size)
    values, vectors = values[:count], vectors[:, :count]
    omega = np.sign(values) * np.sqrt(np.abs(values))
    damping = damping_about_state(plant)[pick]
    modal = np.einsum('im,ij,jm->m', vectors, damping, vectors)
    # Below a millionth of a hertz a mode is a rigid motion.
    omega[np.abs(omega) < 1e-3] = 0.0
    ratio = np.divide(modal, 2.0 * omega, out=np.zeros(count), where=omega > 0.0)
    shape = np.zeros((count, mechanism.size))
    shape[:, index] = vectors.T
    return Modes(omega / (2.0 * np.pi), ratio, shape)
