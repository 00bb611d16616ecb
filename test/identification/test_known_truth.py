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

"""Known truth: what a planned motion promises is what simulated recordings of it bring."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.identification.excitation_plan import make_plan, Order
from tudor_dynamics.models.comparison import full_parameters_of


@pytest.mark.parametrize('last', ['revolute', 'prismatic'])
def test_seven_bodies(
    last: str, root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Promised errors within 30 %, masses within three of theirs; the body that slides weighed."""
    monkeypatch.syspath_prepend(str(root / 'bench'))
    bench, simulated = map(importlib.import_module, ('known_truth', 'excitation'))
    noise = 0.1
    arm, bodies = bench.described_arm(tmp_path, seed=0, last=last)
    target = simulated.wanted(arm, noise)
    plan = make_plan(target, Order(20.0, 1.0, 0.01, 6, 0))
    regressor = target.models['effort'].regressor
    drives = np.random.default_rng(1).uniform(0.2, 0.5, len(regressor.columns) - 70)
    truth = np.tile(np.concatenate([bodies.ravel(), drives]), (7, 1))
    model = simulated.recorded(arm, target, plan.trajectory, truth, noise, 0)
    reached = np.concatenate([group.estimate.standard_errors for group in model.groups_])
    expected = np.array([item.value for item in plan.expected])
    np.testing.assert_allclose(reached / expected, 1.0, atol=0.3)

    full = full_parameters_of(arm, model)
    off = (full.solution.bodies - bodies) / full.solution.body_errors
    assert np.abs(off[:, 0]).max() < 3.0
    alone = bench.separable(regressor, 7)
    assert alone == [False] * 6 + [last == 'prismatic']
    if last == 'prismatic':
        assert full.sources()[60] == 'data'
        described = float(list(arm.model.inertias)[7].mass)
        assert abs(full.solution.bodies[6, 0] / 0.9 - 1.0) < 0.02 < abs(described / 0.9 - 1.0)
