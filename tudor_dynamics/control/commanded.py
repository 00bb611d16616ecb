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

"""Commands of the last half second, and the way that they have made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled
from tudor_dynamics.control import settings
from tudor_dynamics.typing import FloatArray


@compiled
def way_at(at: NDArray, way: NDArray, commands: NDArray, count: int, j: int, time: float) -> float:
    """Give the way that the commands of a joint, each held until the next, have made [rad]."""
    k = count - 1
    while k >= 0 and at[k] > time:
        k -= 1
    return way[0, j] if k < 0 else way[k, j] + (time - at[k]) * commands[k, j]


class Commanded:
    """
    Commands by a clock [s], each held until the next.

    at (kept,) [s], commands, way (kept, joints) [rad/s, rad]: way made by the commands before;
    count: how many of them are in use.
    """

    def __init__(self, joints: int) -> None:
        self.at = np.zeros(512)
        self.commands = np.zeros((512, joints))
        self.way = np.zeros((512, joints))
        self.count = 0

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
