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
Base parameters: the smallest set that the outputs depend on, found numerically.

Gautier, "Numerical calculation of the base inertial parameters of robots", J. Robotic Systems
8(4), 1991, with one change: columns are taken in a fixed order of preference instead of by
pivoting on their size, so that the choice is the same on every machine and every LAPACK, and
depends on the arm alone. Random states take the place of measured ones; whether the measured
motion excites the parameters is another question, answered where they are estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.models.regressor import Regressor
from tudor_dynamics.typing import FloatArray

RELATIVE_TOLERANCE = 1e-8
SHOWN_TERMS = 4
PAYLOAD = 'payload*'
"""Begin of the names of columns that count for each kilogram of payload."""


@dataclass(frozen=True, eq=False)
class BaseSet:
    """Base parameters of one group of channels."""

    channels: tuple[int, ...]  # channels that share the parameters
    kept: NDArray[np.intp]  # columns of the regressor that span all of them, (base,)
    # What each base parameter stands for: the kept parameter and those that are grouped with it.
    names: tuple[str, ...]


def random_motion(n_joints: int, n_samples: int, seed: int) -> FloatArray:
    """
    Draw random states that excite every parameter.

    Returns (samples, 3 joints): ``[q, dq, ddq]``, within +-pi, +-2, +-5
    [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; every second state is slow, down to 0.2 mrad/s, where
    friction terms differ that are alike (or nothing) at speed.
    """
    generator = np.random.default_rng(seed)
    scale = np.repeat([np.pi, 2.0, 5.0], n_joints)
    motion = generator.uniform(-1.0, 1.0, (n_samples, 3 * n_joints)) * scale
    slow = generator.uniform(-4.0, 0.0, (n_samples, n_joints))
    motion[::2, n_joints:2 * n_joints] *= 10.0 ** slow[::2]
    return np.asarray(motion)


def random_inputs(
    regressor: Regressor, n_joints: int, n_samples: int, seed: int,
) -> FloatArray:
    """
    Draw random inputs of a regressor: motion, and what it takes beyond that.

    Returns (samples, 3 joints + bristles + extra_inputs).
    """
    motion = random_motion(n_joints, n_samples, seed)
    extra = int(getattr(regressor, 'extra_inputs', 0))
    if regressor.bristles is not None:
        bent = np.random.default_rng([seed, 2]).uniform(
            -1.0, 1.0, (n_samples, regressor.bristles.count))
        motion = np.hstack([motion, bent])
    if not extra:
        return motion
    more = np.random.default_rng([seed, 1]).uniform(0.0, 1.0, (n_samples, extra))
    return np.hstack([motion, more])


def independent_columns(
    matrix: FloatArray, tolerance: float = RELATIVE_TOLERANCE,
) -> tuple[NDArray[np.intp], FloatArray]:
    """
    Take each column that is no combination of the columns before it.

    matrix (rows, columns); returns mixture (kept, columns).
    """
    largest = float(np.max(np.linalg.norm(matrix, axis=0), initial=0.0))
    basis = np.zeros((matrix.shape[0], 0))
    kept: list[int] = []
    for i in range(matrix.shape[1]):
        column = matrix[:, i]
        for _ in range(2):  # twice is enough (Kahan): orthogonal to rounding
            column = column - basis @ (basis.T @ column)
        norm = float(np.linalg.norm(column))
        if norm > tolerance * largest * np.sqrt(matrix.shape[1]):
            basis = np.column_stack([basis, column / norm])
            kept.append(i)
    if not kept:
        return np.zeros(0, dtype=np.intp), np.zeros((0, matrix.shape[1]))
    mixture: FloatArray = np.asarray(np.linalg.lstsq(matrix[:, kept], matrix, rcond=None)[0])
    mixture[np.abs(mixture) < 1e-7] = 0.0
    return np.array(kept, dtype=np.intp), mixture


def preference(columns: tuple[str, ...]) -> list[int]:
    """
    Order columns by how well one can read them as base parameters.

    Friction and offsets first, for they are nobody else's; then first moments and inertias about
    the joints' axes, as textbooks write them; then the rest; rotor inertias last, as they merge
    with the inertia of the first link that they turn. What a payload adds comes behind all that.
    """
    order = ['Izz', 'Iyy', 'Ixx', 'mx', 'my', 'mz', 'Ixy', 'Ixz', 'Iyz', 'm', 'Ia']

    def rank(i: int) -> tuple[int, int]:
        plain = columns[i].removeprefix(PAYLOAD)
        kind = plain.split('(')[0]
        place = order.index(kind) + 1 if kind in order else 0
        return (place + len(order) + 1 if plain != columns[i] else place, i)

    return sorted(range(len(columns)), key=rank)


def _name(columns: list[str], row: FloatArray, own: int) -> str:
    terms = [columns[own]]
    size_order = np.argsort(-np.round(np.abs(row), 7), kind='stable')  # ties are not rounding's
    others = [i for i in size_order if row[i] != 0.0 and i != own]
    for i in others[:SHOWN_TERMS - 1]:
        size = f'{abs(row[i]):.4g} ' if abs(abs(row[i]) - 1.0) > 1e-6 else ''
        terms.append(f'{"-" if row[i] < 0 else "+"} {size}{columns[i]}')
    if len(others) >= SHOWN_TERMS:
        terms.append(f'+ {len(others) - SHOWN_TERMS + 1} more')
    return ' '.join(terms)


def base_sets(regressor: Regressor, n_joints: int, *, seed: int = 0) -> tuple[BaseSet, ...]:
    """Find the base parameters of each group of channels."""
    smallest = min(len(group) for group in regressor.groups)
    n_states = len(regressor.columns) // smallest + 20
    rows = regressor.rows(random_inputs(regressor, n_joints, n_states, seed))
    order = preference(regressor.columns)
    names = [regressor.columns[i] for i in order]
    sets = []
    for group in regressor.groups:
        matrix = rows[:, list(group)].reshape(-1, len(order))[:, order]
        kept, mixture = independent_columns(matrix)
        sets.append(BaseSet(
            group, np.array([order[i] for i in kept], dtype=np.intp),
            tuple(_name(names, mixture[k], int(own)) for k, own in enumerate(kept))))
    return tuple(sets)
