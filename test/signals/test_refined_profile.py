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

"""Refining of moves: less swings after them in the simulation, all else stays as it was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from tudor_dynamics.arm.limits import unlimited
from tudor_dynamics.signals.shaping import (
    largest_oscillation, PathModes, plan_shaped, Profile, refine)

LIMITS = replace(unlimited(2), velocity=np.full(2, 1.2), acceleration=np.full(2, 3.5))
START, TARGET = np.array([0.5, 0.3]), np.array([1.6, -0.2])
STEP, BEHIND = 5e-3, 0.4


def along(path: np.ndarray) -> PathModes:
    """Give what is known: one mode of 2.5 Hz."""
    n = len(path)
    return PathModes(np.full((n, 1), 5.0 * np.pi), np.zeros((n, 1)),
                     np.tile([1.0, 0.4], (n, 1, 1)), np.ones(1))


def swings(moves: list[Profile], unit: float = 2e-4) -> np.ndarray:
    """Simulate what is not known: a spring that is soft about its middle, as one with play."""
    t = np.arange(0.0, moves[0].duration + BEHIND, STEP)
    drive = np.array([move.at(t)[2] for move in moves]) @ np.array([1.0, 0.4])
    y, dy = np.zeros(len(moves)), np.zeros(len(moves))
    seen = []
    for push in drive.T:
        for _ in range(4):
            spring = (5.0 * np.pi)**2 * (y - 0.008 * np.tanh(y / 0.01))
            dy = dy + 0.25 * STEP * (push - spring)
            y = y + 0.25 * STEP * dy
        seen.append(y)
    return np.array(seen).T[:, t > moves[0].duration, None] / unit


def planned() -> Profile:
    """Plan by what is known."""
    return plan_shaped(START, TARGET, LIMITS, along)


def test_less_swings_and_all_else_stays() -> None:
    """A tenth of the swing is left; ends, length and limits are those of before."""
    before = planned()
    after = refine(before, LIMITS, swings)
    left = [float(largest_oscillation(swings([move]))[0]) for move in (before, after)]
    assert left[0] > 20.0 and left[1] < 0.1 * left[0]
    assert after.duration == before.duration
    t = np.linspace(0.0, after.duration, 2001)
    q, dq, ddq = after.at(t)
    np.testing.assert_allclose(q[[0, -1]], [START, TARGET], atol=1e-9)
    np.testing.assert_allclose(dq[[0, -1]], 0.0, atol=1e-9)
    assert np.all(np.abs(dq) <= LIMITS.velocity * (1.0 + 1e-3))
    assert np.all(np.abs(ddq) <= LIMITS.acceleration * (1.0 + 1e-6))
    assert np.all(dq * np.sign(TARGET - START) >= -1e-3)


@pytest.mark.parametrize('what', [
    lambda moves: swings(moves, 1e3), lambda moves: np.full((len(moves), 50, 1), 1.0)])
def test_nothing_to_be_refined(what: Callable[[list[Profile]], np.ndarray]) -> None:
    """A swing that is none, or none at all: the same move."""
    before = planned()
    assert refine(before, LIMITS, what) is before


def test_joint_that_stays_does_not_move() -> None:
    """Only joints that have a way are changed."""
    before = plan_shaped(START, np.array([1.6, 0.3]), LIMITS, along)
    after = refine(before, LIMITS, swings)
    assert np.all(after.q[:, 1] == 0.3) and after is not before


def test_what_no_change_mends_is_left() -> None:
    """A simulation that gets worse with every change gives the move back."""
    before = planned()

    def worse(moves: list[Profile]) -> np.ndarray:
        size = [3.0 + float(np.abs(move.ddq - before.ddq).sum()) for move in moves]
        return np.array(size)[:, None, None] * np.array([0.0, 2.0])[None, :, None]
    assert refine(before, LIMITS, worse) is before
