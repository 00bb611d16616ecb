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

"""Frequencies and damping of an elastic arm, joints held, over the poses that its bags cover."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.arm import DrivenArm
from tudor_dynamics.typing import FloatArray

CELLS = 18
"""Of the map along each joint."""
MOVING = 1e-3
"""Range of positions above which a joint counts as moving [rad or m]."""
MODES = 2
"""Modes wanted: links and gears have more, but bags hardly show them."""


@dataclass(frozen=True)
class Vibration:
    """A damped oscillation."""

    frequency: float  # of the damped oscillation [Hz]
    damping: float  # damping ratio of the mode


@dataclass(frozen=True, eq=False)
class ModeMap:
    """The first modes over the poses of some bags."""

    joints: tuple[int, ...]  # indices of the one or two joints that move most, the axes of the map
    edges: tuple[FloatArray, ...]  # edges of the cells along each of them, (cells + 1,) [rad or m]
    # At the middle of each cell, other joints at their mean; first joint first. NaN outside of
    # what the bags enclose, (modes, cells) or (modes, cells, cells) [Hz; 1].
    frequency: FloatArray
    damping: FloatArray


def vibrations(driven: DrivenArm, q: FloatArray, count: int = MODES) -> tuple[Vibration, ...]:
    """
    Find the slowest small vibrations about the equilibrium at a pose, joints held.

    q (joints,) [rad or m].
    """
    small = driven.linearised(q)
    m = len(small.mass)
    rates = np.zeros((2 * m, 2 * m))
    rates[:m, m:] = np.eye(m)
    rates[m:] = -np.linalg.solve(small.mass, np.hstack([small.stiffness, small.damping]))
    poles = np.linalg.eigvals(rates)
    # rounding leaves a pole without oscillation a little imaginary part
    poles = poles[poles.imag > 1e-6 * np.abs(poles)]
    return tuple(Vibration(float(pole.imag) / (2.0 * math.pi), float(-pole.real / abs(pole)))
                 for pole in poles[np.argsort(np.abs(poles))][:count])


def busiest(positions: FloatArray) -> tuple[int, ...]:
    """Choose the joints that span the map: positions (samples, joints) [rad or m]."""
    order = np.argsort(-positions.std(axis=0), kind='stable')[:2]
    return tuple(sorted(int(i) for i in order if np.ptp(positions[:, i]) > MOVING))


def mode_map(driven: DrivenArm, positions: FloatArray, cells: int = CELLS) -> ModeMap | None:
    """
    Find the first modes over the poses that were visited, and those between them.

    positions (samples, joints) [rad or m]; returns None where no joint moves.
    """
    joints = busiest(positions)
    if not joints:
        return None
    edges = tuple(np.linspace(positions[:, i].min(), positions[:, i].max(), cells + 1)
                  for i in joints)
    place = [np.clip(np.searchsorted(edge, positions[:, i], side='right') - 1, 0, cells - 1)
             for i, edge in zip(joints, edges, strict=True)]
    visited = np.zeros((cells,) * len(joints), dtype=bool)
    visited[tuple(place)] = True
    middle = [0.5 * (edge[1:] + edge[:-1]) for edge in edges]
    frequency = np.full((MODES, visited.size), np.nan)
    damping = frequency.copy()
    q = positions.mean(axis=0)
    for number in np.flatnonzero(enclosed(visited)):
        for i, k, values in zip(joints, np.unravel_index(number, visited.shape), middle,
                                strict=True):
            q[i] = values[k]
        try:
            found = vibrations(driven, q)
        except SimulationError:
            continue
        for order, mode in enumerate(found):
            frequency[order, number], damping[order, number] = mode.frequency, mode.damping
    shape = (MODES,) + (cells,) * len(joints)
    return ModeMap(joints, edges, frequency.reshape(shape), damping.reshape(shape))


def enclosed(visited: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Fill a map of visited cells up to its convex hull."""
    spots = np.argwhere(visited)
    if visited.ndim == 1:
        inside = np.zeros_like(visited)
        inside[spots.min():spots.max() + 1] = True
        return inside
    try:
        hull = Delaunay(spots)
    except QhullError:  # all in a line: nothing is between
        return visited
    every = np.argwhere(np.ones_like(visited))
    return np.asarray((hull.find_simplex(every) >= 0).reshape(visited.shape) | visited)
