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
How a flexible tool moves when its flange does, in compiled functions.

The tool is a rod that bends like a spring at its foot alone, in one plane or two, with a mass at
its end: the pseudo-rigid-body model of a cantilever (Howell: Compliant Mechanisms, 2001, 5.1),
good to 0.5 % up to 64 degrees. Its state is how far the mass is from where it is when the rod is
straight, along x and y, and how fast: d, v. From the place r = c + x d0 + y d1 - z fall(d) follow
by differentiation all forces of its motion: Coriolis, centrifugal, Euler and gravity.

A tool is a row of numbers: c, x, y, z (3 each, in the flange), 1 / length, the squared frequencies
[1/s^2], the damping [1/s] of both planes, and 1 where it bends along y too. A motion has rows of
12: acceleration, angular acceleration, rate of rotation and gravity in the flange.
"""

from __future__ import annotations

import math

import numpy as np

from tudor_dynamics.compiled import compiled, unowned
from tudor_dynamics.typing import FloatArray

TOOL, MOTION, PLACES = 18, 12, 8
NUDGE = 1e-6  # of a state [m, m/s] and of a motion, for differences


@compiled
def accelerate(
    p: FloatArray, d: FloatArray, v: FloatArray, m: FloatArray, out: FloatArray,
) -> None:
    """Give d'' (2), acceleration less gravity of the mass and its place (6), by d, v (2)."""
    d0, d1, v0, v1, k = d[0], d[1], v[0], v[1], p[12]
    bent = min(k * k * (d0 * d0 + d1 * d1), 0.8)  # sine squared of the angle
    cosine = math.sqrt(1.0 - bent)
    slope = k / cosine
    fall = k * (d0 * d0 + d1 * d1) / (1.0 + cosine)
    outward = d0 * v0 + d1 * v1
    sink = slope * outward
    whirl = slope * (v0 * v0 + v1 * v1 + slope * slope * outward * outward)
    for i in range(3):
        out[5 + i] = p[i] + p[3 + i] * d0 + p[6 + i] * d1 - p[9 + i] * fall
    for i in range(3):
        j, n = (i + 1) % 3, (i + 2) % 3
        # by the rate of rotation, once more outside: w x (w x r + 2 r')
        fast_n = (m[6 + i] * out[5 + j] - m[6 + j] * out[5 + i]
                  + 2.0 * (p[3 + n] * v0 + p[6 + n] * v1 - p[9 + n] * sink))
        fast_j = (m[6 + n] * out[5 + i] - m[6 + i] * out[5 + n]
                  + 2.0 * (p[3 + j] * v0 + p[6 + j] * v1 - p[9 + j] * sink))
        out[2 + i] = (m[i] - m[9 + i] + m[3 + j] * out[5 + n] - m[3 + n] * out[5 + j]
                      + m[6 + j] * fast_n - m[6 + n] * fast_j - p[9 + i] * whirl)
    along = slope * (p[9] * out[2] + p[10] * out[3] + p[11] * out[4])
    # the angle over its sine, and its slope
    arc = 1.0 + bent * (1.0 / 6.0 + bent * (3.0 / 40.0 + bent * 5.0 / 112.0))
    rise = 1.0 / 6.0 + bent * (3.0 / 20.0 + bent * 15.0 / 112.0)
    spring = 2.0 * arc * rise * k * k * (p[13] * d0 * d0 + p[14] * d1 * d1)
    a0 = ((along - p[13] * arc * arc - spring) * d0 - p[15] * v0
          - p[3] * out[2] - p[4] * out[3] - p[5] * out[4])
    a1 = 0.0
    if p[17] > 0.0:
        a1 = ((along - p[14] * arc * arc - spring) * d1 - p[16] * v1
              - p[6] * out[2] - p[7] * out[3] - p[8] * out[4])
    turned = k * k * (d0 * a0 + d1 * a1)
    out[0], out[1] = a0 - d0 * turned, a1 - d1 * turned
    if p[17] == 0.0:
        out[1] = 0.0
    sink = slope * (d0 * out[0] + d1 * out[1])
    for i in range(3):
        out[2 + i] += p[3 + i] * out[0] + p[6 + i] * out[1] - p[9 + i] * sink


@compiled
def advance(
    p: FloatArray, step: float, state: FloatArray, m: FloatArray, after: FloatArray,
    room: FloatArray, found: FloatArray,
) -> None:
    """Go on by a step [s], from a motion to the one after it; a method of the fourth order."""
    d, v, mid, out = room[:2], room[2:4], room[4:16], room[16:24]
    for i in range(MOTION):
        mid[i] = 0.5 * (m[i] + after[i])
    for i in range(4):
        room[i] = found[i] = state[i]
    for stage in range(4):
        accelerate(p, d, v, m if stage == 0 else after if stage == 3 else mid, out)
        weight = step / (6.0 if stage in (0, 3) else 3.0)
        further = step if stage == 2 else 0.5 * step
        for i in range(2):
            found[i] += weight * v[i]
            found[2 + i] += weight * out[i]
            if stage < 3:
                room[i], room[2 + i] = state[i] + further * v[i], state[2 + i] + further * out[i]


@compiled
def settled(p: FloatArray, gravity: FloatArray) -> FloatArray:
    """Give the state (4,) in which a tool hangs under a gravity (3,)."""
    state, out, m = np.zeros(4), np.zeros(PLACES), np.zeros(MOTION)
    m[9:] = gravity
    for _ in range(60):
        accelerate(p, state[:2], state[2:], m, out)
        state[0] += 0.7 * out[0] / p[13]
        state[1] += 0.7 * out[1] / p[14]
    return state


@compiled
def _follow(
    p: FloatArray, steps: FloatArray, motion: FloatArray, states: FloatArray, room: FloatArray,
) -> None:
    p, steps, motion, states, room = unowned((p, steps, motion, states, room))
    for n in range(len(motion) - 1):
        advance(p, steps[n], states[n], motion[n], motion[n + 1], room, states[n + 1])


def follow(p: FloatArray, steps: FloatArray, motion: FloatArray, begin: FloatArray) -> FloatArray:
    """Give the states (samples, 4) along a motion (samples, 12), in steps [s], from a state."""
    states = np.vstack([begin, np.zeros((len(motion) - 1, 4))])
    _follow(p, steps, motion, states, np.zeros(24))
    return states


def from_rest(p: FloatArray, step: float, motion: FloatArray) -> FloatArray:
    """Give the states (samples, 4) along a motion (samples, 12) in even steps [s], from rest."""
    return follow(p, np.full(len(motion) - 1, step), motion, settled(p, motion[0, 9:]))


@compiled
def pulls(p: FloatArray, motion: FloatArray, states: FloatArray) -> FloatArray:
    """Give the pull of a mass of 1 kg on the flange: force and moment (samples, 6)."""
    found, out = np.zeros((len(states), 6)), np.zeros(PLACES)
    for n in range(len(states)):
        accelerate(p, states[n, :2], states[n, 2:], motion[n], out)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            found[n, i] = out[2 + i]
            found[n, 3 + i] = out[5 + j] * out[2 + k] - out[5 + k] * out[2 + j]
    return found


@compiled
def end_slopes(
    p: FloatArray, steps: FloatArray, motion: FloatArray, states: FloatArray, changes: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """
    Give what small changes do to the end of a motion.

    Those of the motion (ways, samples, 12) as (4, ways, samples), those of steps as (4, steps).
    """
    found, left = np.zeros((4, len(changes), len(motion))), np.eye(4)
    by_step = np.zeros((4, len(steps)))
    room, one, own = np.zeros(24), np.zeros(4), np.zeros((4, 4))
    for n in range(len(motion) - 2, -1, -1):
        for way in range(len(changes)):
            for k in range(2):
                pair = motion[n:n + 2].copy()
                pair[k] += NUDGE * changes[way, n + k]
                advance(p, steps[n], states[n], pair[0], pair[1], room, one)
                found[:, way, n + k] += left @ ((one - states[n + 1]) / NUDGE)
        advance(p, (1.0 + NUDGE) * steps[n], states[n], motion[n], motion[n + 1], room, one)
        by_step[:, n] = left @ ((one - states[n + 1]) / (NUDGE * steps[n]))
        for j in range(4):
            near = states[n].copy()
            near[j] += NUDGE
            advance(p, steps[n], near, motion[n], motion[n + 1], room, one)
            own[:, j] = (one - states[n + 1]) / NUDGE
        left = left @ own
    return found, by_step
