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
Damper: a joint yields with a speed proportional to the mean-free strain of its link.

The law of Malzahn, Reinhart and Bertram, a linear feedback of mean-free strain per joint, without
any model. Strain counts positive for the load that the joint holds, so the joint yields with the
opposite sign: the hub follows the tip. The mean has to go because the load of gravity would move
the joint away from its reference.

A gauge whose signal is missing, stale, stuck or implausible is faded out: its last good share
goes to zero within the fade time, and comes back only after the gauge was well for a while.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
import math

import numpy as np
from numpy.typing import ArrayLike

from tudor_dynamics.arm import Arm
from tudor_dynamics.control.damper_law import (
    CORNER, damper_law, GAIN, MEAN, MOVING_CORNER, SETTINGS, STATES, STATUS, WINDOW)
from tudor_dynamics.errors import ArmError
from tudor_dynamics.typing import FloatArray


class Status(IntEnum):
    """What the damper of one joint does, and why it does not damp."""

    DAMPING = 0
    STARTING = 1
    SATURATED = 2
    MISSING = 3
    STALE = 4
    STUCK = 5
    IMPLAUSIBLE = 6


MEANING = {
    Status.DAMPING: 'damps',
    Status.STARTING: 'waits until the gauge was well for a while',
    Status.SATURATED: 'faded out, current or speed of the joint is at its limit',
    Status.MISSING: 'faded out, the strain is missing or not a number: check the gauge',
    Status.STALE: 'faded out, no new strain arrives: check the driver of the gauge',
    Status.STUCK: 'faded out, the strain does not change at all: the gauge is dead',
    Status.IMPLAUSIBLE: 'faded out, the strain jumped or left its range: check the wiring',
}


@dataclass(frozen=True)
class DamperSettings:
    """Settings of the damper of one joint; strains in the unit of the gauge."""

    # Names of joint and gauge.
    joint: str
    gauge: str
    # Yielding speed per mean-free strain; negative where strain counts positive for the load that
    # the joint holds [rad/s per unit].
    gain: float
    mean_frequency: float = 0.1  # corner of the DC blocker [Hz]
    mean_window: float = 0.0  # length of the moving average that takes its place, 0 for none [s]
    speed_limit: float = math.inf  # bound of the yielding speed [rad/s]
    # Without a change of the reading, and without a reading, until it counts as a fault [s].
    dead_time: float = 0.05
    stale_time: float = 0.05
    # Fastest plausible change [unit/s] and largest plausible reading [unit].
    max_rate: float = math.inf
    max_strain: float = math.inf
    # For fading in or out, and how long the gauge must have been well [s].
    fade_time: float = 0.1
    recovery: float = 0.5
    # Corner of the DC blocker while the reference moves; the same by default [Hz].
    moving_frequency: float | None = None
    scale: float = 1.0  # unit of the gauge per m/m

    def row(self, dt: float) -> FloatArray:
        """Give the settings in the order of the columns, for a step [s]."""
        return np.array([
            self.gain, 2.0 * math.pi * self.mean_frequency, np.rint(self.mean_window / dt),
            self.speed_limit, max(self.dead_time, 5.0 * dt), max(self.stale_time, 3.0 * dt),
            self.max_rate, self.max_strain, self.fade_time, self.recovery,
            2.0 * math.pi * (self.moving_frequency or self.mean_frequency)])


STRAIN_SCALE = {'um/m': 1e6, 'm/m': 1.0}
PLAUSIBLE_RATE = 0.2
"""Fastest plausible change of strain [1/s]: 2000 um/m at 16 Hz."""
PLAUSIBLE_STRAIN = 5e-3
"""Largest plausible strain: beyond the yield point of spring steel."""


