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

"""Value and derivatives after one filter."""

from __future__ import annotations

import numpy as np
import pytest

from tudor_dynamics.signals.filters import SmoothStates


def test_step_is_process() -> None:
    """Sample by sample and at once are the same, at sample times that vary."""
    generator = np.random.default_rng(0)
    dt, x = generator.uniform(0.001, 0.004, 200), generator.standard_normal((200, 3))
    filtered = SmoothStates(5.0)
    steps = [filtered.step(0.0 if k == 0 else dt[k], row) for k, row in enumerate(x)]
    assert np.array(steps) == pytest.approx(np.moveaxis(filtered.process(dt, x), 0, 1), abs=1e-6)
    begun = filtered.step(0.0, x[7])
    assert begun[0] == pytest.approx(x[7]) and not begun[1:].any()


def test_derivatives_belong_together() -> None:
    """Behind the filter the second derivative of a sine is minus its square frequency times it."""
    w = 2.0 * np.pi * 2.5
    for dt in (1e-3, 1e-2):
        t = np.arange(0.0, 10.0, dt)
        found = SmoothStates(5.0).process(np.full(len(t), dt), np.sin(w * t)[:, None])
        found = found[:, len(t) // 5:, 0]
        assert found[2] == pytest.approx(-w ** 2 * found[0], abs=0.003 * w ** 2)
        assert found[1, 1:-1] == pytest.approx(np.gradient(found[0], dt)[1:-1], abs=0.02 * w)
        # three poles at 5 Hz, seen at half of that
        assert np.abs(found[0]).max() == pytest.approx(1.25 ** -1.5, rel=20.0 * dt)
