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

"""Motion envelope: whatever is wanted, no joint leaves its limits."""

from __future__ import annotations

import math

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.limits import DriveStop, Limits, unlimited
from tudor_dynamics.control.cascade import (
    approach_speed, BY_ACCELERATION, BY_POSITION, BY_SPEED, Envelope, SATURATING)
from tudor_dynamics.control.settings import BRAKING_SHARE, COMMANDED_SPEED, POSITION_MARGIN

LIMITS = Limits(np.array([-1.0]), np.array([2.0]), np.array([1.5]), np.array([10.0]))
numbers = st.floats(-50.0, 50.0)


def test_approach_speed_by_hand() -> None:
    """The way left is v lag + v^2 / (2 a); without lag v = sqrt(2 a d)."""
    assert approach_speed(0.3, 6.0, 0.0) == pytest.approx(math.sqrt(2.0 * 6.0 * 0.3))
    v = approach_speed(0.3, 6.0, 0.05)
    assert v * 0.05 + v * v / 12.0 == pytest.approx(0.3)
    assert approach_speed(-0.1, 6.0, 0.05) == approach_speed(0.0, 6.0, 0.0) == 0.0
    assert approach_speed(math.inf, 6.0, 0.05) == math.inf
    assert approach_speed(0.1, math.inf, 0.05) == pytest.approx(2.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=1, max_size=60), st.floats(-0.9, 1.9),
       st.sampled_from([0.0005, 0.002, 0.01]), st.floats(0.0, 0.04))
def test_no_wish_leaves_the_limits(
    wishes: list[float], start: float, dt: float, lag: float,
) -> None:
    """A joint that answers after the lag stays within position, speed and acceleration."""
    envelope = Envelope(LIMITS, lag + 2.0 * dt)
    q, before = start, 0.0
    late = [0.0] * round(lag / dt)
    for wish in wishes:
        for _ in range(max(round(0.03 / dt), 1)):
            command = float(envelope.step(dt, [wish], [q])[0])
            assert abs(command) <= 1.5
            assert abs(command - before) <= 10.0 * dt + 1e-12
            before = command
            late.append(command)
            q += dt * late.pop(0)
            assert -1.0 <= q <= 2.0


@settings(max_examples=60, deadline=None)
@given(st.lists(numbers, min_size=1, max_size=40), st.floats(-0.9, 1.9),
       st.sampled_from([0.002, 0.01]), st.floats(0.0, 0.04), st.floats(0.0, 0.2),
       st.floats(1.0, 10.0))
def test_a_drive_left_alone_stops_within_the_limits(
    wishes: list[float], start: float, dt: float, lag: float, timeout: float, braking: float,
) -> None:
    """Whenever commands end, the joint that brakes by itself stands before the limit."""
    envelope = Envelope(LIMITS, lag + 2.0 * dt, DriveStop(timeout, np.array([braking])))
    q, late = start, [0.0] * round(lag / dt)
    for wish in wishes:
        for _ in range(round(0.03 / dt)):
            late.append(float(envelope.step(dt, [wish], [q])[0]))
            q += dt * late.pop(0)
        alone = q + dt * sum(late)
        speed = float(envelope.command[0])
        alone += speed * timeout + 0.5 * speed * abs(speed) / braking
        assert -1.0 <= alone <= 2.0


def test_says_what_it_cut() -> None:
    """Each limit is told by itself, and only what is not obeyed at all counts as saturation."""
    envelope = Envelope(LIMITS, 0.0)
    assert envelope.step(0.01, [0.05], [0.0]) == pytest.approx([0.05])
    assert envelope.cuts[0] == 0
    assert envelope.step(0.01, [1.0], [0.0]) == pytest.approx([0.15])
    assert envelope.cuts[0] == BY_ACCELERATION and not envelope.cuts[0] & SATURATING
    assert envelope.step(0.5, [9.0], [0.0]) == pytest.approx([COMMANDED_SPEED * 1.5])
    assert envelope.cuts[0] == BY_SPEED and envelope.cuts[0] & SATURATING
    near = envelope.step(0.5, [1.0], [1.99])
    way = 0.01 - POSITION_MARGIN * 1.5
    assert near == pytest.approx([math.sqrt(2.0 * BRAKING_SHARE * 10.0 * way)])
    assert envelope.cuts[0] == BY_POSITION and envelope.cuts[0] & SATURATING


def test_outside_only_the_way_back_is_open() -> None:
    """An arm that was put beyond a limit by hand may return, and go no further."""
    envelope = Envelope(LIMITS, 0.01)
    assert envelope.step(0.5, [1.0], [2.1])[0] == 0.0
    assert envelope.step(0.5, [-1.0], [2.1])[0] == pytest.approx(-1.0)


def test_without_limits_everything_passes() -> None:
    """Joints without limits are not bounded, at no time and any step."""
    envelope = Envelope(unlimited(2), 0.01)
    for dt in (0.0, 0.001, 1.0):
        assert envelope.step(dt, [1e9, -1e9], [1e5, 0.0]) == pytest.approx([1e9, -1e9])
    assert not (envelope.cuts & SATURATING).any()


def test_begins_at_the_speed_of_the_arm() -> None:
    """Who takes over a moving arm begins with its speed, not with a step."""
    envelope = Envelope(LIMITS, 0.0)
    envelope.begin([1.2])
    assert envelope.step(0.01, [0.0], [0.0]) == pytest.approx([1.1])
    envelope.begin(0.0)
    assert envelope.command == pytest.approx([0.0])
