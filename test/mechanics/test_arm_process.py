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

"""The simulated arm as a robot: it outlives a run that diverges."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.mechanics.closed_loop import ArmProcess
from tudor_dynamics.mechanics.hardware import Floor

RATE = 100.0
HUGE = np.array([0.0, 0.0, 1e5])


def make(root: Path) -> ArmProcess:
    """Make the reference arm."""
    return ArmProcess(load_arm(root / 'config/tudor.yaml'), rate=RATE, seed=3)


def row(process: ArmProcess) -> np.ndarray:
    """One sample without its time."""
    sample = process.step()
    return np.concatenate([sample.q, sample.dq, sample.current, sample.strain, sample.force])


def fail(process: ArmProcess) -> None:
    """Move, then let a force act that no link stands."""
    process.command(np.array([0.4, -0.4]))
    for _ in range(5):
        process.step()
    process.force = HUGE.copy()
    for _ in range(50):
        process.step()
        if process.failure:
            return
    pytest.fail('nothing diverged')


def test_a_diverged_arm_is_as_a_new_one(root: Path) -> None:
    """Rest at the initial pose, no commands, no forces; `reset` makes it obey, as a new arm."""
    process = make(root)
    fail(process)
    assert 'tudor' in process.failure
    process.floor = Floor(10.0, 1e5)  # the arm would be deep in it
    for _ in range(20):
        process.command(np.array([1.0, 1.0]))
        process.force = HUGE.copy()
        sample = process.step()
        assert np.abs(sample.q - [np.pi / 4, 0.0]).max() < 1e-3 and not sample.force.any()
    process.floor = None
    process.reset()
    assert not process.failure
    fresh = make(root)
    for k in range(30):
        for each in (process, fresh):
            each.command(np.array([0.3, 0.1]))
        np.testing.assert_array_equal(row(process), row(fresh), err_msg=str(k))
    assert not process.failure


def test_time_goes_on_through_everything(root: Path) -> None:
    """Samples stay on one grid: running, failing, resting, reset, and failing again."""
    process, times = make(root), []
    for k in range(120):
        if k in (10, 60):
            process.force = HUGE.copy()
        if k in (50, 55, 110):
            process.reset()
        times.append(process.step().t)
    np.testing.assert_allclose(np.diff(times), 1.0 / RATE, rtol=1e-9)


def test_held_joints_are_where_they_are_held(root: Path, tmp_path: Path) -> None:
    """By default at their ``hold``; where the simulation begins elsewhere, there."""
    assert make(root).held == {'joint1': 0.0}
    text = (root / 'config/tudor.yaml').read_text().replace(
        'tudor.urdf', str(root / 'config/tudor.urdf'))
    for old, new, place in (('hold: 0.0', 'hold: 0.3', 0.3),
                            ('{joint2: 0.7853982}', '{joint2: 0.7, joint1: 0.2}', 0.2)):
        text = text.replace(old, new)
        (tmp_path / 'arm.yaml').write_text(text)
        arm = load_arm(tmp_path / 'arm.yaml')
        assert ArmProcess(arm, rate=RATE).held == {'joint1': place}
