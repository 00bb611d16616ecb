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

"""Encoders that cannot be believed, told from slow joints, noise and late answers."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.motion_controller import EncoderWatch

LIMITS = Limits(np.array([0.0, -1.0]), np.array([3.0, 1.0]), np.full(2, 1.8), np.full(2, 17.0))
COUNT = 2.0e-4
"""Step of a coarse encoder [rad]."""


@settings(max_examples=40, deadline=None)
@given(st.floats(-1.8, 1.8), st.sampled_from([0.001, 0.002, 0.01]), st.floats(0.1, 5.0))
def test_honest_encoders_are_believed(size: float, dt: float, frequency: float) -> None:
    """Motion as commanded, in counts, from crawling to the speed limit: no doubt."""
    watch = EncoderWatch(LIMITS)
    t = np.arange(0.0, 2.0, dt)
    speed = size * np.sin(2 * np.pi * frequency * t)
    q = 1.5 + np.cumsum(speed) * dt * min(1.0, 2.0 * frequency / max(abs(size), 1e-9))
    speed = np.gradient(q, dt)
    q = np.clip(q, 0.05, 2.95)
    for k in range(1, len(t)):
        reading = np.array([COUNT * np.floor(q[k] / COUNT), 0.0])
        commanded = np.array([(q[k] - q[k - 1]) / dt, 0.0])
        assert watch.step(dt, reading, commanded) == []


def test_frozen_jumping_and_impossible() -> None:
    """Each is told with its joint; a standstill that nobody asked to end is none."""
    watch = EncoderWatch(LIMITS)
    for _ in range(1000):
        assert watch.step(0.002, np.array([1.0, 0.5]), np.zeros(2)) == []
    found: list[tuple[int, str]] = []
    steps = 0
    while not found:
        steps += 1
        found = watch.step(0.002, np.array([1.0, 0.5]), np.array([0.0, 1.2]))
    assert found[0][0] == 1 and 'frozen' in found[0][1]
    assert 1.2 * 0.002 * steps < 1.8 * 0.02
    watch.reset()
    assert watch.step(0.002, np.array([1.0, 0.5]), np.zeros(2)) == []
    jumped = watch.step(0.002, np.array([1.2, 0.5]), np.zeros(2))
    assert jumped[0][0] == 0 and 'jumped by 0.2' in jumped[0][1]
    watch.reset()
    outside = watch.step(0.002, np.array([1.0, 2.0]), np.zeros(2))
    assert outside[0][0] == 1 and 'no pose' in outside[0][1]


def test_what_a_jump_takes_away_is_owed() -> None:
    """The joint went on as it was told to, whatever the encoder makes of it, until a reset."""
    watch, speed = EncoderWatch(LIMITS), np.array([0.5, 0.0])
    q = np.array([1.0, 0.2])
    for k in range(5):
        assert watch.step(0.01, q + k * 0.01 * speed, speed) == []
    there = q + 5 * 0.01 * speed
    away = np.array([0.6, 0.0])
    assert watch.step(0.01, there + away, speed)
    assert watch.owed == pytest.approx(-away)
    watch.step(0.01, there + away + 0.01 * speed, speed)
    assert watch.owed[0] == pytest.approx(-away[0])
    watch.reset()
    assert not watch.owed.any()
