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

"""Where the physical parameters of a driven arm are read from, and the tables they act in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tudor_dynamics.arm import Arm
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.typing import FloatArray

Owner = Literal['link', 'part', 'tip', 'joint', 'arm']
"""What has parameters: each flexible link, lumped part and gear, the tip, the whole arm."""


@dataclass(frozen=True, eq=False)
class LumpedMass:
    """A lumped mass as it was described."""

    body: int  # body of the mechanism
    mass: float  # mass of the part [kg]
    inertia: FloatArray  # inertia about its centre, (6,) [kg m^2]


class Physics:
    """
    An arm as it was described, and the tables that its physical parameters change.

    springs (joints, SPRING_FLOATS), lag [s].
    """

    def __init__(self, arm: Arm, mechanism: Mechanism, springs: FloatArray) -> None:
        self.arm, self.mechanism, self.springs = arm, mechanism, springs
        self.parts = self._parts()
        self.lag = 0.0
        self.owners: dict[Owner, tuple[str, ...]] = {
            'link': tuple(mechanism.beams), 'part': tuple(name for name in self.parts if name),
            'tip': ('',), 'joint': arm.active_joints, 'arm': ('',)}
        self._built = {joint: self.beam(joint).copy() for joint in mechanism.beams}
        drawn_in = {link.joint for link in arm.spec.links
                    if link.flexible is not None and link.flexible.stretch}
        for joint in mechanism.beams:
            self.beam(joint)[at.EA] = 0.0  # beams keep their length: the kernel sees to it
            # below zero: linear beams, which nothing draws in
            self.beam(joint)[at.STRETCH] = 0.0 if joint in drawn_in else -1.0

    def _parts(self) -> dict[str, LumpedMass]:
        mechanism, found = self.mechanism, dict[str, LumpedMass]()
        behind = {body: joint for joint, body in mechanism.body_of.items()}
        *bodies, payload = range(len(mechanism.body_int))
        for body in bodies:
            joint = behind.get(int(mechanism.body_int[body, at.PARENT]))
            part = self._part(body)
            if body not in behind and joint is not None and part.mass > 0.0:
                count = sum(name.startswith(f'{joint},') for name in found)
                found[f'{joint},{count + 1}'] = part
        return {**found, '': self._part(payload)}

    def _part(self, body: int) -> LumpedMass:
        floats = self.mechanism.body_float[body]
        return LumpedMass(body, float(floats[at.MASS]), floats[at.INERTIA:at.INERTIA + 6].copy())

    def beam(self, joint: str) -> FloatArray:
        """Give the row of the beam behind a joint in the mechanism's table; a view."""
        return self.mechanism.body_float[self.mechanism.body_of[joint]]

    def scale_beam(self, joint: str, columns: list[int], factor: float) -> None:
        """Set properties of a beam by what they were as it was built."""
        self.beam(joint)[columns] = factor * self._built[joint][columns]

    def weigh(self, name: str, mass: float) -> None:
        """Set the mass of a part, its inertia in proportion: mass [kg]."""
        part = self.parts[name]
        floats = self.mechanism.body_float[part.body]
        floats[at.MASS] = mass
        if part.mass > 0.0:
            floats[at.INERTIA:at.INERTIA + 6] = part.inertia * (mass / part.mass)

    def spring(self, joint: str) -> FloatArray:
        """Give the row of the gear of a joint in the table of gears; a view."""
        return self.springs[self.arm.active_joints.index(joint)]

    @property
    def stiffest(self) -> float:
        """Largest stiffness of a link that turns at its end, held at its start [N m/rad]."""
        return max(3.0 * beam.EIz / float(self._built[joint][at.LENGTH])
                   for joint, beam in self.mechanism.beams.items())
