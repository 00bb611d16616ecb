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

"""Where a gauge sits on the beam of its link, and which bending it feels."""

from __future__ import annotations

from dataclasses import dataclass
import math

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import gauge_point, unit_vector
from tudor_dynamics.arm.schema import GaugeSpec
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.simulation.mechanics import layout as at
from tudor_dynamics.simulation.mechanics.mechanism import Mechanism


@dataclass(frozen=True)
class GaugePlace:
    """A gauge on a mechanism."""

    body: int  # number of the beam's body
    distance: float  # from the beam's start [m]
    axis: int  # component of the moment that bends the beam there: 1 or 2
    sign: float  # makes the moment positive for the load that the joint holds


def place_gauge(mechanism: Mechanism, arm: Arm, gauge: GaugeSpec) -> GaugePlace:
    """Find a gauge's place on a mechanism."""
    if gauge.joint not in mechanism.beams:
        msg = (f'{arm.source}: gauge {gauge.name!r} sits on the link of {gauge.joint!r}, '
               'which is rigid here; make it flexible in links, or leave the gauge out')
        raise SimulationError(msg)
    body = mechanism.body_of[gauge.joint]
    floats = mechanism.body_float[body]
    frame = floats[at.BODY_ROTATION:at.BODY_ROTATION + 9].reshape(3, 3)
    start = floats[at.BODY_PLACE:at.BODY_PLACE + 3]
    distance = float(frame[:, 0] @ (gauge_point(gauge) - start))
    axis = floats[at.AXIS:at.AXIS + 3] if gauge.axis is None else unit_vector(gauge.axis)
    local = frame.T @ axis
    column = 2 if abs(local[2]) >= abs(local[1]) else 1
    # Positive for the load that the joint holds: the moment of the inboard part counts.
    return GaugePlace(body, distance, column, -math.copysign(1.0, float(local[column])))
