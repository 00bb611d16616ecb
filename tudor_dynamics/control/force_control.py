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

"""Force control: the force at the tip from gauges, held against a surface."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import IntEnum
import math

import numpy as np
import pinocchio as pin

from tudor_dynamics.arm.description import Arm
from tudor_dynamics.arm.kinematics import gauge_axis, gauge_point
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control import settings
from tudor_dynamics.errors import ArmError, UsageError
from tudor_dynamics.signals.motion_profile import Deviation, motion_limits, MotionPlanner
from tudor_dynamics.typing import FloatArray


# -- The force at the tip along a direction, from what gauges read beyond what they read without
#    it.
#
# A unit force at the tip bends gauge g by s_g = k_g a_g . (p_g - p_tip) x n, with the gain k_g of
# the gauge and the axis a_g it bends about. All gauges together give F = sum(w s (e - b)) / sum(w
# s^2), weighted by their noise. What they read before contact, b, is followed slowly, and from
# contact on kept as it was a little before: a surface presses softly at first.

class TipSensing:
    """Force at the tip along a direction: normal (3,)."""

    def __init__(self, arm: Arm, normal: FloatArray) -> None:
        sensors = {sensor.gauge: sensor for sensor in arm.spec.sensors}
        self._used = [k for k, gauge in enumerate(arm.gauges) if gauge.name in sensors]
        if not self._used:
            raise ArmError(f'{arm.source}: no gauge has a gain, so the force is unknown; add the '
                           "key 'sensors' with gauge and gain (its reading per N m)")
        gauges = [arm.gauges[k] for k in self._used]
        self.names = tuple(gauge.name for gauge in gauges)
        self._gain = np.array([sensors[name].gain for name in self.names])
        self._noise = np.maximum([sensors[name].noise for name in self.names], 1e-9)
        self.normal = normal
        self._model = arm.full_model
        self._data = self._model.createData()
        self._q, self._columns = arm.held_pose()
        self._at = [(self._model.getJointId(gauge.joint), gauge_point(gauge),
                     gauge_axis(self._model, gauge)) for gauge in gauges]
        self._tip = (self._model.getFrameId('tip') if self._model.existFrame('tip')
                     else self._model.nframes - 1)
        self.reset()

    def reset(self) -> None:
        """Forget what gauges read without contact."""
        count = len(self._used)
        self._level: FloatArray | None = None
        self._levels: deque[tuple[float, FloatArray]] = deque()
        self._kept = 0.0
        self._same, self._before = np.zeros(count), np.full(count, np.nan)
        self._odd = 0.0
        self.fault = ''

    def look(self, q: FloatArray) -> FloatArray:
        """Give the speed of the tip along the direction by joint speed, (joints,)."""
        self._q[self._columns] = q
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, self._q, self._tip,
            pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pin.updateFramePlacements(self._model, self._data)
        return np.asarray(self.normal @ jacobian[:3, self._columns])

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
        """Estimate the force [N] where `look` was last; share (gauges,) [1/N], or its own."""
        values = strain[self._used]
        self._same = np.where(values == self._before, self._same + dt, 0.0)
        self._before = values.copy()
        for g, name in enumerate(self.names):
            if not math.isfinite(values[g]):
                self.fault = f'the reading of gauge {name!r} is missing; check its driver'
            elif self._same[g] > settings.FORCE_STUCK:
                self.fault = f'the reading of gauge {name!r} is stuck; check gauge and driver'
        if self.fault:
            return math.nan
        if self._level is None:
            self._level = values.copy()
        shares = self.shares() if share is None else share[self._used]
        weights = shares / self._noise**2
        if free:
            self._odd = 0.0
            follow = min(dt / settings.FORCE_FOLLOWED, 1.0)
            self._level = self._level + follow * (values - self._level)
            self._levels.append((dt, self._level))
            self._kept += dt
            while self._kept - self._levels[0][0] > settings.FORCE_BACK:
                self._kept -= self._levels.popleft()[0]
        elif self._levels:
            self._level = self._levels[0][1]
            self._levels.clear()
            self._kept = 0.0
        left = values - (self._levels[0][1] if free else self._level)
        force = float(weights @ left / max(float(weights @ shares), 1e-12))
        if not free:
            off = np.abs(left - shares * force)
            allowed = (settings.FORCE_APART * self._noise
                       + settings.FORCE_SHARE * np.abs(shares * force) + 0.3 * np.abs(shares))
            wrong = int(np.argmax(off / allowed))
            self._odd = self._odd + dt if off[wrong] > allowed[wrong] else 0.0
            if self._odd > settings.FORCE_STUCK:
                self.fault = ('no force at the tip explains the readings of all gauges; check '
                              f'gauge {self.names[wrong]!r}, which fits worst')
        return force


# -- Holds a force of the tip against a surface of unknown height and stiffness.
#
# The tip moves along the normal with v = k_i (F - F_w) + k_p d(F - F_w)/dt, F being the force on
# the tip, as joint speeds along the gradient of its height. Arm and surface are springs in series,
# so the arm's own compliance bounds the gain of the loop: the same k_i and k_p hold from soft foam
# to steel. Without contact the tip approaches at a constant speed.

class Phase(IntEnum):
    """What the force controller does."""

    IDLE = 0
    APPROACH = 1
    HOLD = 2
    RETREAT = 3
    HELD = 4


@dataclass(frozen=True)
class ForceSettings:
    """Gains and bounds."""

    approach_speed: float = 0.02  # of the tip towards the surface, and back [m/s]
    reach: float = 0.1  # farthest that is approached; beyond it there is no surface [m]
    touch: float = 0.4  # force from which there is contact [N]
    integral: float = 0.3  # speed of the tip per force that is missing [m/s per N]
    proportional: float = 0.02  # way of the tip per force that is missing [m/N]
    speed: float = 0.1  # largest speed of the tip in contact [m/s]
    give: float = 0.1  # farthest that the surface may give way; beyond it is none to press on [m]
    largest: float = 15.0  # force at which it stops [N]
    lost: float = 0.5  # time without contact after which it is lost [s]
    ramp: float = 0.15  # time constant of a new wanted force [s]


class ForceController:
    """Reference of an arm that holds a force: force, wanted [N]."""

    def __init__(
        self, arm: Arm, settings: ForceSettings = ForceSettings(),  # noqa: B008 (frozen)
        normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> None:
        length = math.sqrt(sum(value * value for value in normal))
        if not (math.isfinite(length) and length > 1e-6):
            raise UsageError(f'normal is {list(normal)}; give x, y, z that are not all zero')
        self.settings = settings
        self.sensing = TipSensing(arm, np.array(normal) / length)
        self.limits, self._planned = hard_limits(arm), motion_limits(arm)
        self._names = arm.active_joints
        self.phase, self.cause = Phase.IDLE, 'waits for joint positions'
        self.force = self.wanted = self._target = 0.0
        self.pose: FloatArray | None = None  # reference; None before the first positions [rad]
        self._dq = np.zeros(len(arm.active_joints))
        self._smooth = self._way = self._touched = self._alone = 0.0
        self._brake: MotionPlanner | None = None

    def press(self, force: float) -> str:
        """Ask for a force [N]; from rest, the surface comes first. Empty if it is taken."""
        if not (math.isfinite(force) and self.settings.touch < force <= self.settings.largest):
            return (f'the wanted force is {force:g} N; send one above {self.settings.touch:g} N '
                    f"(parameter 'touch') and up to {self.settings.largest:g} N (parameter "
                    "'largest')")
        if self.pose is None:
            return 'no joint positions arrive; start the driver of the arm'
        if self.phase in (Phase.HELD, Phase.RETREAT):
            return f'{self.phase.name.lower()}: {self.cause}'
        self.wanted = force
        if self.phase is Phase.IDLE:
            self.sensing.reset()
            self._way = self._target = 0.0
            self.phase, self.cause = Phase.APPROACH, 'approaches the surface'
        return ''

    def retreat(self) -> None:
        """Leave the surface, to where the approach began."""
        if self.phase in (Phase.APPROACH, Phase.HOLD):
            self.phase, self.cause = Phase.RETREAT, 'leaves the surface'

    def clear(self) -> None:
        """Take forces again after a held pose."""
        if self.phase is Phase.HELD:
            self.phase, self.cause = Phase.IDLE, 'waits for a wanted force'
            self._brake = None

    def stop(self, cause: str) -> None:
        """Brake, and hold the pose where that ends."""
        if self.phase is Phase.HELD or self.pose is None:
            return
        self.phase, self.cause = Phase.HELD, cause
        self._brake = MotionPlanner(self._planned, self.pose)
        self._brake.brake(self.pose, self._dq)

    def step(
        self, dt: float, q: FloatArray, strain: FloatArray, share: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Advance the reference by a sample; where dt is 0, begin at the measured pose."""
        if self.pose is None or dt <= 0.0:
            if self.pose is not None and self.phase not in (Phase.IDLE, Phase.HELD):
                self.stop('the joint positions were interrupted; check their driver')
            self.pose = np.clip(q, self.limits.lower, self.limits.upper)
            self._dq = np.zeros(len(q))
            self._brake = None
            if self.phase is Phase.IDLE:
                self.cause = 'waits for a wanted force'
        elif self.phase in (Phase.IDLE, Phase.HELD) or (
                not self._press(q, self.pose, dt, strain, share)):
            if self._brake is not None:
                self._brake.step(dt)
                self.pose, self._dq = self._brake.q.copy(), self._brake.dq.copy()
            else:
                self._dq = np.zeros_like(self._dq)
        return self.pose.copy(), self._dq.copy()

    def _press(
        self, q: FloatArray, place: FloatArray, dt: float, strain: FloatArray,
        share: FloatArray | None,
    ) -> bool:
        """Move the tip along the normal from a place [rad]; False where the arm has to brake."""
        found = Deviation.of(self._names, place - q, self._planned.velocity)
        if found.seconds > settings.NEAR_TIME:  # then its tip is elsewhere
            self.stop(str(found))
            return False
        slope = self.sensing.look(place)
        free = self.phase is not Phase.HOLD and not (
            self.phase is Phase.RETREAT and self._touched > 0.0)
        self.force = self.sensing.step(dt, strain, share, free=free)
        if self.sensing.fault:
            self.stop(self.sensing.fault)
            return False
        speed = self._speed(dt)
        if self._brake is not None:
            return False
        self._way -= speed * dt
        size = float(slope @ slope)
        dq = slope * (speed / size) if size > 1e-6 else np.zeros_like(slope)
        self._dq = dq / float(np.max(np.abs(dq) / self._planned.velocity, initial=1.0))
        new = place + dt * self._dq
        outside = self.limits.outside(new)
        if size <= 1e-6 or outside.any():
            why = 'singular pose' if size <= 1e-6 else f'limit of {self._names[outside.argmax()]}'
            self.stop(f'the tip cannot move on along the normal ({why}); begin in another pose')
            return False
        self.pose = new
        return True

    def _speed(self, dt: float) -> float:
        """Give the speed of the tip along the normal; negative is towards the surface [m/s]."""
        chosen = self.settings
        before = self._smooth
        self._smooth += min(dt / (settings.FORCE_SMOOTH + dt), 1.0) * (self.force - self._smooth)
        if self.force > chosen.largest:
            self.stop(f"the force on the tip is {self.force:.1f} N, above the parameter 'largest' "
                      f'of {chosen.largest:g} N; send smaller forces or slower motion')
            return 0.0
        if self.phase is Phase.APPROACH:
            self._smooth = max(self._smooth, 0.0) if self.force > 0.0 else 0.0
            if self._smooth > chosen.touch:
                self.phase, self.cause = Phase.HOLD, 'holds the force'
                self._target, self._touched, self._alone = self._smooth, self._way, 0.0
            elif self._way > chosen.reach:
                self.stop(f'the tip met no surface within {1e3 * chosen.reach:.0f} mm; begin '
                          "closer to it, or raise the parameter 'reach'")
                return 0.0
            return -chosen.approach_speed
        if self.phase is Phase.RETREAT:
            if self._way <= 0.0:
                self.phase, self.cause, self._touched = Phase.IDLE, 'waits for a wanted force', 0.0
                return 0.0
            return chosen.approach_speed
        late = self._target
        self._target += min(dt / chosen.ramp, 1.0) * (self.wanted - self._target)
        lost = self._smooth < settings.FORCE_SOFT * self.wanted
        self._alone = self._alone + dt if lost else 0.0
        if self._alone > chosen.lost:
            self.stop(f"contact was lost for {chosen.lost:g} s (parameter 'lost'); check the tool")
            return 0.0
        if self._way - self._touched > chosen.give:
            self.stop(f"the surface gave way by {1e3 * chosen.give:.0f} mm (parameter 'give')")
            return 0.0
        rate = (self._smooth - before - (self._target - late)) / dt
        speed = chosen.integral * (self._smooth - self._target) + chosen.proportional * rate
        return float(np.clip(speed, -chosen.speed, chosen.speed))
