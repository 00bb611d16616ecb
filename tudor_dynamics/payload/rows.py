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

"""What each parameter of the last body adds to the outputs of an arm."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.models.payload import last_body
from tudor_dynamics.models.regressor import plain_regressor
from tudor_dynamics.models.rigid_bodies import BODY_PARAMETERS
from tudor_dynamics.payload.inertia import point_mass, reframed
from tudor_dynamics.typing import FloatArray


def carrier(arm: Arm) -> str:
    """Give the joint that moves what the arm carries; its frame is that of all parameters."""
    return last_body(arm.model)


def carrier_frame(arm: Arm) -> str:
    """Give the name of the frame that turns with the carrier: its link's, or the joint's own."""
    joint = carrier(arm)
    index = arm.model.getJointId(joint)
    for frame in arm.model.frames:
        if (frame.type == pin.FrameType.BODY and frame.parentJoint == index
                and frame.placement.isIdentity(1e-9)):
            return str(frame.name)
    return joint


def tip(arm: Arm) -> FloatArray:
    """
    Give the place that a load is taken to sit at: the frame that is farthest out.

    Returns (3,) [m].
    """
    index = arm.model.getJointId(carrier(arm))
    place = np.zeros(3)
    for frame in arm.model.frames:
        if frame.parentJoint == index:
            found = np.array(frame.placement.translation)
            if np.linalg.norm(found) > np.linalg.norm(place):
                place = found
    return place


class LoadRows:
    """
    Rows of the last body, about the frame of the carrier whatever the output is.

    point_parameters (channels, columns).
    """

    def __init__(self, arm: Arm, output: str) -> None:
        model = arm.gauge_model if output == 'strain' else arm.model
        self.regressor = plain_regressor(arm, output, 'exact')
        self.channels = self.regressor.channels
        body = last_body(model)
        columns = self.regressor.columns
        self._carried = np.array([columns.index(f'{name}({body})') for name in BODY_PARAMETERS],
                                 dtype=np.intp)
        data = model.createData()
        pin.forwardKinematics(model, data, pin.neutral(model))
        places = [data.oMi[model.getJointId(name)] for name in (carrier(arm), body)]
        self._frame = reframed(places[0].actInv(places[1]))
        self.point_parameters = np.zeros((len(self.channels), len(columns)))
        self.point_parameters[:, self._carried] = self._frame @ point_mass(tip(arm))

    def rows(self, motion: FloatArray) -> FloatArray:
        """
        Evaluate the rows of all ten parameters.

        motion (samples, 3 joints): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (samples, channels, 10) [its unit].
        """
        return np.asarray(self.regressor.rows(motion)[:, :, self._carried] @ self._frame)

    def point(self, motion: FloatArray) -> FloatArray:
        """
        Evaluate what one kilogram at the tip adds, without making the rows.

        motion (samples, 3 joints): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (samples, channels).
        """
        return self.regressor.outputs(motion, self.point_parameters)
