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
    """State after a step; the arrays are overwritten by the next one."""

    t: float  # time of the state [s]
    # All joints of the mechanism, (joints,) [rad or m and their rates].
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    # Effort of each drive: as given where the joint is driven by a torque, the reaction where its
    # motion is given or held, (joints,) [N m or N].
    effort: FloatArray


@dataclass(frozen=True)
class Energy:
    """Kinetic, elastic and gravitational energy [J]."""

    kinetic: float  # energy of the motion [J]
    elastic: float  # energy of beams and joint springs [J]
    gravity: float  # energy of the masses in the field of gravity [J]

    @property
    def total(self) -> float:
        """Sum [J]."""
        return self.kinetic + self.elastic + self.gravity


@dataclass(frozen=True)
class Counts:
    """Newton iterations and factorisations since the last reset."""

    iterations: int  # Newton iterations since the last reset
    factorisations: int  # factorisations since the last reset


def failure_message(
    status: int, name: str, t: float, dt: float, energy: float, loose: list[str],
) -> str:
    """Put a failure into one line: t, dt [s], energy [J]."""
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
