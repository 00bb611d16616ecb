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
A planned move refined against a simulation of what swings behind it, by linear programmes in turn.

Where modes do not tell what an arm does, as with gears that cross their play on the way, a
simulation does. Around a move it is linear in small changes of the acceleration, by differences;
the least largest swing within the limits and within a distance in which that holds is a linear
programme; of some such distances the one that the simulation likes best is gone, and so on
(sequential linear programming; Nocedal and Wright, "Numerical optimization", 2006, ch. 18).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

from tudor_dynamics.signals.motion_profile import MotionLimits
from tudor_dynamics.signals.shaped_profile import (
    integrate, KNOTS, Profile, ROUNDING, speed_rows)
from tudor_dynamics.typing import FloatArray

STEPS = 10
"""Most linear programmes in turn."""
NUDGE = 0.01
"""Change of acceleration that differences are taken with, of its limit."""
FARTHEST = 0.3
"""Change of acceleration in which the simulation is taken for linear at first, of its limit."""
RADII = (1.0, 0.4, 0.12, 0.03)
"""Of that, tried side by side; half of the way to each as well."""
LITTLE = 0.985
"""A step that leaves more of the swing than this is the last one."""
SMALLEST = 1e-3
"""The same at least."""

Swings = Callable[[list[Profile]], FloatArray]
"""From moves of one length to what swings behind each, shape (n_moves, n_samples, n_channels),
each channel in a unit of its own in which 1 is nothing."""


def largest_swing(swings: FloatArray) -> FloatArray:
    """Give the largest half range of all channels: swings (..., samples, channels)."""
    return np.asarray(0.5 * np.ptp(swings, axis=-2).max(axis=-1))


def refine(profile: Profile, limits: MotionLimits, swings: Swings) -> Profile:
    """
    Refine a move until next to nothing swings behind it, or nothing more is to be had.

    Length and ends stay, no joint goes back, and limits hold as before.

    Returns the one given where none is better.
    """
    room = _Room(profile, limits)
    farthest = FARTHEST
    here = swings([profile])[0]
    left = float(largest_swing(here))
    for _ in range(STEPS):
        if left <= 1.0:
            break
        nudges = NUDGE * np.eye(room.size)
        slope = (swings([room.changed(row) for row in nudges]) - here) / NUDGE
        ways = [(radius, way) for radius in RADII
                if (way := room.step(here, slope, farthest * radius)) is not None]
        if not ways:
            break
        tried = [room.changed(share * way) for _, way in ways for share in (1.0, 0.5)]
        found = swings(tried)
        sizes = largest_swing(found)
        best = int(np.argmin(sizes))
        if sizes[best] >= left:
            break
        before, left, here = left, float(sizes[best]), found[best]
        room.profile = tried[best]
        farthest *= ways[best // 2][0] * (1.0 if best % 2 else 2.0)
        farthest = min(max(farthest, SMALLEST), FARTHEST)
        if left > LITTLE * before:
            break
    return room.profile


class _Room:
    """Changes of a move that keep its ends, and how far they may go."""

    def __init__(self, profile: Profile, limits: MotionLimits) -> None:
        self.profile = profile
        self._way = profile.q[-1] - profile.q[0]
        self._joints = np.flatnonzero(np.abs(self._way) > 1e-9)
        # second differences of hats begin and end at rest at the same places
        inner = KNOTS - 1
        change = np.zeros((inner, inner - 2))
        for k in range(inner - 2):
            change[k:k + 3, k] = 0.5, -1.0, 0.5
        self._most = limits.acceleration * ROUNDING
        self._fastest = limits.velocity * ROUNDING
        self._change = change
        self.size = len(self._joints) * change.shape[1]

    def changed(self, way: FloatArray) -> Profile:
        """Give the move with so much of each change."""
        ddq = self.profile.ddq.copy()
        ddq[1:-1, self._joints] += self._change @ way.reshape(len(self._joints), -1).T * (
            self._most[self._joints])
        return integrate(self.profile.q[0], self.profile.q[-1], ddq, self.profile.step)

    def step(self, here: FloatArray, slope: FloatArray, farthest: float) -> FloatArray | None:
        """Find the change that leaves least by the slopes, (size, n_samples, n_channels)."""
        samples, channels = here.shape
        middles = np.kron(np.eye(channels), np.ones((samples, 1)))
        rows = np.hstack([slope.transpose(2, 1, 0).reshape(-1, self.size), -middles])
        value = here.T.ravel()
        most = -np.ones((len(value), 1))
        bound = [np.hstack([side * rows, most]) for side in (1.0, -1.0)]
        right = [-value, value]
        speed = speed_rows(self.profile.step)
        count = self._change.shape[1]
        for n, j in enumerate(self._joints):
            ddq = self.profile.ddq[1:-1, j]
            sign = np.sign(self._way[j])
            for table, now, low, high in (
                    (self._change, ddq / self._most[j], -1.0, 1.0),
                    (self._change, 0.0 * ddq, -farthest, farthest),
                    (sign * speed @ self._change * (self._most[j] / self._fastest[j]),
                     sign * speed @ ddq / self._fastest[j], 0.0, 1.0)):
                block = np.zeros((len(table), self.size + channels + 1))
                block[:, n * count:(n + 1) * count] = table
                bound += [block, -block]
                right += [np.maximum(high - now, 0.0), np.maximum(now - low, 0.0)]
        cost = np.zeros(self.size + channels + 1)
        cost[-1] = 1.0
        answer = linprog(cost, csr_matrix(np.vstack(bound)), np.concatenate(right),
                         bounds=(None, None), method='highs')
        if answer.x is None or answer.status != 0:
            return None
        return np.asarray(answer.x[:self.size])
