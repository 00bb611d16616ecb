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

"""Physical parameters of a driven arm: what a description says of them, and where they go."""

from __future__ import annotations

from collections.abc import Mapping
import math

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.models.elastic.statics import DAMPING, STIFFNESS
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.mechanics.stiffness import stiffness_matrix
from tudor_dynamics.typing import FloatArray

EDGE = 0.1
"""The edge of a play is rounded over this part of it, where nothing better is known."""
RIGID_GEAR = 30.0
"""A gear of unknown stiffness is this often as stiff as the link behind it."""


def change(values: dict[str, float], changes: Mapping[str, float], name_of_arm: str) -> None:
    """
    Change physical parameters; none that does not exist, to nothing that cannot be.

    Parameters
    ----------
    values : dict of str to float
        All parameters, overwritten.
    changes : mapping of str to float
        Name to new value.
    name_of_arm : str
        For the messages.

    Raises
    ------
    SimulationError
        If a name is unknown or a value not finite or negative.

    """
    for name, value in changes.items():
        if name not in values:
            msg = f'{name_of_arm} has no parameter {name!r}; it has {", ".join(values)}'
            raise SimulationError(msg)
        if not (math.isfinite(value) and value >= 0.0):
            msg = f'parameter {name} of {name_of_arm}: {value}, expected 0 or more'
            raise SimulationError(msg)
        values[name] = float(value)


class Physics:
    """
    Where the physical parameters of an arm stand in its mechanism.

    Parameters
    ----------
    arm : Arm
        Arm as described.
    mechanism : Mechanism
        Mechanism of the reduced arm, as it was built.

    """

    def __init__(self, arm: Arm, mechanism: Mechanism) -> None:
        self._arm, self._mechanism = arm, mechanism
        self._payload_body = len(mechanism.body_int) - 1
        self._payload_inertia = mechanism.body_float[
            self._payload_body, at.INERTIA:at.INERTIA + 6].copy()
        self._payload_mass = float(mechanism.body_float[self._payload_body, at.MASS])
        self._leaning = {link.joint for link in arm.spec.links
                         if link.flexible is not None and link.flexible.stretch}
        self._first_floats = {joint: mechanism.body_float[mechanism.body_of[joint]].copy()
                              for joint in mechanism.beams}
        self._nominal = {joint: (beam.EIz, beam.density)
                         for joint, beam in mechanism.beams.items()}
        self._lumped: dict[str, tuple[int, float, FloatArray]] = {}
        carried = {body: joint for joint, body in mechanism.body_of.items()}
        for body in range(len(mechanism.body_int) - 1):
            joint = carried.get(int(mechanism.body_int[body, at.PARENT]))
            mass = float(mechanism.body_float[body, at.MASS])
            if body in carried or joint is None or mass <= 0.0:
                continue
            count = sum(name.startswith(f'lumped({joint},') for name in self._lumped)
            inertia = mechanism.body_float[body, at.INERTIA:at.INERTIA + 6].copy()
            self._lumped[f'lumped({joint},{count + 1})'] = body, mass, inertia

    def described(self) -> dict[str, float]:
        """Give the parameters as far as the description knows them, see ``DrivenArm``."""
        arm = self._arm
        values: dict[str, float] = {}
        stiffest = 0.0
        for joint, beam in self._mechanism.beams.items():
            values[f'bending({joint})'] = beam.EIz
            values[f'density({joint})'] = beam.density
            length = float(self._first_floats[joint][at.LENGTH])
            stiffest = max(stiffest, 3.0 * beam.EIz / length)
        for name, (_, mass, _) in self._lumped.items():
            values[name] = mass
        values['payload'] = self._payload_mass
        motors = {motor.joint: motor for motor in arm.spec.motors}
        links = {link.joint: link for link in arm.spec.links}
        for joint in arm.active_joints:
            motor, link = motors.get(joint), links.get(joint)
            stiffness = motor.stiffness if motor is not None else None
            damping = motor.damping if motor is not None else 0.0
            if stiffness is None and link is not None and link.joint_stiffness is not None:
                stiffness, damping = link.joint_stiffness, link.joint_damping
            values[f'gear({joint})'] = stiffness or RIGID_GEAR * stiffest
            values[f'play({joint})'] = 0.5 * motor.backlash if motor is not None else 0.0
            values[f'edge({joint})'] = EDGE
            values[f'tight({joint})'] = values[f'loose({joint})'] = damping
        rayleigh = arm.spec.simulation.rayleigh
        values['alpha'], values['beta'] = rayleigh.alpha, rayleigh.beta
        return values

    def apply(
        self, values: Mapping[str, float], springs: FloatArray, matrices: FloatArray,
    ) -> None:
        """
        Write parameters into the mechanism and its gears.

        Parameters
        ----------
        values : mapping of str to float
            All parameters by name, in SI units.
        springs : ndarray of shape (n_joints, SPRING_FLOATS)
            Table of the gears, overwritten.
        matrices : ndarray of shape (MATRICES, n, n)
            Stiffness and damping of the links, overwritten.

        """
        mechanism = self._mechanism
        for joint in mechanism.beams:
            body, first = mechanism.body_of[joint], self._first_floats[joint]
            floats = mechanism.body_float[body]
            scale = values[f'bending({joint})'] / self._nominal[joint][0]
            floats[[at.EIY, at.EIZ, at.GJ]] = scale * first[[at.EIY, at.EIZ, at.GJ]]
            lighter = values[f'density({joint})'] / self._nominal[joint][1]
            floats[[at.DENSITY, at.POLAR]] = lighter * first[[at.DENSITY, at.POLAR]]
            floats[at.ALPHA], floats[at.BETA] = values['alpha'], values['beta']
            floats[at.EA] = 0.0  # beams keep their length: the kernel sees to it
            # below zero: linear beams, which nothing draws in
            floats[at.STRETCH] = 0.0 if joint in self._leaning else -1.0
        for name, (body, mass, inertia) in self._lumped.items():
            floats = mechanism.body_float[body]
            floats[at.MASS] = values[name]
            floats[at.INERTIA:at.INERTIA + 6] = inertia * (values[name] / mass)
        floats = mechanism.body_float[self._payload_body]
        floats[at.MASS] = values['payload']
        if self._payload_mass > 0.0:
            floats[at.INERTIA:at.INERTIA + 6] = self._payload_inertia * (
                values['payload'] / self._payload_mass)
        for row, joint in zip(springs, self._arm.active_joints, strict=True):
            play = values[f'play({joint})']
            row[:] = (values[f'gear({joint})'], play, max(values[f'edge({joint})'] * play, 1e-9),
                      values[f'tight({joint})'], values[f'loose({joint})'])
        stiffness_matrix(mechanism.body_int, mechanism.body_float, mechanism.coordinate,
                         matrices[STIFFNESS], matrices[DAMPING])
