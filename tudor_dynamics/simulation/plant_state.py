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

"""What a plant tells after a step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Drive = Literal['torque', 'motion', 'hold']


@dataclass(eq=False)
class PlantState:
    """
    State after a step; the arrays are overwritten by the next one.

    Attributes
    ----------
    t : float
        Time of the state [s].
    q, dq, ddq : ndarray of shape (n_joints,)
        All joints of the mechanism [rad or m and their rates].
    effort : ndarray of shape (n_joints,)
        Effort of each drive: as given where the joint is driven by a torque, the reaction where
        its motion is given or held [N m or N].

    """

    t: float
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    effort: FloatArray


@dataclass(frozen=True)
class Energy:
    """
    Kinetic, elastic and gravitational energy [J].

    Attributes
    ----------
    kinetic : float
        Energy of the motion [J].
    elastic : float
        Energy of beams and joint springs [J].
    gravity : float
        Energy of the masses in the field of gravity [J].

    """

    kinetic: float
    elastic: float
    gravity: float

    @property
    def total(self) -> float:
        """Sum [J]."""
        return self.kinetic + self.elastic + self.gravity


@dataclass(frozen=True)
class Counts:
    """
    Newton iterations and factorisations since the last reset.

    Attributes
    ----------
    iterations : int
        Newton iterations since the last reset.
    factorisations : int
        Factorisations since the last reset.

    """

    iterations: int
    factorisations: int
