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

"""
The force at the tip along a direction, from what gauges read beyond what they read without it.

A unit force at the tip bends gauge g by s_g = k_g a_g . (p_g - p_tip) x n, with the gain k_g of
the gauge and the axis a_g it bends about. All gauges together give F = sum(w s (e - b)) /
sum(w s^2), weighted by their noise. What they read before contact, b, is followed slowly, and from
contact on kept as it was a little before: a surface presses softly at first.
"""

from __future__ import annotations

from collections import deque
import math

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.kinematics import gauge_point, joint_axis, unit_vector
from tudor_dynamics.errors import ArmError
from tudor_dynamics.typing import FloatArray

FOLLOWED = 0.5
"""Time over which readings without contact are followed [s]."""
BACK = 0.3
"""So long before contact is felt it may have begun [s]."""
STUCK = 0.3
"""A reading that does not change for so long is that of a dead gauge [s]."""
APART = 8.0
"""Standard deviations, of noise and of force, that gauges may differ by from one force."""
SHARE = 0.6
"""Part of its share of the force that a gauge may be off by."""


class TipSensing:
    """Force at the tip along a direction: normal (3,)."""

    def __init__(self, arm: Arm, normal: FloatArray) -> None:
        sensors = {sensor.gauge: sensor for sensor in arm.spec.sensors}
        self._used = [k for k, gauge in enumerate(arm.gauges) if gauge.name in sensors]
        if not self._used:
            msg = (f'{arm.source}: no gauge has a gain in N m; add sensors: with the gain of each '
                   'gauge to control a force')
            raise ArmError(msg)
        gauges = [arm.gauges[k] for k in self._used]
        self.names = tuple(gauge.name for gauge in gauges)
        self._gain = np.array([sensors[name].gain for name in self.names])
        self._noise = np.maximum([sensors[name].noise for name in self.names], 1e-9)
        self.normal = normal
        self._model = arm.full_model
        self._data = self._model.createData()
        self._q = pin.neutral(self._model)
        for joint in arm.spec.joints:
            self._q[self._place(joint.name)] = joint.hold
        self._columns = [self._place(name) for name in arm.active_joints]
        self._rates = arm.velocity_index
        self._at = [(self._model.getJointId(gauge.joint), gauge_point(gauge),
                     joint_axis(self._model, gauge.joint) if gauge.axis is None
                     else unit_vector(gauge.axis)) for gauge in gauges]
        self._tip = (self._model.getFrameId('tip') if self._model.existFrame('tip')
                     else self._model.nframes - 1)
        self.reset()

    def _place(self, joint: str) -> int:
        return int(self._model.joints[self._model.getJointId(joint)].idx_q)

    def reset(self) -> None:
        """Forget what gauges read without contact."""
        count = len(self._used)
        self._level: FloatArray | None = None
        self._levels: deque[tuple[float, FloatArray]] = deque()
        self._kept = 0.0
        self._same, self._before = np.zeros(count), np.full(count, np.nan)
        self.fault = ''

    def look(self, q: FloatArray) -> tuple[float, FloatArray]:
        """
        Give where the tip is along the direction, and its speed by joint speed.

        q (joints,) [rad]; returns (joints,).
        """
        self._q[self._columns] = q
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, self._q, self._tip,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacements(self._model, self._data)
        place = self._data.oMf[self._tip].translation
        return float(self.normal @ place), self.normal @ jacobian[:3, self._columns]

    def shares(self) -> FloatArray:
        """Give what a unit force adds to each reading, where `look` was last [1/N]."""
        tip = self._data.oMf[self._tip].translation
        shares = np.zeros(len(self._at))
        for g, (joint, point, axis) in enumerate(self._at):
            carrier = self._data.oMi[joint]
            shares[g] = -(carrier.rotation @ axis) @ np.cross(
                tip - carrier.act(point), self.normal)
        return shares * self._gain

    def step(
        self, dt: float, strain: FloatArray, share: FloatArray | None = None, *, free: bool,
    ) -> float:
        """
        Estimate the force where `look` was last.

        dt [s], strain (gauges,) [its unit], share (gauges,) [1/N]; returns force [N].
        """
        values = strain[self._used]
        self._watch(dt, values)
        if self.fault:
            return math.nan
        if self._level is None:
            self._level = values.copy()
        shares = self.shares() if share is None else share[self._used]
        weights = shares / self._noise**2
        if free:
            follow = min(dt / FOLLOWED, 1.0)
            self._level = self._level + follow * (values - self._level)
            self._levels.append((dt, self._level))
            self._kept += dt
            while self._kept - self._levels[0][0] > BACK:
                self._kept -= self._levels.popleft()[0]
        elif self._levels:
            self._level = self._levels[0][1]
            self._levels.clear()
            self._kept = 0.0
        left = values - (self._levels[0][1] if free else self._level)
        force = float(weights @ left / max(float(weights @ shares), 1e-12))
        if not free:
            off = np.abs(left - shares * force)
            allowed = APART * self._noise + SHARE * np.abs(shares * force) + 0.3 * np.abs(shares)
            wrong = int(np.argmax(off / allowed))
            self._odd = self._odd + dt if off[wrong] > allowed[wrong] else 0.0
            if self._odd > STUCK:
                self.fault = (f'gauge {self.names[wrong]} reads what no force at the tip '
                              'explains with the others')
        else:
            self._odd = 0.0
        return force

    _odd = 0.0

    def _watch(self, dt: float, values: FloatArray) -> None:
        """Say which gauge is missing or does not change any more."""
        self._same = np.where(values == self._before, self._same + dt, 0.0)
        self._before = values.copy()
        for g, name in enumerate(self.names):
            if not math.isfinite(values[g]):
                self.fault = f'gauge {name} is missing'
            elif self._same[g] > STUCK:
                self.fault = f'gauge {name} does not change: it is stuck or silent'
