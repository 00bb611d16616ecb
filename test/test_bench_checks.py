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

"""What benches judge by: limits that are held or not, samples that were told, skipping."""

from __future__ import annotations

import os
from pathlib import Path
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm

pytest.importorskip('rclpy')


@pytest.fixture
def benches(root: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Give the modules that judge."""
    monkeypatch.syspath_prepend(str(root / 'bench'))
    import envelope
    import soak_checks
    return SimpleNamespace(envelope=envelope, soak=soak_checks)


def test_envelope_sees_what_leaves_it(benches: Any, root: Path) -> None:
    """Positions, speeds and steps at their limits are held; a little more is not."""
    held = benches.envelope.Envelope.of(load_arm(root / 'config/tudor.yaml'))
    limits = [joint.limits for joint in load_arm(root / 'config/tudor.yaml').joints]
    upper = np.array([limit.upper for limit in limits])
    speed = np.array([limit.velocity for limit in limits])
    assert held.excursion(upper[None]) == 0.0
    assert held.excursion(upper[None] + [0.0, 0.1]) == pytest.approx(0.1)
    assert held.speed(-speed[None]) == pytest.approx(1.0)
    slack, period = benches.envelope.SLACK, 0.002
    rise = held.limits.acceleration * (period + slack)
    arrival = np.arange(3) * period
    assert held.step(np.outer([0.0, 1.0, 2.0], rise), arrival, period) == pytest.approx(1.0)
    assert held.step(np.outer([0.0, 1.0, 3.0], rise), arrival, period) == pytest.approx(2.0)


def test_envelope_steps_from_standstill_behind_a_silence(benches: Any, root: Path) -> None:
    """However long nothing came, the arm stood at the end of it."""
    held = benches.envelope.Envelope.of(load_arm(root / 'config/tudor.yaml'))
    command = np.array([[1.0, 1.0], [1.0, 1.0]])
    assert held.step(command, np.array([0.0, 0.05]), 0.002) == 0.0
    size, _ = held.steps(command, np.array([0.0, 3.0]), 0.002)
    assert size.tolist() == [[1.0, 1.0]]
    assert held.step(command, np.array([0.0, 3.0]), 0.002) > 1.0


def test_life_knows_when_it_took_what_came(benches: Any) -> None:
    """Stops, and what was on its way at the ends, are left out."""
    soak = benches.soak
    life = soak.Life('monitor', 0.0, ended=20.0, pauses=[(8.0, 10.0)])
    windows = list(life.windows(2.0))
    assert windows == [(2.0 + soak.EDGE, 8.0 - soak.EDGE), (10.0 + soak.CATCH_UP,
                                                            20.0 - soak.EDGE)]
    arrival = np.array([1.0, 3.0, 9.0, 11.0, 13.0, 19.9])
    assert soak.inside(arrival, windows).tolist() == [False, True, False, False, True, False]


def test_samples_are_told_of_or_not(benches: Any) -> None:
    """A diagnosis that says something covers the seconds before it, another one nothing."""
    def told(at: float, level: int, **values: str) -> tuple[float, Any]:
        return at, SimpleNamespace(level=bytes([level]), values=[
            SimpleNamespace(key=key, value=value) for key, value in values.items()])
    stamps = np.array([1.0, 4.0, 7.0, 10.0])
    observed = SimpleNamespace(told=[
        told(2.0, 0), told(5.0, 1), told(8.0, 0, **{'not judged [%]': '3.0'}),
        told(11.0, 0, **{'not judged [%]': '0.0'})])
    found = benches.soak.told_of(observed, (stamps * 1e9).astype(np.int64))
    assert found.tolist() == [False, True, True, False]


def test_two_hosts_says_why_it_is_skipped(root: Path, tmp_path: Path) -> None:
    """Without the tools there is one line and exit code 0."""
    done = subprocess.run(
        [sys.executable, str(root / 'bench/two_hosts.py')], capture_output=True, text=True,
        cwd=root, env={**os.environ, 'PATH': str(tmp_path), 'PYTHONPATH': str(root)})
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('two_hosts.py skipped: no ') and done.stdout.count('\n') == 1
