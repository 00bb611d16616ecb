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

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.cli.main import main

BAGS = {'two_blade_train_1': ('two_blade_arm', 32.0), 'two_blade_train_2': ('two_blade_arm', 32.0),
        'two_blade_test': ('two_blade_arm', 24.0), 'tudor_damped/stimulus_01': ('tudor', 20.0),
        'tudor_undamped/stimulus_01': ('tudor', 20.0)}


@pytest.mark.parametrize('name', BAGS)
def test_readable(root: Path, name: str) -> None:
    """Every sample bag is read whole, with strains and currents."""
    arm, seconds = BAGS[name]
    recording = read_recording(root / 'bags' / name, load_arm(root / f'config/{arm}.yaml'))
    assert recording.effort is not None and recording.strain is not None
    assert float(recording.t[-1]) == pytest.approx(seconds, abs=0.1)
    assert recording.payload == (0.2 if arm == 'tudor' else None)
    assert not recording.dropped


def test_made_by_the_command_in_their_readme(root: Path, tmp_path: Path) -> None:
    """The same command gives the same motion, and strains that differ by rounding at most."""
    out = tmp_path / 'again'
    text = (root / 'bags/README.md').read_text()
    line = next(line for line in text.splitlines() if line.startswith('tudor record'))
    words = line.split()[1:-1]
    words[words.index('config/tudor.yaml')] = str(root / 'config/tudor.yaml')
    assert main([*words, str(out), '--jobs', '1']) == 0
    arm = load_arm(root / 'config/tudor.yaml')
    kept = read_recording(root / 'bags/tudor_damped/stimulus_01', arm)
    made = read_recording(out / 'stimulus_01', arm)
    assert np.array_equal(kept.stamp, made.stamp) and made.payload == 0.2
    # other processors round differently, and stiction makes a little more of it
    assert np.abs(kept.q - made.q).max() < 2e-3
    assert kept.strain is not None and made.strain is not None
    assert np.sqrt(np.mean((kept.strain - made.strain) ** 2)) < 3.0


def test_damping_shows(root: Path) -> None:
    """The first mode of the undamped arm shows in its strain, that of the damped one hardly."""
    arm = load_arm(root / 'config/tudor.yaml')
    ringing = {}
    for name in ('damped', 'undamped'):
        recording = read_recording(root / f'bags/tudor_{name}/stimulus_01', arm)
        assert recording.strain is not None
        frequency, density = signal.welch(recording.strain[:, 0], 100.0, nperseg=800)
        # the first mode with 200 g: 2.2 to 2.7 Hz, from stretched out to folded
        ringing[name] = density[(frequency > 2.0) & (frequency < 2.8)].sum()
    assert ringing['undamped'] > 10.0 * ringing['damped']
