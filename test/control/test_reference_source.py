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

"""Reference motion, step by step."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.control.references import ReferenceSource
from tudor_dynamics.control.settings import TARGETS_SECONDS


def wandering(root: Path, seed: int, seconds: float, dt: float = 0.05) -> np.ndarray:
    """Give the positions of a reference that the arm follows at once."""
    arm = load_arm(root / 'config' / 'tudor.yaml')
    source = ReferenceSource(arm)
    source.wander(seed)
    q, found = np.radians([90.0, 0.0]), []
    for k in range(round(seconds / dt)):
        source.measured(k * dt, q)
        source.step(k * dt, dt)
        if source.q is not None:
            q = source.q.copy()
        found.append(q)
    return np.array(found)


def test_random_targets_never_come_again(root):
    """The second stretch of ten minutes is another one, and again the same for the same seed."""
    dt = 0.05
    moved = wandering(root, 1, TARGETS_SECONDS + 200.0, dt)
    window = moved[round(60.0 / dt):round(160.0 / dt)]
    # the second stretch begins when the last target of the first is due
    apart = [np.abs(moved[first:first + len(window)] - window).max()
             for first in range(round((TARGETS_SECONDS + 30.0) / dt), len(moved) - len(window))]
    assert min(apart) > 0.1
    assert np.array_equal(moved, wandering(root, 1, TARGETS_SECONDS + 200.0, dt))
    assert not np.array_equal(moved[:2000], wandering(root, 2, 100.0, dt))
