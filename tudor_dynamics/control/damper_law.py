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

"""One step of the damper of one joint, compiled: for hardware and for simulation alike."""

from __future__ import annotations

import math

from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

# Columns of the settings of one joint.
GAIN = 0  # speed per strain, with its sign [rad/s per unit of the gauge]
CORNER = 1  # angular corner frequency of the DC blocker [rad/s]
WINDOW = 2  # samples of the moving average, 0 for the DC blocker
SPEED_LIMIT = 3  # [rad/s]
DEAD_TIME = 4  # without any change of the reading [s]
STALE_TIME = 5  # without any reading [s]
MAX_RATE = 6  # fastest plausible change [unit/s]
MAX_STRAIN = 7  # largest plausible reading [unit]
FADE_TIME = 8  # [s]
RECOVERY = 9  # the gauge must be well for so long [s]
MOVING_CORNER = 10  # takes the place of CORNER while the reference moves [rad/s]
SETTINGS = 11
# Columns of the state of one joint.
MEAN, LAST, UNCHANGED, AGE, WELL, WEIGHT, GOOD, STATUS, SUM, COUNT, HEAD, SEEN = range(12)
STATES = 12


MOVES = 0.1
"""Part of the planned speed at which a reference counts as moving in full."""


@compiled
def moving_share(dq_ref: float, planned: float) -> float:
    """Give how much a reference moves, from 0 at rest to 1; its speeds in [rad/s]."""
    return min(abs(dq_ref) / (MOVES * planned), 1.0)


@compiled
def damper_law(
    settings: NDArray, state: NDArray, past: NDArray, dt: float, strain: float, fresh: bool,
    saturated: bool, moving: float,
) -> float:
    """
    Give the yielding speed of one joint.

    settings, state (SETTINGS,), past (window,), dt [s]; returns speed [rad/s].
    """
    state[AGE] += dt
    state[UNCHANGED] += dt
    fault = 0
    if fresh:
        if not math.isfinite(strain):
            fault = 3
        elif abs(strain) > settings[MAX_STRAIN] or (
                state[SEEN] > 0.0
                and abs(strain - state[LAST]) > settings[MAX_RATE] * state[AGE]):
            fault = 6
        if fault != 3:
            if strain != state[LAST] or state[SEEN] == 0.0:
                state[UNCHANGED] = 0.0
            state[LAST], state[SEEN] = strain, 1.0
    elif state[AGE] > settings[STALE_TIME]:
        fault = 4
    elif state[SEEN] == 0.0:
        fault = 3
    elif state[STATUS] >= 3.0:
        fault = int(state[STATUS])
    if fault == 0 and state[UNCHANGED] > settings[DEAD_TIME]:
        fault = 5
    if fault > 0:
        state[WELL] = 0.0
        state[COUNT], state[SUM], state[HEAD] = 0.0, 0.0, 0.0
        if fresh:
            state[AGE] = 0.0
    elif fresh:
        if state[WELL] == 0.0:
            state[MEAN] = strain
        # Soon after the start the mean is that of what was seen, later that of the DC blocker.
        corner = settings[CORNER] + moving * (settings[MOVING_CORNER] - settings[CORNER])
        share = 1.0 - math.exp(-corner * state[AGE])
        state[WELL] += state[AGE]
        if state[WELL] < settings[RECOVERY]:
            share = max(share, state[AGE] / state[WELL])
        window = int(settings[WINDOW])
        if window == 0:
            state[MEAN] += share * (strain - state[MEAN])
        else:
            head = int(state[HEAD])
            if state[COUNT] >= window:
                state[SUM] -= past[head]
            else:
                state[COUNT] += 1.0
            past[head] = strain
            state[SUM] += strain
            state[HEAD] = (head + 1) % window
            state[MEAN] = state[SUM] / state[COUNT]
        state[GOOD] = strain - state[MEAN]
        state[AGE] = 0.0
    if fault > 0:
        status = fault
    elif state[WELL] < settings[RECOVERY]:
        status = 1
    else:
        status = 2 if saturated else 0
    state[STATUS] = status
    change = dt / settings[FADE_TIME]
    if status == 0:
        state[WEIGHT] = min(state[WEIGHT] + change, 1.0)
    else:
        state[WEIGHT] = max(state[WEIGHT] - change, 0.0)
    # A reading that stands still is trusted less and less before the gauge counts as dead.
    trust = min(max(2.0 - 2.0 * state[UNCHANGED] / settings[DEAD_TIME], 0.0), 1.0)
    speed = state[WEIGHT] * trust * settings[GAIN] * state[GOOD]
    limit = settings[SPEED_LIMIT]
    return min(max(speed, -limit), limit)
