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

"""What a driven arm is made of: its reduced links, its gauges, the coordinates that move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.links import InertiaPart
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.gauge_place import place_gauge
from tudor_dynamics.simulation.mechanics.mechanism import build_mechanism, Mechanism
from tudor_dynamics.typing import FloatArray


def reduced_mechanism(arm: Arm) -> Mechanism:
    """Build the arm with one linear element a link; what lies within a link goes to its end."""
    links = []
    for link in arm.spec.links:
        beam = link.flexible
        if beam is not None:
            lumped = tuple(
                part if isinstance(part.node, str) else part.model_copy(
                    update={'node': 'tip' if 2 * part.node >= beam.elements else 'base'})
                for part in beam.lumped)
            beam = beam.model_copy(update={'elements': 1, 'stretch': False, 'lumped': lumped})
        links.append(link.model_copy(update={'flexible': beam}))
    payload = arm.spec.payload or InertiaPart(mass=0.0)
    mechanism = build_mechanism(replace(arm, spec=arm.spec.model_copy(
        update={'links': tuple(links), 'payload': payload})))
    if not mechanism.beams:
        msg = (f'{arm.source}: no link is flexible; give links with flexible: to use the elastic '
               'model')
        raise SimulationError(msg)
    return mechanism


@dataclass(frozen=True, eq=False)
class GaugePlaces:
    """Gauges on the bodies of a mechanism."""

    body: NDArray[np.int64]  # body that each sits on, (gauges,)
    place: FloatArray  # distance from the beam's start, (gauges,) [m]
    axis: NDArray[np.int64]  # (gauges,): component of the moment that bends it: 1 or 2
    sign: FloatArray  # (gauges,): makes the moment positive for the load that the joint holds
    share: tuple[float, ...]  # bending stiffness about that axis over that about the beam's z axis
    joint: tuple[str, ...]  # joint of the link

    def damping(self, values: Mapping[str, float]) -> FloatArray:
        """Give the moment by rate of curvature at each gauge, from damping alone [N m^2 s]."""
        return np.array([share * (values['beta'] * values[f'bending({joint})'])
                         for share, joint in zip(self.share, self.joint, strict=True)])


def place_gauges(mechanism: Mechanism, arm: Arm) -> GaugePlaces:
    """Find the gauges' places on a mechanism."""
    places = [place_gauge(mechanism, arm, gauge) for gauge in arm.gauges]
    joints = tuple(gauge.joint for gauge in arm.gauges)
    beams = [mechanism.beams[joint] for joint in joints]
    return GaugePlaces(
        np.array([place.body for place in places], dtype=np.int64),
        np.array([place.distance for place in places], dtype=float),
        np.array([place.axis for place in places], dtype=np.int64),
        np.array([place.sign for place in places], dtype=float),
        tuple((beam.EIz if place.axis == 2 else beam.EIy) / beam.EIz
              for place, beam in zip(places, beams, strict=True)), joints)


def spring_coordinates(mechanism: Mechanism, arm: Arm) -> NDArray[np.int64]:
    """Give the coordinate of each active joint."""
    return np.array([int(mechanism.q_index[mechanism.joints.index(name)])
                     for name in arm.active_joints], dtype=np.int64)


def moving_coordinates(
    mechanism: Mechanism, gauges: GaugePlaces, springs: NDArray[np.int64],
) -> NDArray[np.int64]:
    """
    Give the coordinates that move: gears, and bending in the planes that gauges see.

    springs (joints,); returns (moving,).
    """
    axes = gauges.axis.tolist()
    seen = set(axes) or {1, 2}
    free = springs.tolist()
    for joint in mechanism.beams:
        own = {axis for axis, of in zip(axes, gauges.joint, strict=True) if of == joint}
        first = int(mechanism.body_int[mechanism.body_of[joint], at.FIRST])
        for plane in sorted(own or seen):
            free += [first + 1, first + 5] if plane == 2 else [first + 2, first + 4]
    return np.array(sorted(free), dtype=np.int64)


def moment_rows(
    mechanism: Mechanism, gauges: GaugePlaces, free: NDArray[np.int64],
) -> FloatArray:
    """
    Give the moment at each gauge by coordinate: stiffness times curvature of the cubic.

    free (moving,); returns (gauges, moving).
    """
    rows = np.zeros((len(gauges.body), free.size))
    floats = mechanism.body_float
    for g, body in enumerate(gauges.body):
        length = floats[body, at.LENGTH]
        place = gauges.place[g] / length
        bend = (12.0 * place - 6.0) / length**2
        turn = (6.0 * place - 2.0) / length
        first = int(mechanism.body_int[body, at.FIRST])
        if gauges.axis[g] == 2:
            stiff, parts = floats[body, at.EIZ], ((first + 1, -bend), (first + 5, turn))
        else:
            stiff, parts = floats[body, at.EIY], ((first + 2, bend), (first + 4, turn))
        for coordinate, factor in parts:
            rows[g, np.flatnonzero(free == coordinate)] = gauges.sign[g] * stiff * factor
    return rows
