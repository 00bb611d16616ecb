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

"""Motion that is not as commanded, told from slow joints, noise, loads and late answers."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.limits import Limits
from tudor_dynamics.control.cascade import Commanded
from tudor_dynamics.control.plausibility import AgeWatch, Doubt, MotionWatch

LIMITS = Limits(np.array([0.0, -1.0]), np.array([3.0, 1.0]), np.full(2, 1.8), np.full(2, 17.0))
COUNT = 2.0e-4
"""Step of a coarse encoder [rad]."""
LAGS = 0.0, 0.02


def watch(effort: float = np.inf) -> MotionWatch:
    """Give a watch of two joints."""
    return MotionWatch({'first': 'rad', 'second': 'rad'}, LIMITS, np.full(2, effort))


def drive(
    speed: Callable[[float], np.ndarray], reading: Callable[[np.ndarray, float], np.ndarray],
    seconds: float = 2.0, dt: float = 0.004, lag: float = 0.01, *, effort: float | None = None,
    own: bool = False, most: float = np.inf,
) -> list[Doubt]:
    """Command speeds, read what a function makes of the way, and give the first doubts."""
    judge, commanded = watch(most), Commanded(2)
    q = np.array([1.5, 0.1])
    commanded.add(-0.5, np.zeros(2))
    for k in range(round(seconds / dt)):
        t = k * dt
        before, q = q, q + dt * speed(t - lag)
        doubts = judge.step(
            t, dt, np.asarray(reading(q, t)), commanded, LAGS, (q - before) / dt if own else None,
            None if effort is None else np.full(2, effort))
        if doubts:
            return doubts
        commanded.add(t, speed(t))
    return []


def wave(t: float) -> np.ndarray:
    """Give speeds that come and go from rest."""
    return np.array([0.4, -0.2]) * np.sin(2.0 * np.pi * 0.5 * max(t, 0.0))


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.6, 0.6), st.sampled_from([0.002, 0.004, 0.01]), st.floats(0.1, 2.0))
def test_honest_encoders_are_believed(size: float, dt: float, frequency: float) -> None:
    """Motion as commanded, in counts, a little off in its speed: no doubt."""
    def speed(t: float) -> np.ndarray:
        return np.array([size * np.sin(2.0 * np.pi * frequency * max(t, 0.0)), 0.0])
    assert drive(speed, lambda q, t: COUNT * np.floor((q + 0.0005 * t) / COUNT), dt=dt) == []


@pytest.mark.parametrize('reading, text, astray', [
    (lambda q, t: [3.0 - q[0], q[1]], 'against its commands', True),
    (lambda q, t: [0.75 + 0.5 * q[0], q[1]], 'times as far', False),
    (lambda q, t: q + [0.1 * t, 0.0], 'in addition to its commands', True),
    (lambda q, t: np.array([1.5, q[1]]), 'does not move', False),
    (lambda q, t: q + [0.04 * (t > 0.7), 0.0], 'jumped by 0.04 rad', False),
    (lambda q, t: [1.5, 0.1] + (q - [1.5, 0.1])[::-1], 'follow commands to the other', True)])
def test_each_fault_is_named(
    reading: Callable[[np.ndarray, float], np.ndarray], text: str, astray: bool,
) -> None:
    """Each with its joint, before it has gone far."""
    doubts = drive(wave, reading)
    assert text in ' '.join(doubt.text for doubt in doubts), doubts
    assert all(doubt.astray is astray for doubt in doubts)


@pytest.mark.parametrize('reading, text', [
    (lambda q, t: [3.0 - q[0], q[1]], 'encoder counts backwards'),
    (lambda q, t: [0.75 + 0.5 * q[0], q[1]], 'moves 0.5 times as far'),
    (lambda q, t: q + [0.1 * t, 0.0], 'the encoder, which drifts')])
def test_own_speeds_of_the_driver_separate_encoders_from_drives(
    reading: Callable[[np.ndarray, float], np.ndarray], text: str,
) -> None:
    """Where they go with the commands, the positions are what is wrong."""
    assert text in drive(wave, reading, own=True)[0].text


def test_a_drive_at_the_end_of_its_effort_may_stay_behind() -> None:
    """Held up by its load it is no liar; without that effort it is."""
    def held(q: np.ndarray, t: float) -> np.ndarray:
        return np.array([min(q[0], 1.52), q[1]])
    assert drive(wave, held, 0.9, effort=2.4, most=2.5) == []
    assert drive(wave, held, 0.9, effort=0.4, most=2.5)


def test_readings_that_are_not_judged_do_not_stand_still() -> None:
    """After a gap readings count for nothing at first; a longer period then is no frozen one."""
    judge, commanded, q, t = watch(), Commanded(2), np.array([1.5, 0.1]), 0.0
    speed = np.array([0.8, 0.0])
    commanded.add(-0.5, speed)
    judge.restart(q, 0.3)
    for dt in (0.01, 0.01, 0.01, 0.05):
        t, q = t + dt, q + dt * speed
        assert judge.step(t, dt, q, commanded, LAGS) == []
        commanded.add(t, speed)


def test_no_pose_and_jumps_before_any_command() -> None:
    """Somebody else may move the arm, but not by a step, nor beyond its range."""
    for reading, text in (([1.9, 0.1], 'jumped by 0.4'), ([1.5, 2.0], 'far outside')):
        judge = watch()
        judge.restart(np.array([1.5, 0.1]))
        doubts = judge.step(0.004, 0.004, np.array(reading), Commanded(2), LAGS)
        assert text in doubts[0].text and not doubts[0].later


def test_speeds_are_trusted_by_the_way_that_was_confirmed() -> None:
    """Two degrees a second of 103 at first; all once a few degrees were gone as commanded."""
    judge, commanded, q = watch(), Commanded(2), np.array([1.5, 0.1])
    commanded.add(-0.5, np.zeros(2))
    assert judge.trusted == pytest.approx(np.full(2, 0.03))
    for k in range(100):
        speed = np.array([0.5, 0.0])
        assert judge.step(0.004 * k, 0.004, q, commanded, LAGS) == []
        commanded.add(0.004 * k, speed)
        q = q + 0.004 * speed
    assert judge.trusted[0] > LIMITS.velocity[0] and judge.trusted[1] == pytest.approx(0.03)


def test_age_is_late_by_the_quickest_of_a_while() -> None:
    """However clocks differ; a change that stays is usual after the memory is over."""
    ages = AgeWatch()
    for k in range(500):
        assert ages.step(0.01 * k, -3.0 + 0.002 * (k % 3)) < 0.005
    assert ages.step(5.0, -2.6) == pytest.approx(0.4)
    assert ages.step(5.01, -3.0) == pytest.approx(0.0)
    assert ages.recent == pytest.approx(0.4, rel=0.05)  # its answer still moves the joints
    assert ages.step(7.0, -3.0) == pytest.approx(0.0)
    assert ages.recent < 0.01
    for k in range(2500):
        late = ages.step(7.0 + 0.01 * k, -2.6)
    assert late == pytest.approx(0.0)


def test_an_arm_slower_than_the_clock_is_not_late() -> None:
    """A simulation at half speed has ages that grow all the time."""
    ages = AgeWatch()
    assert all(ages.step(0.01 * k, 0.005 * k) == 0.0 for k in range(3000))
