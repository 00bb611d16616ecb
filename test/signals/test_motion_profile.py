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

"""Planner: the paper's profile from rest, and no step in the acceleration from anywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import unlimited
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.motion_profile import follow_targets, motion_limits, MotionPlanner

V, A = np.radians(70.0), np.radians(200.0)
LIMITS = replace(unlimited(1), velocity=np.array([V]), acceleration=np.array([A]))
DT = 5e-4


@pytest.mark.parametrize(('angle', 'duration', 'speed'), [
    (90.0, 0.7 + 90.0 / 70.0, 70.0), (165.0, 0.7 + 165.0 / 70.0, 70.0),
    (49.0, 1.4, 70.0), (30.0, 2.0 * np.sqrt(2.0 * 30.0 / 200.0), np.sqrt(200.0 * 30.0 / 2.0)),
    (-5.0, 2.0 * np.sqrt(2.0 * 5.0 / 200.0), np.sqrt(200.0 * 5.0 / 2.0))])
def test_profile_from_rest(angle: float, duration: float, speed: float) -> None:
    """
    Duration and speed are those of two pulses a sin^2 with a stretch of full speed between.

    T_a = 2 v / a, T = 2 T_a + D / v - T_a for D of 49 deg or more; T = 2 sqrt(2 D / a) below.
    """
    seen = follow_targets([0.0], [np.array([0.0])], [np.radians([angle])], LIMITS, DT, 8000)
    moving = np.flatnonzero(np.abs(seen.dq[:, 0]) > 1e-9)
    assert moving[-1] * DT == pytest.approx(duration, abs=2 * DT)
    assert np.degrees(np.abs(seen.dq).max()) == pytest.approx(speed, rel=1e-4)
    assert np.degrees(np.abs(seen.ddq).max()) == pytest.approx(200.0, rel=1e-4)
    assert seen.q[-1, 0] == pytest.approx(np.radians(angle), abs=1e-12)


def test_shape_of_the_acceleration() -> None:
    """Inside the first pulse the acceleration is a sin^2(pi t / T_a)."""
    seen = follow_targets([0.0], [np.array([0.0])], [np.radians([90.0])], LIMITS, DT, 1400)
    t = np.arange(1400) * DT
    np.testing.assert_allclose(seen.ddq[:, 0], A * np.sin(np.pi * t / 0.7) ** 2, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 6.0), st.floats(-3.0, 3.0)), min_size=1, max_size=20))
def test_targets_at_any_time(orders: list[tuple[float, float]]) -> None:
    """Speed, acceleration and jerk stay bounded, and the last target is reached exactly."""
    orders.sort()
    times, targets = np.array([o[0] for o in orders]), np.array([o[1] for o in orders])
    seen = follow_targets([0.0], [times], [targets], LIMITS, DT, 28000)
    assert np.abs(seen.dq).max() <= V * (1 + 1e-9)
    assert np.abs(seen.ddq).max() <= A * (1 + 1e-9)
    # 20 a / s is the bound of a pulse, up to twice that where it is broken off.
    assert np.abs(np.diff(seen.ddq, axis=0)).max() <= 40.0 * A * DT
    np.testing.assert_allclose(np.diff(seen.q, axis=0)[:, 0] / DT, seen.dq[1:, 0], atol=2e-3)
    assert seen.q[-1, 0] == pytest.approx(targets[-1], abs=1e-9)
    assert not seen.dq[-1].any() and not seen.ddq[-1].any()


def test_a_braking_arm_does_not_leave_its_range() -> None:
    """Called back while it brakes before the end of its range, the arm stays inside."""
    for late in np.arange(1.0, 2.0, 0.02):
        seen = follow_targets([0.0], [np.array([0.0, late])], [np.radians([90.0, 10.0])], LIMITS,
                              DT, 10000)
        assert seen.q.max() <= np.radians(90.0) + 1e-9


def test_step_by_step_is_the_same(root: Path) -> None:
    """The planner of a node gives the samples of the whole motion."""
    limits = motion_limits(load_arm(root / 'config' / 'tudor.yaml'))
    whole = follow_targets([0.1, 0.2], [np.array([0.0, 0.6]), np.array([0.3])],
                           [np.array([1.0, 0.3]), np.array([-1.0])], limits, DT, 3000)
    planner = MotionPlanner(limits, [0.1, 0.2])
    for k in range(3000):
        if k:
            planner.step(DT)
        np.testing.assert_allclose(planner.q, whole.q[k], atol=1e-12)
        np.testing.assert_allclose(planner.ddq, whole.ddq[k], atol=1e-9)
        for when, target in ((0, [1.0, np.nan]), (600, [np.nan, -1.0]), (1200, [0.3, np.nan])):
            if k == when:
                planner.go(target)
    assert planner.remaining > 0.0
    with pytest.raises(SignalError, match='not finite'):
        planner.go([np.inf, 0.0])


def test_limits_are_needed(root: Path) -> None:
    """An arm without limits is refused by name of the joint."""
    with pytest.raises(SignalError, match="'joint2' lacks a limit"):
        motion_limits(load_arm(root / 'config' / 'two_blade_arm.yaml'))