def arm_damping(arm: Arm, *, share: float = 1.0) -> list[DamperSettings]:
    """Take the damper's settings from an arm description."""
    if arm.spec.damper is None:
        msg = f'{arm.source}: there is no damper; add damper: with the gains of its joints'
        raise ArmError(msg)
    gauges = {gauge.name: gauge for gauge in arm.gauges}
    limits = {joint.name: joint.limits for joint in arm.spec.joints}
    result = []
    for item in arm.spec.damper.joints:
        unit = gauges[item.gauge].unit
        if unit not in STRAIN_SCALE:
            msg = (f'{arm.source}: the gain of the damper is in rad/s per m/m, but gauge '
                   f'{item.gauge!r} has unit {unit}; expected one of {list(STRAIN_SCALE)}')
            raise ArmError(msg)
        scale, limit = STRAIN_SCALE[unit], limits[item.joint]
        result.append(DamperSettings(
            item.joint, item.gauge, -share * item.gain / scale, arm.spec.damper.mean_frequency,
            arm.spec.damper.mean_window or 0.0,
            (limit.velocity if limit else None) or math.inf, max_rate=PLAUSIBLE_RATE * scale,
            max_strain=PLAUSIBLE_STRAIN * scale,
            moving_frequency=arm.spec.damper.moving_frequency, scale=scale))
    return result


class Damper:
    """Damper of several joints, step by step: dt [s]."""

    def __init__(self, settings: list[DamperSettings], dt: float) -> None:
        self.joints = tuple(item.joint for item in settings)
        self.gauges = tuple(item.gauge for item in settings)
        self.settings = np.array([item.row(dt) for item in settings]).reshape(-1, SETTINGS)
        self._fixed = self.settings.copy()
        self._scale = np.array([item.scale for item in settings])
        window = int(self.settings[:, WINDOW].max(initial=1.0))
        self.past = np.zeros((len(settings), max(window, 1)))
        self.state = np.zeros((len(settings), STATES))
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget mean and faults; the damper fades in after the recovery time."""
        self.state[:] = 0.0
        self.state[:, STATUS] = float(Status.STARTING)

    def adapt(
        self, gain: FloatArray, mean_frequency: float, weight: float, shift: FloatArray,
    ) -> None:
        """
        Take scheduled gains in use, and let the means go along with the load.

        gain (joints,) [rad/s per m/m], mean_frequency [Hz], shift (joints,) [units of the gauges].
        """
        wanted = np.full((len(gain), 3), 2.0 * math.pi * mean_frequency)
        wanted[:, 0] = -gain / self._scale
        columns = [GAIN, CORNER, MOVING_CORNER]
        fixed = self._fixed[:, columns]
        self.settings[:, columns] = fixed + weight * (wanted - fixed)
        self.state[:, MEAN] += shift

    def release(self) -> None:
        """Take the gains of the settings in use."""
        self.settings[:] = self._fixed

    @property
    def status(self) -> tuple[Status, ...]:
        """Say what each joint's damper does."""
        return tuple(Status(int(value)) for value in self.state[:, STATUS])

    def report(self) -> list[str]:
        """Say in one sentence a joint what its damper does."""
        return [f'{joint} ({gauge}): {MEANING[status]}' for joint, gauge, status
                in zip(self.joints, self.gauges, self.status, strict=True)]

    def step(
        self, strain: ArrayLike, fresh: ArrayLike = True, saturated: ArrayLike = False,
        moving: float = 0.0,
    ) -> FloatArray:
        """
        Give the yielding speeds for one step.

        strain (joints,) [its unit], fresh, saturated (joints,); returns (joints,) [rad/s].
        """
        count = len(self.joints)
        values = np.broadcast_to(np.asarray(strain, dtype=float), count)
        new = np.broadcast_to(np.asarray(fresh, dtype=bool), count)
        limited = np.broadcast_to(np.asarray(saturated, dtype=bool), count)
        return np.array([
            damper_law(self.settings[j], self.state[j], self.past[j], self.dt, float(values[j]),
                       bool(new[j]), bool(limited[j]), moving) for j in range(count)])
