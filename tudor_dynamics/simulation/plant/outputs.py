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

"""What a run shows: motion of nodes, internal loads anywhere along a beam, surface strain."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.energy import refresh
from tudor_dynamics.simulation.mechanics.gauge_place import place_gauge
from tudor_dynamics.simulation.mechanics.loads import (
    joint_reactions, LOADS, nodal_motion, section_loads)
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism
from tudor_dynamics.simulation.plant.plant import Plant
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Observation:
    """What ``Probe.observe`` saw; arrays are overwritten by the next call."""

    # In the base frame, (points, 3) [m, m/s, m/s^2].
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    # (sections, 3): normal and shear forces [N]; torsion and bending moments about the section's y
    # and z [N m], of the outboard part on the inboard one.
    force: FloatArray
    moment: FloatArray
    # Force and moment that each joint transmits to the links it carries, about the joint and in
    # the base frame; the moment about its axis includes the drive's, (joints, 6) [N, N m].
    reaction: FloatArray
    strain: FloatArray  # (gauges,): in the unit of each gauge; um/m where that is a voltage
    # Bending moment at each gauge, positive for the load that the joint holds, (gauges,) [N m].
    gauge_moment: FloatArray


@dataclass(frozen=True)
class BeamPlace:
    """A place along a beam: joint before it and distance from the beam's start [m]."""

    joint: str  # joint before the beam
    distance: float  # distance from the beam's start [m]


def middle_sections(mechanism: Mechanism) -> list[BeamPlace]:
    """Give the middle of each beam."""
    result = []
    for joint in mechanism.beams:
        body = mechanism.body_of[joint]
        length = (mechanism.body_float[body, at.LENGTH]
                  * mechanism.body_int[body, at.ELEMENTS])
        result.append(BeamPlace(joint, 0.5 * float(length)))
    return result


class Probe:
    """
    Nodal motion, internal loads and strains of a plant.

    bodies, places (places,) [m], gains (gauges, 3); writes loads (places, LOADS) [N, N m].
    """

    def __init__(self, plant: Plant, sections: list[BeamPlace] | None = None,
                 arm: Arm | None = None) -> None:
        self.plant = plant
        mechanism = plant.mechanism
        self.sections = middle_sections(mechanism) if sections is None else list(sections)
        self.gauge_names = tuple(g.name for g in arm.gauges) if arm is not None else ()
        self._count = len(self.sections)
        places = [(s.joint, s.distance) for s in self.sections]
        self.gains = np.zeros((len(self.gauge_names), 3))
        if arm is not None:
            places += [self._gauge(arm, number) for number in range(len(arm.gauges))]
        for joint, distance in places:
            self._check(joint, distance)
        self.bodies = np.array([mechanism.body_of[joint] for joint, _ in places], dtype=np.int64)
        self.places = np.array([distance for _, distance in places], dtype=float)
        self.loads = np.zeros((len(places), LOADS))
        self._points = np.zeros((3, mechanism.points, 3))
        self._force = np.zeros(mechanism.size)
        self._gauge_loads = self.loads[self._count:]
        # plain numbers: those of numpy take longer than the mechanics
        self._gauge_gains = [
            (per_moment, per_rate, int(axis), math.copysign(1.0, per_moment))
            for per_moment, per_rate, axis in self.gains.tolist()]
        position, velocity, acceleration = self._points
        self.observation = Observation(
            position, velocity, acceleration, self.loads[:self._count, :3],
            self.loads[:self._count, 3:6], np.zeros((len(mechanism.joints), 6)),
            np.zeros(len(self.gauge_names)), np.zeros(len(self.gauge_names)))

    def observe(self) -> Observation:
        """Look at the present state of the plant."""
        plant = self.plant
        z, dz, ddz = plant.tables.vectors[:3]
        chain, seen = plant.tables.chain, self.observation
        joint_reactions(z, dz, ddz, chain, plant.loaded, self._force, plant.bodies, seen.reaction)
        section_loads(z, dz, ddz, chain, self.bodies, self.places, self.loads)
        refresh(z, dz, ddz, chain)
        nodal_motion(z, dz, ddz, plant.mechanism.gravity, chain, *self._points)
        for number, (per_moment, per_rate, axis, sign) in enumerate(self._gauge_gains):
            row = self._gauge_loads[number]
            moment = row[3 + axis]
            seen.strain[number] = per_moment * moment + per_rate * row[6 + axis]
            seen.gauge_moment[number] = sign * moment
        return self.observation

    def _gauge(self, arm: Arm, number: int) -> tuple[str, float]:
        gauge, mechanism = arm.gauges[number], self.plant.mechanism
        place = place_gauge(mechanism, arm, gauge)
        beam, sign = mechanism.beams[gauge.joint], place.sign
        if gauge.unit == 'N m':
            self.gains[number] = sign, 0.0, place.axis
        else:
            bending, surface = ((beam.EIz, beam.surface_y) if place.axis == 2
                                else (beam.EIy, beam.surface_z))
            scale = 1.0 if gauge.unit == 'm/m' else 1e6
            beta = mechanism.body_float[place.body, at.BETA]
            self.gains[number] = (sign * scale * surface / bending,
                                  -sign * scale * surface * beta, place.axis)
        return gauge.joint, place.distance

    def _check(self, joint: str, distance: float) -> None:
        mechanism = self.plant.mechanism
        if joint not in mechanism.beams:
            msg = (f'{mechanism.name}: there is no beam behind joint {joint!r}; beams stand '
                   f'behind {list(mechanism.beams)}')
            raise SimulationError(msg)
        body = mechanism.body_of[joint]
        length = mechanism.body_float[body, at.LENGTH] * mechanism.body_int[body, at.ELEMENTS]
        if not -1e-9 <= distance <= length + 1e-9:
            msg = (f'{mechanism.name}: a section {distance:g} m from the start of the beam behind '
                   f'{joint!r} lies outside its {length:g} m')
            raise SimulationError(msg)
