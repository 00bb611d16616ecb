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

"""Gains that follow the loop: what its measured delay allows, and nothing for what excites."""

from __future__ import annotations

from tudor_dynamics.arm.drives import DamperSpec
from tudor_dynamics.control.cascade import velocity_lag
from tudor_dynamics.control.delay_margin import damping_share, position_gain_limit
from tudor_dynamics.control.guards.swing_watch import SwingWatch
from tudor_dynamics.control.loop_delay import DelayMeter
from tudor_dynamics.typing import FloatArray

RAMP_TIME = 0.5
"""In which the damper's share comes up or goes away [s]."""
UNKNOWN_DELAY = 0.03
"""Delay of the loop that is assumed until it was measured [s]."""
CAREFUL_DELAY = 0.1
"""The same where the way to a limit is judged [s]."""
QUICK = 10.0
"""So much sooner a shorter period is learned than a longer one."""


def learned_period(period: float, dt: float) -> float:
    """
    Learn the time between samples; long ones lack some in between, so short ones count more.

    period, dt [s]; returns [s].
    """
    share = period if dt > period else min(QUICK * period, 1.0)
    return period + share * (min(dt, 2.0 * period) - period)


class LoopGains:
    """
    Gains of damper and position loop in use.

    speed (joints,) [rad/s], share, position_gain [1/s], full_delay [s]; excited: empty if it is
    not.
    """

    def __init__(self, spec: DamperSpec, speed: FloatArray, share: float = 1.0) -> None:
        self.described = self._basis = spec.position_gain
        self._asked = 0.0
        self.described_delay = self.full_delay = spec.full_delay
        self.share = self.weight = share
        self.delay = DelayMeter(speed)
        self.adapts = True
        self.excited = ''
        self._swing = SwingWatch(speed)
        self._lag = velocity_lag(spec)

    def reset(self) -> None:
        """Try the damper again."""
        self.excited = ''
        self.begin()

    def begin(self) -> None:
        """Take the next sample for a first one."""
        self._swing.reset()
        self.delay.reset()

    def set_position_gain(self, gain: float) -> None:
        """Ask for a speed per position error [1/s], 0 for that of description or schedule."""
        self._asked = gain

    @property
    def position_gain(self) -> float:
        """Speed per position error that is asked for [1/s]."""
        return self._asked if self._asked > 0.0 else self._basis

    def adapt(self, position_gain: float, full_delay: float, weight: float) -> None:
        """Take scheduled values in use: position_gain [1/s], full_delay [s]."""
        self._basis = self.described + weight * (position_gain - self.described)
        self.full_delay = self.described_delay + weight * (full_delay - self.described_delay)

    @property
    def assumed_delay(self) -> float:
        """Delay of the loop, assumed where it was not measured yet [s]."""
        delay = self.delay.delay
        return UNKNOWN_DELAY if delay is None else delay

    @property
    def allowed_share(self) -> float:
        """Part of what is asked for that the loop allows, 0 to 1."""
        if not self.adapts:
            return 1.0
        if self.excited:
            return 0.0
        delay = self.delay.delay
        return 1.0 if delay is None else damping_share(delay, self.full_delay)

    def response_time(self, period: float) -> float:
        """Give the longest time from a command to the motion, by the period of samples [s]."""
        delay = self.delay.delay
        return (CAREFUL_DELAY if delay is None else delay) + self._lag + period

    def position_gain_in_use(self, period: float) -> float:
        """Give the speed per position error that the loop allows [1/s]: period [s]."""
        gain = self.described if self.excited else self.position_gain
        return min(gain, position_gain_limit(self.assumed_delay + self._lag + period))

    def step(self, dt: float) -> float:
        """Advance by a step [s] and give the part of the damper's gains in force."""
        change = dt / RAMP_TIME
        self.weight += min(max(self.share * self.allowed_share - self.weight, -change), change)
        return self.weight

    def judge(self, dt: float, added: FloatArray, moving: bool, cut: bool) -> None:
        """
        Look for a swing in what was added to the reference [s, rad/s], see `SwingWatch`.

        dt [s], added (joints,) [rad/s].
        """
        excited = self._swing.step(dt, added, moving, cut)
        if excited:
            self.excited = excited
