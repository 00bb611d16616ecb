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

"""What friction and rotor inertia have to be: rotors have mass, and friction takes energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.friction import friction_columns, friction_names
from tudor_dynamics.typing import FloatArray

GRID = 12
"""Speeds at which friction is looked at, in each direction."""
NO_FRICTION = ('offset', 'load')
"""Terms beside friction of its own: a constant, and a part of what the joint carries."""
ACTS = 0.3
"""Part of its largest effect from which on a term is asked to make up for others: of Coulomb
friction at the smallest speed there is three quarters."""
PASSES = 30
"""What is raised for one direction takes an eighth of it from the other at the smallest speed."""
PEAK = 2.5
"""Largest speed of a motion over its root mean square: 1.4 for a sine, 3 for moves with rests."""


def speed_grid(largest: float, sharp: float) -> FloatArray:
    """
    Give the speeds over which the friction of a joint is looked at, both ways.

    largest, sharp [rad/s or m/s]; returns (2 GRID,).
    """
    forward = np.geomspace(sharp, max(largest, 2.0 * sharp), GRID)
    return np.concatenate([-forward, forward])


def energy_rows(arm: Arm, columns: Sequence[str], speeds: FloatArray) -> FloatArray:
    """
    Give rows that must not be negative on the parameters of drives.

    Rotor inertias, and the friction of each joint against the motion at each of its speeds: the
    sum of all its terms, for friction that falls with the speed has terms that give.

    speeds (joints,) [rad/s or m/s]; returns (rows, columns).
    """
    place = {name: i for i, name in enumerate(columns)}
    rows = [np.eye(len(columns))[[i for name, i in place.items() if name.startswith('Ia(')]]]
    for joint, largest in zip(arm.joints, speeds.tolist(), strict=True):
        speed = speed_grid(largest, joint.friction_velocity)
        values = friction_columns(joint, speed) * np.sign(speed)[:, None]
        own = np.zeros((len(speed), len(columns)))
        for name, column in zip(friction_names(joint), values.T, strict=True):
            if not name.startswith(NO_FRICTION) and name in place:
                own[:, place[name]] = column
        rows.append(own[np.any(own != 0.0, axis=1)])
    return np.vstack(rows)


def raised(values: FloatArray, columns: Sequence[str], rows: FloatArray) -> FloatArray:
    """
    Take away the little by which parameters fall short of ``energy_rows``.

    values (columns,), rows (rows, columns); returns (columns,).
    """
    values = np.array(values)
    places = [i for kind in ('Ia', 'coulomb', 'viscous') for i, name in enumerate(columns)
              if name.startswith(kind)]
    for _ in range(PASSES):
        for i in places:
            if np.min(rows @ values, initial=0.0) < 0.0:
                # not those of the other direction, on which it hardly acts
                part = np.abs(rows[:, i]) > ACTS * np.abs(rows[:, i]).max(initial=0.0)
                short = -(rows[part] @ values) / np.abs(rows[part, i])
                values[i] += np.sign(rows[part, i].sum()) * max(float(short.max(initial=0.0)), 0.0)
    return values
