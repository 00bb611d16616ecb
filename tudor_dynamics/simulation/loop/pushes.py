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

"""Pushes: forces on any link at any place, for a while."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.chain import Chain, vector_at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.point_load import add_to_sections, put_force
from tudor_dynamics.simulation.mechanics.vector import times
from tudor_dynamics.typing import FloatArray

# Columns of a table of pushes.
TIME, DURATION, RISE, BODY, DISTANCE = range(5)
FORCE = 5  # 3: base frame [N]
PUSH = 8


@dataclass(frozen=True)
class Push:
    """
    A force on a link.

    Attributes
    ----------
    time, duration : float
        Begin and length [s].
    joint : str
        Joint that moves the link.
    distance : float
        From the start of the link's beam [m].
    force : tuple of float
        Greatest force, in the base frame [N].
    rise : float
        Time in which it comes and goes, along a sin^2 [s].

    """

    time: float
    duration: float
    joint: str
    distance: float
    force: tuple[float, float, float]
    rise: float = 0.05


@compiled
def push_share(row: NDArray, t: float) -> float:
    """Give the part of its greatest force with which a push acts at a time [s]."""
    since = t - row[TIME]
    left = row[DURATION] - since
    if since <= 0.0 or left <= 0.0:
        return 0.0
    nearest = min(since, left)
    if nearest >= row[RISE]:
        return 1.0
    return math.sin(0.5 * math.pi * nearest / row[RISE]) ** 2


@compiled
def put_pushes(table: NDArray, t: float, chain: Chain) -> bool:
    """
    Add the pushes at a time to the forces on nodes; a place between nodes loads both neighbours.

    table (pushes, PUSH), t [s].
    """
    acting = False
    for i in range(table.shape[0]):
        row = table[i]
        share = push_share(row, t)
        if share == 0.0:
            continue
        acting = True
        put_force(chain, int(row[BODY]), row[DISTANCE], times(share, vector_at(row, FORCE)))
    return acting


@compiled
def add_pushes_to_sections(
    table: NDArray, t: float, chain: Chain, bodies: NDArray, places: NDArray, loads: NDArray,
) -> None:
    """Correct ``section_loads`` where pushes stand on the element of a section."""
    for i in range(table.shape[0]):
        row = table[i]
        share = push_share(row, t)
        if share != 0.0:
            add_to_sections(chain, bodies, places, int(row[BODY]), row[DISTANCE],
                            times(share, vector_at(row, FORCE)), loads)


def push_table(pushes: Sequence[Push], mechanism: Mechanism) -> FloatArray:
    """Lay pushes out for compiled code; returns (pushes, PUSH)."""
    table = np.zeros((len(pushes), PUSH))
    for row, push in zip(table, pushes, strict=True):
        if push.joint not in mechanism.body_of:
            msg = (f'there is no link behind joint {push.joint!r} to push; links stand behind '
                   f'{list(mechanism.body_of)}')
            raise SimulationError(msg)
        body = mechanism.body_of[push.joint]
        length = link_length(mechanism, push.joint)
        if not 0.0 <= push.distance <= length + 1e-9:
            msg = (f'a push {push.distance:g} m along the link of {push.joint!r} lies outside '
                   f'its {length:g} m')
            raise SimulationError(msg)
        values = (push.time, push.duration, push.rise, *push.force)
        if not np.isfinite(values).all() or push.duration <= 0.0 or push.rise < 0.0:
            msg = f'{push}: times and forces must be finite, the duration positive'
            raise SimulationError(msg)
        row[:] = (push.time, push.duration, min(push.rise, 0.5 * push.duration), body,
                  push.distance, *push.force)
    return table


def link_length(mechanism: Mechanism, joint: str) -> float:
    """Give the length of the beam behind a joint, 0 for a rigid link [m]."""
    ints = mechanism.body_int[mechanism.body_of[joint]]
    if not ints[at.FLEXIBLE]:
        return 0.0
    return float(ints[at.ELEMENTS] * mechanism.body_float[mechanism.body_of[joint], at.LENGTH])


def push_forces(table: FloatArray, t: FloatArray) -> FloatArray:
    """
    Give the force of each push over time.

    table (pushes, PUSH), t (samples,) [s]; returns (pushes, samples, 3) [N].
    """
    share = np.array([[push_share(row, float(now)) for now in t] for row in table])
    return np.asarray(share.reshape(len(table), len(t), 1) * table[:, None, FORCE:FORCE + 3])
