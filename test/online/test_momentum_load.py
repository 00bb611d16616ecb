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

"""A load in the momentum: no external effort, and no kick when it comes."""

from __future__ import annotations

import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from sample_arms import multisine

from tudor_dynamics.load.live import CarriedLoad
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.online.monitor import MomentumObserver
from tudor_dynamics.online.streams import Motion, PairedSample

DT, LOAD, CAME = 1e-3, 0.3, 1500


def test_load_is_no_external_effort() -> None:
    """With the load it stays quiet from before to after its coming; without it does not."""
    arm = two_gauge_arm()
    moved = multisine(np.arange(0.0, 60.0, 0.05), 2, 1)
    model = AnalyticalModel(PayloadRegressor(EffortRegressor(arm), arm, (0.0, 0.4)), 2).fit(
        np.vstack([np.column_stack([moved, np.full(len(moved), m)]) for m in (0.0, 0.4)]),
        np.vstack([true_outputs(arm, moved, m)['effort'] for m in (0.0, 0.4)]))
    bundle = ModelBundle(arm, arm.spec.preprocessing, {'effort': {'analytical': model}})
    motion = multisine(np.arange(0.0, 3.0, DT), 2, 3)
    empty, full = (true_outputs(arm, motion, m)['effort'] for m in (0.0, LOAD))
    measured = np.where(np.arange(len(motion))[:, None] < CAME, empty, full)
    seen = []
    for load in (CarriedLoad(bundle, 0.0), None):
        observer = MomentumObserver(bundle.at(0.0).models['effort']['analytical'], 30.0, 0.1)
        worst = 0.0
        for k, (row, effort) in enumerate(zip(motion, measured, strict=True)):
            if load is not None and k == CAME:
                load.carry(LOAD)
            found = observer.step(PairedSample(Motion(round(k * DT * 1e9), k * DT, DT if k else
                                                      0.0, row), None, effort), load)
            if found is not None and k > 300:
                worst = max(worst, float(np.abs(found.value).max()))
        seen.append(worst)
    size = float(np.abs(full - empty)[CAME:].max())
    assert seen[0] < 0.05 * size < 0.5 * seen[1]
    assert seen[1] == pytest.approx(size, rel=0.3)
