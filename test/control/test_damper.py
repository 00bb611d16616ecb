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

"""Damper: the law, and that no faulty gauge moves a joint."""

from __future__ import annotations

import math
from pathlib import Path
import subprocess
import sys

import numpy as np
from numpy.typing import NDArray
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.control.damper import arm_damping, Damper, DamperSettings, Status
from tudor_dynamics.errors import ArmError

DT = 5e-4
ONE = DamperSettings('joint2', 'link2_hub', -1e-3, mean_frequency=0.1, max_rate=2e5,
                     max_strain=5000.0)


def drive(damper: Damper, strain: NDArray[np.float64], **more: bool) -> NDArray[np.float64]:
    """Give the speed of the first joint for each reading."""
    return np.array([damper.step([value], **more)[0] for value in strain])


def noisy(value: float, seconds: float, seed: int = 0) -> NDArray[np.float64]:
    """Give readings of a live gauge: 2 um/m of noise in steps of 0.23 um/m."""
    rng = np.random.default_rng(seed)
    values = value + 2.0 * rng.standard_normal(int(seconds / DT))
    return np.asarray(np.round(values / 0.23) * 0.23)


def test_yields_to_oscillation_and_not_to_load() -> None:
    """A ringing of 100 um/m about a load of 300 um/m gives -gain times the ringing alone."""
    damper = Damper([ONE], DT)
    t = np.arange(int(12.0 / DT)) * DT
    ring = 100.0 * np.sin(2 * math.pi * 3.0 * t)
    speed = drive(damper, 300.0 + ring)
    late = t > 10.0
    assert damper.status == (Status.DAMPING,)
    # The blocker of 0.1 Hz passes 3 Hz within 0.06 % of amplitude and 2 deg of phase.
    np.testing.assert_allclose(speed[late], -1e-3 * ring[late], atol=6e-3)
    assert abs(speed[late].mean()) < 1e-4


@pytest.mark.parametrize('window', [0.0, 1.0])
def test_load_alone_moves_nothing(window: float) -> None:
    """After the mean is known, a constant load with noise gives no more than the noise."""
    settings = DamperSettings('a', 'b', -1e-3, mean_window=window)
    speed = drive(Damper([settings], DT), noisy(400.0, 6.0))
    assert abs(speed[int(3.0 / DT):].mean()) < 2e-4
    assert np.abs(speed).max() < 0.015


def test_moving_average_is_the_mean_of_its_window() -> None:
    """The mean over 0.1 s is that of the last 200 readings."""
    values = noisy(100.0, 1.0)
    values[1400:] += 50.0
    damper = Damper([DamperSettings('a', 'b', -1.0, mean_window=0.1)], DT)
    speed = drive(damper, values)
    expected = -(values[1500] - values[1301:1501].mean())
    assert speed[1500] == pytest.approx(expected, rel=1e-9)


def test_starts_without_a_bump() -> None:
    """The first second after the start never asks for more than the ringing does."""
    t = np.arange(int(2.0 / DT)) * DT
    speed = drive(Damper([ONE], DT), 300.0 + 50.0 * np.cos(2 * math.pi * 3.0 * t))
    assert not speed[:int(0.5 / DT) - 2].any()
    assert np.abs(speed).max() < 0.08


def test_a_gauge_dead_from_the_start_moves_nothing() -> None:
    """A reading that never changes gives no motion at all, and is called dead."""
    damper = Damper([ONE], DT)
    assert not drive(damper, np.full(8000, 250.0)).any()
    assert damper.status == (Status.STUCK,)
    assert 'does not change' in damper.report()[0]


@pytest.mark.parametrize(('reading', 'status'), [
    (None, Status.STUCK), (math.nan, Status.MISSING), (4900.0, Status.STUCK),
    (9000.0, Status.IMPLAUSIBLE), (0.0, Status.STUCK)])
def test_a_gauge_that_dies_is_faded_out(reading: float | None, status: Status) -> None:
    """
    When a gauge dies at the peak of a ringing, the joint moves less than half a degree from then.

    0.1 rad/s at the peak, half of it over the fade time of 0.1 s and the time until it is noticed.
    """
    damper = Damper([ONE], DT)
    t = np.arange(int(3.0 / DT) + 167) * DT  # ends 0.0835 s into a period, at the peak
    last = 300.0 + 100.0 * np.sin(2 * math.pi * 3.0 * t) + noisy(0.0, t[-1] + DT)[:t.size]
    before = drive(damper, last)
    assert abs(before[-1]) > 0.05
    speed = drive(damper, np.full(4000, last[-1] if reading is None else reading))
    assert damper.status == (status,)
    assert abs(speed.sum() * DT) < math.radians(0.5)
    assert np.abs(speed).max() <= 0.115
    assert not speed[int(0.2 / DT):].any()
    # It comes back by itself when the gauge is well again.
    drive(damper, noisy(300.0, 1.0, seed=1))
    assert damper.status == (Status.DAMPING,)


def test_stale_readings() -> None:
    """Without new readings the damper fades out; with readings at a tenth of its rate it works."""
    damper = Damper([ONE], DT)
    values = noisy(300.0, 2.0)
    for k, value in enumerate(values):
        damper.step([value], fresh=[k % 10 == 0])
    assert damper.status == (Status.DAMPING,)
    speed = drive(damper, np.full(400, 300.0), fresh=False)
    assert damper.status == (Status.STALE,)
    assert not speed[-10:].any()
    assert Damper([ONE], DT).step([math.nan], fresh=[False])[0] == 0.0


def test_saturation_fades_out_and_back() -> None:
    """At a limit of the joint the damper lets go, and comes back at once after."""
    damper = Damper([ONE], DT)
    drive(damper, noisy(300.0, 2.0))
    t = np.arange(800) * DT
    ring = 300.0 + 100.0 * np.sin(2 * math.pi * 3.0 * t) + noisy(0.0, 0.4)
    speed = drive(damper, ring, saturated=True)
    assert damper.status == (Status.SATURATED,)
    assert not speed[250:].any()
    drive(damper, noisy(300.0, 0.15))
    assert damper.status == (Status.DAMPING,)


def test_settings_of_the_reference_arm(root: Path) -> None:
    """Gains per um/m, negative, because strain counts positive for the load."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    assert arm.spec.damper is not None
    settings = arm_damping(arm, share=0.5)
    assert [item.joint for item in settings] == ['joint2', 'joint3']
    gain = arm.spec.damper.joints[0].gain
    assert settings[0].gain == pytest.approx(-0.5e-6 * gain)
    gauges = tuple(g.model_copy(update={'unit': 'V'}) for g in arm.spec.gauges)
    volts = type(arm)(arm.spec.model_copy(update={'gauges': gauges}), arm.full_model, 'here')
    with pytest.raises(ArmError, match='link2_hub. is V; correct'):
        arm_damping(volts)


def test_rooms_for_hardware_know_no_simulation() -> None:
    """Control and signals can be imported without simulation and without ROS."""
    code = ('import sys, tudor_dynamics.control.cascade, tudor_dynamics.control.damper, '
            'tudor_dynamics.control.damper, tudor_dynamics.signals.motion_profile, '
            'tudor_dynamics.signals.motion_profile, tudor_dynamics.signals.filters\n'
            'no = ("tudor_dynamics.mechanics", "rclpy")\n'
            'bad = [m for m in sys.modules if m.startswith(no)]'
            '\nassert not bad, bad')
    run = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
