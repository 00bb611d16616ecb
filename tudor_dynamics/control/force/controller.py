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
Holds a force of the tip against a surface of unknown height and stiffness.

The tip moves along the normal with v = k_i (F - F_w) + k_p d(F - F_w)/dt, F being the force on the
tip, as joint speeds along the gradient of its height. Arm and surface are springs in series, so
the arm's own compliance bounds the gain of the loop: the same k_i and k_p hold from soft foam to
steel. Without contact the tip approaches at a constant speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
import math

import numpy as np

from tudor_dynamics.arm import Arm
from tudor_dynamics.arm.limits import hard_limits
from tudor_dynamics.control.force.sensing import TipSensing
from tudor_dynamics.errors import UsageError
from tudor_dynamics.signals.motion_profile import motion_limits, MotionPlanner
from tudor_dynamics.typing import FloatArray


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


SMOOTH = 0.02
"""Time constant of the force that is fed back [s]."""
SOFT = 0.15
"""Part of the wanted force below which contact counts as lost."""


class ForceController:
    """Reference of an arm that holds a force: force, wanted [N]."""

    def __init__(
        self, arm: Arm, settings: ForceSettings = ForceSettings(),  # noqa: B008 (frozen)
        normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
    ) -> None:
        length = math.sqrt(sum(value * value for value in normal))
        if not (math.isfinite(length) and length > 1e-6):
            msg = f'normal {list(normal)} has no direction; give that of the force on the tip'
            raise UsageError(msg)
        self.settings = settings
        self.sensing = TipSensing(arm, np.array(normal) / length)
        self.limits, self._planned = hard_limits(arm), motion_limits(arm)
        self.phase, self.cause = Phase.IDLE, 'no positions yet'
        self.force = self.wanted = 0.0
        self._target = 0.0
        self._q: FloatArray | None = None
        self._dq = np.zeros(len(arm.active_joints))
        self._smooth = self._error = 0.0
        self._way = self._touched = self._alone = 0.0
        self._brake: MotionPlanner | None = None

    @property
    def pose(self) -> FloatArray | None:
        """Give the reference positions; None before the first positions [rad]."""
        return self._q

    def press(self, force: float) -> str:
        """
        Ask for a force; from rest, the surface is approached first.

        force [N]; returns an empty string if it is taken.
        """
        if not (math.isfinite(force) and self.settings.touch < force <= self.settings.largest):
            return (f'a force of {force:g} N: expected more than {self.settings.touch:g} N, from '
                    f'which contact is felt, and at most {self.settings.largest:g} N')
        if self._q is None:
            return 'no positions come: where the arm is, is not known'
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
        """Take forces again behind a held pose."""
        if self.phase is Phase.HELD:
            self.phase, self.cause = Phase.IDLE, 'waits for a force'
            self._brake = None

    def stop(self, cause: str) -> None:
        """Brake, and hold the pose where that ends."""
        if self.phase is Phase.HELD or self._q is None:
            return
        self.phase, self.cause = Phase.HELD, cause
        self._brake = MotionPlanner(self._planned, self._q)
        self._brake.move(self._q, self._dq)
        self._brake.brake()

    def step(
        self, dt: float, q: FloatArray, strain: FloatArray, share: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """
        Advance the reference by a sample.

        q (joints,) [rad], strain (gauges,), share (gauges,) [1/N]; dt [s]: 0 to begin at the
        measured pose; returns reference positions and speeds [rad, rad/s].
        """
        if self._q is None or dt <= 0.0:
            if self._q is not None and self.phase not in (Phase.IDLE, Phase.HELD):
                self.stop('positions were interrupted')
            self._q = np.clip(q, self.limits.lower, self.limits.upper)
            self._dq = np.zeros(len(q))
            self._brake = None
            if self.phase is Phase.IDLE:
                self.cause = 'waits for a force'
            return self._q.copy(), self._dq.copy()
        if self.phase in (Phase.IDLE, Phase.HELD):
            return self._rest(dt)
        _, slope = self.sensing.look(self._q)
        free = self.phase is not Phase.HOLD and not (
            self.phase is Phase.RETREAT and self._touched > 0.0)
        self.force = self.sensing.step(dt, strain, share, free=free)
        if self.sensing.fault:
            self.stop(self.sensing.fault)
            return self._rest(dt)
        speed = self._speed(dt)
        if self._brake is not None:
            return self._rest(dt)
        self._way -= speed * dt
        return self._move(dt, speed, slope)

    def _speed(self, dt: float) -> float:
        """Give the speed of the tip along the normal; negative is towards the surface [m/s]."""
        chosen = self.settings
        before = self._smooth
        self._smooth += min(dt / (SMOOTH + dt), 1.0) * (self.force - self._smooth)
        if self.force > chosen.largest:
            self.stop(f'{self.force:.1f} N on the tip, more than {chosen.largest:g} N')
            return 0.0
        if self.phase is Phase.APPROACH:
            self._smooth = max(self._smooth, 0.0) if self.force > 0.0 else 0.0
            if self._smooth > chosen.touch:
                self.phase, self.cause = Phase.HOLD, 'holds the force'
                self._target, self._touched = self._smooth, self._way
                self._alone = 0.0
            elif self._way > chosen.reach:
                self.stop(f'no surface within {1e3 * chosen.reach:.0f} mm')
                return 0.0
            return -chosen.approach_speed
        if self.phase is Phase.RETREAT:
            if self._way <= 0.0:
                self.phase, self.cause, self._touched = Phase.IDLE, 'waits for a force', 0.0
                return 0.0
            return chosen.approach_speed
        late = self._target
        self._target += min(dt / chosen.ramp, 1.0) * (self.wanted - self._target)
        lost = self._smooth < SOFT * self.wanted
        self._alone = self._alone + dt if lost else 0.0
        if self._alone > chosen.lost:
            self.stop('the surface is lost')
            return 0.0
        if self._way - self._touched > chosen.give:
            self.stop(f'the surface gives way by more than {1e3 * chosen.give:.0f} mm')
            return 0.0
        rate = (self._smooth - before - (self._target - late)) / dt
        speed = chosen.integral * (self._smooth - self._target) + chosen.proportional * rate
        return float(np.clip(speed, -chosen.speed, chosen.speed))

    def _move(
        self, dt: float, speed: float, slope: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        assert self._q is not None
        size = float(slope @ slope)
        dq = slope * (speed / size) if size > 1e-6 else np.zeros_like(slope)
        share = float(np.max(np.abs(dq) / self._planned.velocity, initial=1.0))
        self._dq = dq / share
        place = self._q + dt * self._dq
        inside = np.clip(place, self.limits.lower, self.limits.upper)
        if size <= 1e-6 or np.any(inside != place):
            self.stop('the way along the normal leaves the limits of the joints')
            return self._rest(dt)
        self._q = place
        return self._q.copy(), self._dq.copy()

    def _rest(self, dt: float) -> tuple[FloatArray, FloatArray]:
        assert self._q is not None
        if self._brake is not None:
            self._brake.step(dt)
            self._q, self._dq = self._brake.q.copy(), self._brake.dq.copy()
        else:
            self._dq = np.zeros_like(self._q)
        return self._q.copy(), self._dq.copy()
