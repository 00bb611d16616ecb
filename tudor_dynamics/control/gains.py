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
Gains of damper and position loop: what the measured delay allows, and when the damper is off.

The delay is measured by commands of the last half second, and the way that they have made.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.schema import DamperSpec
from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.control.cascade import velocity_lag
from tudor_dynamics.typing import FloatArray


@compiled
def way_at(at: NDArray, way: NDArray, commands: NDArray, count: int, j: int, time: float) -> float:
    """Give the way that the commands of a joint, each held until the next, have made [rad]."""
    k = count - 1
    while k >= 0 and at[k] > time:
        k -= 1
    return way[0, j] if k < 0 else way[k, j] + (time - at[k]) * commands[k, j]


class Commanded:
    """Commands by a clock, each held until the next."""

    def __init__(self, joints: int) -> None:
        self.at = np.zeros(512)  # since when each is in force [s]
        self.commands = np.zeros((512, joints))
        self.way = np.zeros((512, joints))  # made by the commands before [rad]
        self.count = 0  # how many of them are in use

    def add(self, now: float, command: FloatArray) -> None:
        """Take a command in force from now on: command (joints,) [rad/s]."""
        if self.count == len(self.at):
            first = int(np.searchsorted(self.at, now - 2.0 * settings.DELAY_LONGEST))
            keep = max(first, self.count // 4)
            rest = self.count - keep
            for kept in (self.at, self.commands, self.way):
                kept[:rest] = kept[keep:]
            self.count = rest
        k = self.count
        if k:  # a sample can be earlier than what was commanded while it did not come
            now = max(now, self.at[k - 1])
        self.way[k] = 0.0 if k == 0 else (
            self.way[k - 1] + (now - self.at[k - 1]) * self.commands[k - 1])
        self.at[k], self.commands[k] = now, command
        self.count += 1

    def made(self, times: FloatArray) -> FloatArray:
        """Give the way made by some times, (times, joints) [rad]."""
        places = np.maximum(np.searchsorted(self.at[:self.count], times, 'right') - 1, 0)
        since = (times - self.at[places])[:, np.newaxis]
        return np.asarray(self.way[places] + since * self.commands[places])


class DelayMeter:
    """
    Measures the time from a command until the readings answer it, with all that lies between.

    That is the whole loop as the damper has it: command, drive, sensor, messages. For each of many
    delays it keeps, with forgetting, how much of the measured speeds the commands of that time ago
    leave unexplained; the least is at the delay. Times are those of the samples' stamps, to which
    commands are the answers: no other clock is needed.
    """

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)  # speed: that joints may have
        self._lags = np.arange(0.0, settings.DELAY_LONGEST, settings.DELAY_STEP)
        self._errors = np.zeros(len(self._lags))
        self._energy = self._time = 0.0
        # Delay of the loop, the last that could be estimated [s]; None before the first.
        self.delay: float | None = None
        self.commands = Commanded(len(speed))

    def add_motion(self, now: float, dt: float, dq: FloatArray) -> None:
        """Take measured speeds into account: now, dt [s], dq (joints,) [rad/s]."""
        dq = dq / self._scale
        commands = self.commands
        if np.abs(dq).max(initial=0.0) < settings.DELAY_MOVING or commands.count == 0 or (
                commands.at[0] > now - settings.DELAY_LONGEST):
            return
        means = (commands.made(now - self._lags) - commands.made(now - dt - self._lags)) / dt
        off = means / self._scale - dq
        kept = np.exp(-dt / settings.DELAY_MEMORY)
        self._errors *= kept
        self._errors += dt * np.einsum('ij,ij->i', off, off)
        self._energy = kept * self._energy + dt * float(dq @ dq)
        self._time = kept * self._time + dt
        best = int(self._errors.argmin())
        if (self._time < settings.DELAY_MOTION
                or self._errors[best] > settings.DELAY_CLEAR * self._energy):
            return
        self.delay = float(self._lags[best])
        if 0 < best < len(self._lags) - 1:
            before, at, after = self._errors[best - 1:best + 2]
            bend = before - 2.0 * at + after
            if bend > 0.0:
                self.delay += settings.DELAY_STEP * 0.5 * float((before - after) / bend)


