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

"""What goes into the closed loop and comes out: payload and recorded signals."""

from __future__ import annotations

from dataclasses import dataclass
import math

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.links import InertiaPart
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """What was recorded, at the times of the samples."""

    t: FloatArray  # times of the samples, (samples,) [s]
    # As measured, (samples, joints) [rad, rad/s, A].
    q: FloatArray
    dq: FloatArray
    current: FloatArray
    strain: FloatArray  # as measured, in units of the gauges, (samples, gauges)
    # Position and speed of the reference, (samples, joints) [rad, rad/s].
    q_ref: FloatArray
    dq_ref: FloatArray
    q_true: FloatArray  # angle of the link behind the gear, (samples, joints) [rad]


def with_payload(arm: Arm, mass: float) -> Arm:
    """
    Put a mass at the tip of an arm; 0 takes it away.

    Parameters
    ----------
    arm : Arm
        Arm with any payload, or none.
    mass : float
        Mass at the tip [kg].

    Returns
    -------
    Arm
        Arm with the payload as a point at its tip.

    Raises
    ------
    SimulationError
        If the mass is negative or not finite.

    """
    if not (math.isfinite(mass) and mass >= 0.0):
        msg = f'a payload of {mass} kg is impossible; give 0 or more'
        raise SimulationError(msg)
    part = InertiaPart(mass=mass) if mass > 0.0 else None
    spec = arm.spec.model_copy(update={'payload': part})
    return Arm(spec, arm.full_model, arm.source, arm.urdf)
