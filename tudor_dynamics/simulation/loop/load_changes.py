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

"""Loads that are picked up and put down while the arm moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.typing import FloatArray

LOADS = (0.1, 0.4)  # kg
FIRST_CHANGE = 6.0  # s: not before models and filters have settled
APART = 6.0  # s: long enough to tell one from the next


@dataclass(frozen=True)
class LoadChange:
    """A load at the tip from a time on."""

    time: float  # from when [s]
    mass: float  # what is carried then in all [kg]

    def __post_init__(self) -> None:
        """Refuse what is no time and no mass."""
        if not (math.isfinite(self.time) and self.time >= 0.0
                and math.isfinite(self.mass) and self.mass >= 0.0):
            msg = f'{self}: a time and a mass are 0 or more'
            raise SimulationError(msg)


def random_loads(count: int, seconds: float, carried: float, seed: int) -> tuple[LoadChange, ...]:
    """
    Choose loads that are picked up where nothing is carried, and put down where something is.

    Parameters
    ----------
    count : int
        Number of changes.
    seconds : float
        Length of the recording [s].
    carried : float
        What is carried at the beginning [kg].
    seed : int
        Of the choice.

    Returns
    -------
    tuple of LoadChange
        In the order of time.

    Raises
    ------
    SimulationError
        If they do not fit into the recording.

    """
    if count == 0:
        return ()
    slot = (seconds - FIRST_CHANGE) / count
    if slot < APART:
        msg = (f'{count} changes of the load do not fit into {seconds:g} s: each takes '
               f'{APART:g} s after the first {FIRST_CHANGE:g} s; record longer or change less')
        raise SimulationError(msg)
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        time = FIRST_CHANGE + slot * number + rng.uniform(0.0, slot - APART)
        mass = round(float(rng.uniform(*LOADS)), 4)
        carried = 0.0 if carried > 0.0 else mass
        found.append(LoadChange(round(float(time), 3), carried))
    return tuple(found)


def carried_at(changes: Sequence[LoadChange], before: float, t: FloatArray) -> FloatArray:
    """Give what is carried over time: before [kg], t (samples,) [s]; returns (samples,) [kg]."""
    masses = np.array([before, *(change.mass for change in changes)])
    return np.asarray(masses[np.searchsorted([change.time for change in changes], t, 'right')])