def damping_share(delay: float, full: float) -> float:
    """Give the part of the damper's gain that a delay allows: delay, full [s]."""
    ratio = delay / full
    if ratio <= 1.0:
        return 1.0
    faded = (settings.DELAY_GONE - ratio) / (settings.DELAY_GONE - settings.DELAY_FADES)
    return ratio**-settings.DELAY_SLOPE * min(max(faded, 0.0), 1.0)


def position_gain_limit(delay: float) -> float:
    """Give the largest position gain [1/s] for a delay of the loop, drives included [s]."""
    return settings.DELAY_PHASE / max(delay, 1e-3)


class RingingWatch:
    """Judges what the position loop and the damper add to the reference."""

    # While the reference rests, what they add must decay: an oscillation that keeps its size, or
    # grows, is fed by them. Whether it rests or not, commands beyond the speed limit again and
    # again, or far from the reference, are no damping either.

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)  # speed: that joints may have
        self._peaks: deque[float] = deque(maxlen=settings.RINGING_LASTS + 2)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._peaks.clear()
        self._rest = self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = 0

    def step(self, dt: float, added: FloatArray, moving: bool, cut: bool) -> str:
        """Judge what was added in one command, (joints,); empty for nothing."""
        self._rest = 0.0 if moving else self._rest + dt
        self._elapsed += dt
        size = float(np.max(np.abs(added) / self._scale, initial=0.0))
        self._wild += dt if cut or size > settings.WILD_COMMAND else 0.0
        self._peak = max(self._peak, size)
        if self._elapsed < settings.RINGING_WINDOW:
            return ''
        share, peak = self._wild / self._elapsed, self._peak
        self._elapsed = self._peak = self._wild = 0.0
        self._wild_windows = self._wild_windows + 1 if share > settings.WILD_SHARE else 0
        if self._rest < settings.RINGING_SETTLING:
            self._peaks.clear()
        else:
            self._peaks.append(peak)
        if self._wild_windows >= settings.WILD_WINDOWS:
            self.reset()
            return 'commands are often at the speed limit, or far from the reference speed'
        peaks = list(self._peaks)
        grown = [now > settings.RINGING_GROWTH * before
                 for before, now in zip(peaks, peaks[1:], strict=False)]
        # all four are loud: a push, or its end, in the middle of a window grows into the next
        if len(grown) > 2 and min(peaks[-4:]) > settings.RINGING_LOUD and all(grown[-3:]):
            self.reset()
            return 'an oscillation grows while the reference is at rest'
        if len(peaks) == settings.RINGING_LASTS + 2 and all(
                now > settings.RINGING_LOUD and now > settings.RINGING_DECAY * before
                for before, now in zip(peaks[:-2], peaks[2:], strict=True)):
            self.reset()
            return 'an oscillation does not decay while the reference is at rest'
        return ''


def learned_period(period: float, dt: float) -> float:
    """Learn the time between samples [s]; long ones lack some, so short ones count more."""
    share = period if dt > period else min(settings.PERIOD_QUICK * period, 1.0)
    return period + share * (min(dt, 2.0 * period) - period)


