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

"""What is handed to a plant: taken as it is, or refused in one line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.errors import SimulationError
from tudor_dynamics.typing import FloatArray


def check_settings(dt: float, rho: float) -> None:
    """Refuse settings that no integrator has: dt [s]."""
    if not (np.isfinite(dt) and dt > 0.0):
        msg = f'the step must be positive, found {dt} s'
        raise SimulationError(msg)
    if not 0.0 <= rho <= 1.0:
        msg = f'rho is the damping of the integrator, from 0 to 1, found {rho}'
        raise SimulationError(msg)


def put(
    vector: FloatArray, places: NDArray[np.intp], values: ArrayLike, name: str,
    joints: Sequence[str],
) -> None:
    """
    Put a value of each joint where it belongs.

    places (joints,), values (joints,) [unit of the vector]; writes vector (n,).
    """
    try:
        vector[places] = values
    except (TypeError, ValueError):
        msg = (f'{name} is {repr(values)[:60]}; expected {places.size} numbers, for the '
               f'joints {list(joints)}')
        raise SimulationError(msg) from None


def put_force(wrench: FloatArray, force: FloatArray, tip: int) -> None:
    """
    Put an external force where it acts.

    force (3,) [N, N m]; writes wrench (points, 6) [N, N m].
    """
    if force.shape == wrench.shape:
        wrench[:] = force
    elif force.shape in ((3,), (6,)):
        wrench[:] = 0.0
        wrench[tip, :force.size] = force
    else:
        msg = (f'external_force has shape {force.shape}; expected (3,) or (6,) at the tip, '
               f'or {wrench.shape} for all points')
        raise SimulationError(msg)
