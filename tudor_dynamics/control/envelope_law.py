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

"""One step of the motion envelope of one joint, compiled: for hardware and simulation alike."""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

# Columns of the limits of one joint.
LOWER, UPPER = 0, 1  # position [rad]
SPEED = 2  # [rad/s]
ACCELERATION = 3  # [rad/s^2]
BRAKE = 4  # with which the joint stops before a position limit [rad/s^2]
TIME = 5  # for which it goes on as fast before that [s]
ROW = 6
# Columns of the state of one joint.
COMMAND = 0  # last command [rad/s]
CUT = 1  # what cut the last command: sum of the following
STATES = 2
BY_SPEED, BY_POSITION, BY_ACCELERATION = 1, 2, 4
SATURATING = BY_SPEED + BY_POSITION  # a command that only takes longer is none the less obeyed

COMMANDED = 0.93
"""Part of the speed limit that is commanded: the rest is for what drive and load make of it."""


@compiled
def approach_speed(way: float, acceleration: float, time: float) -> float:
    """
    Give the fastest speed towards a position limit from which the joint still stops before it.

    acceleration [rad/s^2], time [s]; way [rad]: below 0 beyond it; returns [rad/s], 0 beyond the
    limit.
    """
    if way <= 0.0:
        return 0.0
    if math.isinf(way) or math.isinf(acceleration):
        return math.inf if time == 0.0 else way / time
    reach = acceleration * time
    return math.sqrt(reach * reach + 2.0 * acceleration * way) - reach


@compiled
def envelope_law(row: NDArray, state: NDArray, dt: float, wanted: float, q: float) -> float:
    """
    Give the speed nearest to the wanted one that keeps a joint within its limits.

    row, state (ROW,), dt [s], wanted [rad/s], q [rad]; returns speed [rad/s].
    """
    limit = COMMANDED * row[SPEED]
    speed = min(max(wanted, -limit), limit)
    cut = 0
    if speed != wanted:
        cut += BY_SPEED
    bounded = min(max(speed, -approach_speed(q - row[LOWER], row[BRAKE], row[TIME])),
                  approach_speed(row[UPPER] - q, row[BRAKE], row[TIME]))
    if bounded != speed:
        cut += BY_POSITION
    speed = bounded
    if not math.isinf(row[ACCELERATION]):  # no time times no limit is no number
        change = row[ACCELERATION] * dt
        speed = min(max(bounded, state[COMMAND] - change), state[COMMAND] + change)
    if speed != bounded:
        cut += BY_ACCELERATION
    state[COMMAND], state[CUT] = speed, cut
    return speed
