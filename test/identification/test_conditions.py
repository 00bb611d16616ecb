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

"""Condition numbers of a motion before it is run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.identification.excitation_plan import (
    best_seed, excitation_report, worst)
from tudor_dynamics.signals.motion_profile import aprbs_motion, Reference


def test_good_and_poor_motion(root: Path) -> None:
    """An APRBS is far better conditioned than a slow swing of one joint alone."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    good = excitation_report(arm, aprbs_motion(arm, 40.0, 0, 2e-3))
    t = np.arange(0.0, 40.0, 2e-3)[:, None]
    swing = np.hstack([1.0 + 0.1 * np.sin(0.5 * t), 0.0 * t])
    rate = np.hstack([0.05 * np.cos(0.5 * t), 0.0 * t])
    poor = excitation_report(arm, Reference(2e-3, swing, rate, 0.0 * rate))
    assert worst(good) < 1e3
    assert worst(poor) > 1e6
    assert [item.channels for item in good['effort']] == [('joint2',), ('joint3',)]
    assert len(good['strain']) == len(arm.gauges)
    assert all(item.weakest for item in good['effort'])


def test_best_of_seeds(root: Path) -> None:
    """The seed that is chosen has the least condition number of those that were tried."""
    arm = load_arm(root / 'config' / 'tudor.yaml')

    def motion(seed: int) -> Reference:
        return aprbs_motion(arm, 40.0, seed, 2e-3)

    tried = [worst(excitation_report(arm, motion(seed))) for seed in range(3)]
    assert len({*tried}) == 3
    assert tried[best_seed(arm, motion, range(3))] == min(tried)