class LoopGains:
    """Gains of damper and position loop in use, by what was measured of the loop."""

    def __init__(self, spec: DamperSpec, speed: FloatArray, share: float = 1.0) -> None:
        self.described = self._basis = spec.position_gain
        self.asked = 0.0  # speed per position error, 0 for that of description or schedule [1/s]
        self.described_delay = self.full_delay = spec.full_delay  # [s]
        self.share = self.weight = share
        self.delay = DelayMeter(speed)
        self.adapts = True
        self.excited = ''  # why the damper is off; empty if it is not
        self.period = self._clock = 0.0  # between samples, and by their stamps [s]
        self.late = 0.0  # by which samples come later than usual [s]
        self._ringing = RingingWatch(speed)
        self._lag = velocity_lag(spec)
        self._shortest = settings.DELAY_LONGEST
        self._longest = settings.CAREFUL_DELAY + self._lag

    def reset(self) -> None:
        """Try the damper again."""
        self.excited = ''
        self.begin()

    def begin(self, speed: FloatArray | None = None) -> None:
        """Take the next sample for a first one, of an arm at a known speed [rad/s]."""
        self._ringing.reset()
        self.delay.commands.count = 0
        if speed is not None:
            self.delay.commands.add(self._clock - settings.DELAY_LONGEST, speed)

    @property
    def position_gain(self) -> float:
        """Speed per position error that is asked for [1/s]."""
        return self.asked if self.asked > 0.0 else self._basis

    def adapt(self, position_gain: float, full_delay: float, weight: float) -> None:
        """Take scheduled values in use: position_gain [1/s], full_delay [s]."""
        self._basis = self.described + weight * (position_gain - self.described)
        self.full_delay = self.described_delay + weight * (full_delay - self.described_delay)

    @property
    def assumed_delay(self) -> float:
        """Delay of the loop, assumed where it was not measured yet [s]."""
        delay = self.delay.delay
        return settings.UNKNOWN_DELAY if delay is None else delay

    @property
    def allowed_share(self) -> float:
        """Part of what is asked for that the loop allows, 0 to 1."""
        if not self.adapts:
            return 1.0
        if self.excited:
            return 0.0
        delay = self.delay.delay
        return 1.0 if delay is None else damping_share(delay + self.late, self.full_delay)

    @property
    def response_time(self) -> float:
        """Longest time from a command to the motion [s]."""
        delay = self.delay.delay
        return (settings.CAREFUL_DELAY if delay is None else delay) + self._lag + self.period

    @property
    def lags(self) -> tuple[float, float]:
        """Shortest and longest time from a command to its motion, by what is known [s]."""
        return max(self._shortest - settings.LAG_MARGIN, 0.0), self._longest

    def _learn_lags(self, dt: float, delay: float | None) -> None:
        """Take a measured delay into account: loads, and what lies, make it longer than it is."""
        if delay is None:
            self._shortest = 0.0
            self._longest = settings.CAREFUL_DELAY + self._lag + self.period
            return
        self._shortest = min(self._shortest or delay, delay)
        self._longest = min(delay + settings.LAG_MARGIN, self._longest + settings.LAG_RISE * dt)

    @property
    def position_gain_in_use(self) -> float:
        """Speed per position error that the loop allows [1/s]."""
        gain = self.described if self.excited else self.position_gain
        return min(gain, position_gain_limit(
            self.assumed_delay + self._lag + self.period + self.late))

    def sampled(self, dt: float) -> tuple[float, float]:
        """Take a sample: give the clock, and the delay of the loop [s]."""
        self.period = learned_period(self.period, dt)
        self._clock += dt  # stamps alone: a simulated arm may be slower than this machine
        self._learn_lags(dt, self.delay.delay)
        return self._clock, self.assumed_delay

    def step(self, dt: float, dq: FloatArray) -> tuple[float, float]:
        """Measure the delay; give the damper's share and the position gain [1/s] in force."""
        self.delay.add_motion(self._clock, dt, dq)
        change = dt / settings.SHARE_RAMP_TIME
        share = min(self.share, settings.LARGEST_SHARE) * self.allowed_share
        self.weight += min(max(share - self.weight, -change), change)
        return self.weight, self.position_gain_in_use

    def took(self, waited: float, command: FloatArray) -> None:
        """Take a command [rad/s] that was given a time after the last sample [s]."""
        self.delay.commands.add(self._clock + self.late + waited, command)

    def commanded(
        self, dt: float, command: FloatArray, added: FloatArray, moving: bool, cut: bool,
    ) -> float:
        """Judge what was added, see `RingingWatch`; give the longest time to the motion [s]."""
        self.excited = self._ringing.step(dt, added, moving, cut) or self.excited
        self.delay.commands.add(self._clock + self.late, command)
        return self.response_time
