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

"""The arm in MuJoCo that claims are held against: it is the same arm, and its bags are read."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.identification.detection import find_truth

pytest.importorskip('mujoco')


@pytest.fixture
def plant(root: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Give the module of the arm."""
    monkeypatch.syspath_prepend(str(root / 'bench'))
    import other_plant.plant
    return other_plant.plant


@pytest.mark.parametrize(('gears', 'frequency'), [('rigid', 2.621), ('elastic', 2.205)])
def test_it_vibrates_as_the_described_arm(
    plant: ModuleType, gears: str, frequency: float,
) -> None:
    """Stretched out with 200 g: ``tudor simulate --modes`` of config/tudor.yaml, to 1 %."""
    found = plant.first_frequency(plant.Options(gears=gears))
    assert found == pytest.approx(frequency, rel=0.01)


def test_its_bags_are_read(plant: ModuleType, root: Path, tmp_path: Path) -> None:
    """Readings that hold the arm's weight up, and the push where and as strong as it was."""
    still = np.pi * np.tile([0.5, -0.5], (2400, 1)), np.zeros((2400, 2))
    push = plant.Push(0.4, 0.4, 1, 0.3, 4.0)
    mean, = plant.record(tmp_path / 'bag', plant.Options(), still, 1, (push,))
    assert mean == pytest.approx(4.0 * (0.4 - 0.05) / 0.4, rel=0.02)  # two rises of 50 ms
    arm = load_arm(root / 'config/tudor.yaml')
    recording = read_recording(tmp_path / 'bag', arm)
    assert recording.strain is not None
    before = recording.strain[recording.t < 0.4].mean(axis=0) / (121.4 * np.array([
        1.02, 0.99, 0.98, 1.01]))
    # weights beyond the gauge of the level outer link: 200 g at 342.8 mm, and the blade
    assert before[1] == pytest.approx(9.81 * (0.2 * 0.3428 + 0.471 * 0.3428**2 / 2.0), rel=0.02)
    known, = find_truth(str(tmp_path / 'bag')).pushes
    assert known.force == pytest.approx(mean, rel=0.02)
    assert (known.begin - int(recording.stamp[0])) * 1e-9 == pytest.approx(0.4, abs=0.01)
