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

"""Delay of the loop from commands and motion; what it leaves of the gains; swings that are fed."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from tudor_dynamics.arm.schema import LONGEST_FULL_DELAY, LOOP_PHASE
from tudor_dynamics.control.cascade import (
    damping_share, DelayMeter, position_gain_limit, RingingWatch)
from tudor_dynamics.control.settings import DELAY_LONGEST, DELAY_PHASE

SPEED = np.array([1.8, 1.8])


def drive(meter: DelayMeter, delay: float, dt: float, seconds: float, seed: int = 0) -> None:
    """Let joints answer smooth random commands after a delay, with noise of their encoders."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, dt)
    wave = sum(a * np.sin(2 * np.pi * f * t[:, None] + p) for a, f, p in zip(
        random.normal(0, 0.3, (5, 2)), (0.3, 0.7, 1.3, 2.1, 3.0), random.uniform(0, 6, (5, 2)),
        strict=True))
    held = np.vstack([np.zeros((1, 2)), wave])
    for k in range(len(t)):
        fine = t[k] - np.linspace(0.0, dt, 50, endpoint=False) - delay
        index = np.clip(np.floor(fine / dt + 1e-9).astype(int) + 1, 0, k)
        meter.add_motion(t[k], dt, held[index].mean(axis=0) + random.normal(0, 0.01, 2))
        meter.commands.add(t[k], wave[k])


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 0.12), st.sampled_from([0.002, 0.005, 0.01]), st.integers(0, 9))
def test_finds_the_delay(delay: float, dt: float, seed: int) -> None:
    """Any delay is found within 1 ms and a tenth of a sample."""
    meter = DelayMeter(SPEED)
    drive(meter, delay, dt, 5.0, seed)
    assert meter.delay == pytest.approx(delay, abs=0.001 + 0.1 * dt)


def test_says_nothing_without_motion_or_connection() -> None:
    """At rest, and where the joints do not answer, no delay is told; the last is kept."""
    meter = DelayMeter(SPEED)
    for k in range(2000):
        meter.add_motion(0.002 * k, 0.002, np.zeros(2))
        meter.commands.add(0.002 * k, np.zeros(2))
    assert meter.delay is None
    random = np.random.default_rng(1)
    for k in range(2000, 6000):
        meter.add_motion(0.002 * k, 0.002, random.normal(0.0, 0.5, 2))
        meter.commands.add(0.002 * k, np.sin(0.01 * k) * SPEED)
    assert meter.delay is None
    other = DelayMeter(SPEED)
    drive(other, 0.03, 0.002, 4.0)
    other.commands.count = 0
    assert other.delay == pytest.approx(0.03, abs=0.003)


def test_share_falls_with_the_delay() -> None:
    """All up to the full delay, a third at twice of it, none from five times on, never more."""
    assert damping_share(0.0, 0.02) == damping_share(0.02, 0.02) == 1.0
    assert damping_share(0.04, 0.02) == pytest.approx(2.0**-1.5)
    assert damping_share(0.1, 0.02) == 0.0
    shares = [damping_share(0.001 * k, 0.02) for k in range(150)]
    assert all(b <= a for a, b in zip(shares, shares[1:], strict=False))
    assert position_gain_limit(0.1) == pytest.approx(2.5)


def watch(swing: RingingWatch, size: object, seconds: float, moving: bool = False) -> str:
    """Let something at 2.5 Hz be added to the reference; give what was found first."""
    for k in range(round(seconds / 0.002)):
        t = 0.002 * k
        added = size(t) * np.sin(2 * np.pi * 2.5 * t) * np.ones(2)
        found = swing.step(0.002, added, moving, False)
        if found:
            return found
    return ''


def test_swing_that_is_fed() -> None:
    """What decays is none; what stays or grows is told within seconds, what is wild at once."""
    assert watch(RingingWatch(SPEED), lambda t: 0.6 * np.exp(-t / 1.5), 8.0) == ''
    assert watch(RingingWatch(SPEED), lambda t: 0.04, 8.0) == ''  # noise of a real arm
    assert 'not decay' in watch(RingingWatch(SPEED), lambda t: 0.3, 6.0)
    assert 'grows' in watch(RingingWatch(SPEED), lambda t: 0.02 * np.exp(1.2 * t), 6.0)
    assert watch(RingingWatch(SPEED), lambda t: 0.3, 6.0, moving=True) == ''
    # a push in the middle of a window, and its answer in the next one, which then decays
    assert watch(RingingWatch(SPEED), lambda t: float(SPEED[0]) * (
        0.02 if t < 2.2 else 0.05 if t < 2.4 else 0.08 * np.exp(2.4 - t)), 6.0) == ''
    # the end of a push of 4 N in the middle of a window: peaks of the simulated arm with 200 g
    peaks = (0.004, 0.004, 0.004, 0.169, 0.076, 0.045, 0.066, 0.177, 0.061, 0.051, 0.017)
    assert watch(RingingWatch(SPEED), lambda t: float(SPEED[0]) * peaks[int(t / 0.4001)],
                 4.2) == ''
    assert 'speed limit' in watch(RingingWatch(SPEED), lambda t: 1.6, 2.0, moving=True)


def test_descriptions_end_where_the_loop_does() -> None:
    """With the largest full delay the longest that is measured still switches the damper off."""
    assert damping_share(DELAY_LONGEST, LONGEST_FULL_DELAY) == 0.0
    assert damping_share(0.9 * DELAY_LONGEST, LONGEST_FULL_DELAY) > 0.0
    assert LOOP_PHASE == DELAY_PHASE
