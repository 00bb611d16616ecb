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

"""What gauges of a rigid arm feel of a force on a span: levers, at the pose of the sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import gauge_point
from tudor_dynamics.contact.layout import PRESSING
from tudor_dynamics.contact.span import gauge_axis, link_axes, LinkAxes, Span
from tudor_dynamics.typing import FloatArray


class RigidFront:
    """Levers of forces on spans about the gauges; nothing is carried from sample to sample."""

    modes = 0

    def __init__(self, arm: Arm, spans: Sequence[Span]) -> None:
        self._arm, self._spans = arm, spans
        self._model = arm.full_model
        self._data = self._model.createData()
        self._q = pin.neutral(self._model)
        for joint in arm.spec.joints:
            self._q[self._index(joint.name)] = joint.hold
        self._columns = [self._index(name) for name in arm.active_joints]
        self._gauges = [
            (self._model.getJointId(gauge.joint), gauge_point(gauge), gauge_axis(arm, gauge),
             gauge.distance) for gauge in arm.gauges]
        self._axes = [link_axes(arm, span.joint) for span in spans]

    def _index(self, joint: str) -> int:
        return int(self._model.joints[self._model.getJointId(joint)].idx_q)

    def rows(self, row: FloatArray) -> list[FloatArray]:
        """
        Give the moment at each gauge by what presses, span by span.

        row (3 joints,): ``[q, dq, ddq]`` of the active joints
        [rad, rad/s, rad/s^2 or m, m/s, m/s^2]; returns (gauges, PRESSING).
        """
        self._q[self._columns] = row[:len(self._columns)]
        pin.forwardKinematics(self._model, self._data, self._q)
        return [self._levers(span, axes)
                for span, axes in zip(self._spans, self._axes, strict=True)]

    def _levers(self, span: Span, axes: LinkAxes) -> FloatArray:
        own = self._model.getJointId(span.joint)
        near, far = span.ends
        result = np.zeros((len(self._gauges), PRESSING))
        for g, (joint, _, _, distance) in enumerate(self._gauges):
            if joint not in self._model.supports[own]:
                continue
            # inboard of a gauge on the same link nothing bends it
            inner = 0.0 if joint == own and near <= distance else self._moment(
                g, own, near * axes.along, axes.across)
            outer = self._moment(g, own, far * axes.along, axes.across)
            slope = (outer - inner) / (far - near)
            result[g] = (inner - near * slope, slope,
                         self._moment(g, own, far * axes.along, axes.along))
        return result

    def _moment(self, g: int, own: int, at: FloatArray, direction: FloatArray) -> float:
        """Give the moment at a gauge by a unit force at a point of a link."""
        joint, point, axis, _ = self._gauges[g]
        link, carrier = self._data.oMi[own], self._data.oMi[joint]
        lever = link.act(at) - carrier.act(point)
        return -float((carrier.rotation @ axis) @ np.cross(lever, link.rotation @ direction))
