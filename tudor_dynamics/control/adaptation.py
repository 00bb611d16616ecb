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
Gains and expected load that follow payload and pose; nothing of it while the payload is unknown.

A payload that is told changes what is in use slowly, as does a payload that is told no more: gains
go back to the fixed ones then.
"""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.control.damper import Damper
from tudor_dynamics.control.loop_gains import LoopGains
from tudor_dynamics.control.schedule import Schedule
from tudor_dynamics.control.schedule_point import Point
from tudor_dynamics.typing import FloatArray

BLEND_TIME = 1.0
"""In which scheduled gains take the place of fixed ones, or the other way round [s]."""
FOLLOW_TIME = 0.3
"""Time constant with which the payload in use follows the one that was told [s]."""
HURRY = 0.5
"""The mean's corner is so much higher while the payload in use changes by much [Hz]."""
MUCH = 0.1
"""Part of the schedule's range of payloads."""
ROOM, LEAST_ROOM = 0.1, 0.02
"""A payload may be so far beyond the grid: a part of its range, and a mass [kg]."""
SMOOTH = 0.02
"""Time constant of the reference's acceleration [s]."""


class Adaptation:
    """
    Follows payload and pose through a schedule.

    acceleration (joints,) [rad/s^2], timeout [s]; payload [kg]: None before any was told.
    """

    def __init__(self, schedule: Schedule, acceleration: FloatArray) -> None:
        self.schedule = schedule
        self.timeout = 0.0
        self.payload: float | None = None
        self.weight = 0.0
        self.point: Point | None = None
        self._told, self._at = math.nan, -math.inf
        self._refusal = ''
        self._most = acceleration
        self._load: FloatArray | None = None
        self._slow: FloatArray | None = None

    def tell(self, now: float, payload: float) -> str:
        """Take a payload: now [s], payload [kg]; returns an empty string if it is."""
        low, high = float(self.schedule.payload[0]), float(self.schedule.payload[-1])
        room = ROOM * (high - low) + LEAST_ROOM
        if low - room <= payload <= high + room:
            self._told, self._at, self._refusal = min(max(payload, low), high), now, ''
        else:  # not a number neither
            self._told = math.nan
            self._refusal = (f'a payload of {payload:.3g} kg is none of the {low:g} to {high:g} '
                             'kg of the schedule')
        return self._refusal

    @property
    def unknown(self) -> str:
        """Why no payload is known, where none is."""
        return self._refusal or ('the payload was never told' if math.isnan(self._told)
                                 else f'the payload is older than {self.timeout:g} s')

    def report(self) -> dict[str, str]:
        """Give what is in use as texts by name, for diagnostics."""
        values = {'payload in use [kg]': 'none' if self.payload is None else f'{self.payload:.3f}',
                  'scheduled gains in use': f'{self.weight:.2f}'}
        if self.point is not None:
            values['first mode [Hz]'] = f'{self.point.modes[0].frequency:.2f}'
            values['damping ratio by schedule'] = f'{self.point.reached:.2f}'
        return values

    @property
    def mean_frequency(self) -> float:
        """
        Corner of the DC blockers [Hz].

        The weight of what was just picked up is in the strain, but not in its mean yet.
        """
        own = self.schedule.content.mean_frequency
        if self.payload is None or math.isnan(self._told):
            return own
        much = MUCH * float(np.ptp(self.schedule.payload))
        left = abs(self._told - self.payload) / much if much > 0.0 else 0.0
        return own + HURRY * min(left, 1.0)

    def reset(self) -> None:
        """Begin with the fixed gains; the payload that was told is known still."""
        self.weight, self.payload, self.point = 0.0, None, None
        self.forget()

    def forget(self) -> None:
        """Take the next sample for a first one."""
        self._load = self._slow = None

    def known(self, now: float) -> bool:
        """Say whether a payload was told, and not too long before now [s]."""
        return math.isfinite(self._told) and (
            self.timeout <= 0.0 or now - self._at <= self.timeout)

    def step(self, now: float, dt: float, q: FloatArray, dq_ref: FloatArray) -> FloatArray | None:
        """
        Follow for one sample.

        now, dt [s], q (joints,) [rad], dq_ref (joints,) [rad/s]; returns (damped,)
        [units of the gauges], None while the payload is unknown, and was.
        """
        known = self.known(now)
        change = dt / BLEND_TIME
        self.weight = min(max(self.weight + (change if known else -change), 0.0), 1.0)
        if known:
            share = -math.expm1(-dt / FOLLOW_TIME)
            self.payload = self._told if self.payload is None else (
                self.payload + share * (self._told - self.payload))
        if self.payload is None or self.weight == 0.0:
            self.forget()
            return None
        before, self.point = self.point, self.schedule.at(self.payload, q)
        if self._slow is None:
            self._slow = dq_ref.copy()
        ddq = np.clip((dq_ref - self._slow) / (SMOOTH + dt), -self._most, self._most)
        self._slow += ddq * dt
        shift = np.zeros(len(self.point.load))
        load = self.point.load + self.point.inertia @ ddq
        if self._load is not None and before is not None:
            # what the payload itself changes is in the strain already, and in its mean
            shift = self.weight * (load - self._load)
        self._load = load
        return shift

    def use(
        self, now: float, dt: float, q: FloatArray, dq_ref: FloatArray, damper: Damper,
        gains: LoopGains,
    ) -> None:
        """
        Follow for one sample, and let damper and loop have what is in use then.

        now, dt [s], q (joints,) [rad], dq_ref (joints,) [rad/s].
        """
        shift = self.step(now, dt, q, dq_ref)
        if shift is None or self.point is None:
            damper.release()
            gains.adapt(0.0, 0.0, 0.0)
            return
        damper.adapt(self.point.gain, self.mean_frequency, self.weight, shift)
        gains.adapt(self.point.position_gain, self.point.full_delay, self.weight)
