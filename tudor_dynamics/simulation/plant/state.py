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

"""What a plant tells after a step, and after one that failed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tudor_dynamics.simulation.plant import integrator as gen
from tudor_dynamics.typing import FloatArray

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


def failure_message(
    status: int, name: str, t: float, dt: float, energy: float, loose: list[str],
) -> str:
    """
    Put a failure into one line.

    Parameters
    ----------
    status : int
        Of the integrator.
    name : str
        Name of the mechanism.
    t, dt : float
        End of the step that failed, and the step [s].
    energy : float
        Before that step [J].
    loose : list of str
        Joints that are free to move.

    Returns
    -------
    str
        What was found, where, and what to do.

    """
    if status == gen.BAD_INPUT:
        return f'{name}: a torque, force or motion at t = {t:.6g} s is not finite; check the input'
    if status == gen.SINGULAR:
        return (f'{name}: the mass matrix is singular: a joint or node moves nothing (joints free '
                f'to move: {loose}); give every moving link a mass, or a hub_inertia')
    if status == gen.TOO_BENT:
        return (f'{name}: at t = {t:.6g} s a link is bent by more than {gen.MAX_ROTATION} rad, '
                f'where a linear beam means nothing; energy before: {energy:.6g} J; check torques '
                'and sections')
    return (f'{name}: the run diverged at t = {t:.6g} s, energy before: {energy:.6g} J; take a '
            f'smaller step than {dt:g} s or check torques and masses')
