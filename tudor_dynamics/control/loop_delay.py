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

"""Delay of the loop, measured: commands against the motion that answers them."""

from __future__ import annotations

import numpy as np

from tudor_dynamics.typing import FloatArray

LONGEST = 0.25
"""Longest delay that is looked for [s]."""
STEP = 0.002
"""Between two delays that are tried [s]."""
MEMORY = 2.0
"""Time of motion after which what was seen counts 1/e [s]."""
ENOUGH = 0.2
"""Time of motion needed before a delay is told [s]."""
CLEAR = 0.35
"""At the best delay, commands leave at most this part of the motion's energy unexplained."""
MOVING = 0.02
"""Part of the speed limit above which a joint moves."""


class DelayMeter:
    """
    Measures the time from a command until the readings answer it, with all that lies between.

    That is the whole way round as the damper feels it: command, drive, sensor, messages. For each
    of many delays it keeps, with forgetting, how much of the measured speeds the commands of that
    time ago leave unexplained; the least tells the delay. Times are those of the samples' stamps,
    to which commands are the answers: no other clock is needed.

    speed (joints,) [rad/s].
    """

    def __init__(self, speed: FloatArray) -> None:
        self._scale = np.where(np.isfinite(speed), speed, 1.0)
        self._lags = np.arange(0.0, LONGEST, STEP)
        self._errors = np.zeros(len(self._lags))
        self._energy = self._time = 0.0
        self._told: float | None = None
        self._at = np.zeros(512)
        self._commands = np.zeros((512, len(speed)))
        self._way = np.zeros((512, len(speed)))  # that the commands before have made
        self._count = 0

    def reset(self) -> None:
        """Forget commands, but not the delay."""
        self._count = 0

    def add_command(self, now: float, command: FloatArray) -> None:
        """
        Take a command [rad/s] into account, the answer to the sample of a time [s].

        command (joints,) [rad/s].
        """
        if self._count == len(self._at):
            keep = max(int(np.searchsorted(self._at, now - 2.0 * LONGEST)), self._count // 4)
            rest = self._count - keep
            for kept in (self._at, self._commands, self._way):
                kept[:rest] = kept[keep:]
            self._count = rest
        k = self._count
        self._way[k] = 0.0 if k == 0 else (
            self._way[k - 1] + (now - self._at[k - 1]) * self._commands[k - 1])
        self._at[k], self._commands[k] = now, command
        self._count += 1

    def commanded(self, now: float, lag: float) -> FloatArray:
        """Give the command in force a time [s] before now; nothing before the first [rad/s]."""
        place = int(np.searchsorted(self._at[:self._count], now - lag, 'right')) - 1
        return self._commands[place] if place >= 0 else np.zeros(len(self._scale))

    def add_motion(self, now: float, dt: float, dq: FloatArray) -> None:
        """Take measured speeds into account: now, dt [s], dq (joints,) [rad/s]."""
        dq = dq / self._scale
        if np.abs(dq).max(initial=0.0) < MOVING or self._count == 0 or (
                self._at[0] > now - LONGEST):
            return
        means = (self._made(now - self._lags) - self._made(now - dt - self._lags)) / dt
        off = means / self._scale - dq
        kept = np.exp(-dt / MEMORY)
        self._errors *= kept
        self._errors += dt * np.einsum('ij,ij->i', off, off)
        self._energy = kept * self._energy + dt * float(dq @ dq)
        self._time = kept * self._time + dt

    def _made(self, times: FloatArray) -> FloatArray:
        """Give the way that commands, each held until the next, have made by some times [rad]."""
        places = np.maximum(np.searchsorted(self._at[:self._count], times, 'right') - 1, 0)
        since = (times - self._at[places])[:, np.newaxis]
        return np.asarray(self._way[places] + since * self._commands[places])

    @property
    def delay(self) -> float | None:
        """Delay of the loop, the last that could be told [s]; None before the first."""
        best = int(np.argmin(self._errors))
        if self._time < ENOUGH or self._errors[best] > CLEAR * self._energy:
            return self._told
        self._told = float(self._lags[best])
        if 0 < best < len(self._lags) - 1:
            before, at, after = self._errors[best - 1:best + 2]
            bend = before - 2.0 * at + after
            self._told += STEP * 0.5 * (before - after) / bend if bend > 0.0 else 0.0
        return self._told
