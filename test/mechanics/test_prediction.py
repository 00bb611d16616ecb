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

"""Accelerations that a step begins with: polynomials, and which of them is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.mechanics import integrator as gen
from tudor_dynamics.mechanics.integrator import best_order, extrapolated, ORDERS, PAST
from tudor_dynamics.mechanics.mechanism import build_mechanism
from tudor_dynamics.mechanics.plant import Plant


def history(order: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations of three coordinates that follow polynomials: the last ones, and the next."""
    t = np.arange(PAST + 1.0)
    values = np.array([np.polyval(rng.uniform(1.0, 2.0, order + 1), t) for _ in range(3)])
    return values[:, PAST - 1::-1].T.copy(), values[:, PAST].copy()


@pytest.mark.parametrize('order', range(ORDERS))
def test_polynomials_are_met(order: int) -> None:
    """By their own degree and those above it, and by no lower one, which is not taken."""
    rng = np.random.default_rng(order)
    past, found = history(order, rng)
    free, factor = np.zeros(3, dtype=bool), np.eye(3)
    for i in range(3):
        for tried in range(ORDERS):
            met = extrapolated(past, tried, i) == pytest.approx(found[i], rel=1e-9)
            assert met == (tried >= order)
    assert best_order(found, past, free, factor) >= order
    ringing = found + np.array([0.0, 100.0, 0.0])
    free[1] = True  # prescribed: whatever it does counts for nothing
    assert best_order(ringing, past, free, factor) >= order


def test_noise_is_not_extrapolated() -> None:
    """What has no order is met best by a low one."""
    rng = np.random.default_rng(0)
    taken = [best_order(rng.normal(size=30), rng.normal(size=(PAST, 30)),
                        np.zeros(30, dtype=bool), np.eye(30)) for _ in range(20)]
    assert max(taken) == 0


def test_what_is_remembered_can_be_forgotten(root: Path) -> None:
    """The newest comes first, and goes first where a step fails."""
    plant = Plant(build_mechanism(load_arm(root / 'config' / 'elastic_arm.yaml')), 5e-4)
    plant.reset([0.0, 0.3, -0.2])
    vectors = plant.tables.vectors
    past = vectors[gen.OLD_DDZ:]
    for _ in range(PAST):
        last = vectors[gen.DDZ].copy()
        before = past.copy()
        plant.step([0.0, 7.4, 0.4])
        np.testing.assert_array_equal(past, [last, *before[:3]])
    state, before = vectors[:gen.FORCE].copy(), past.copy()
    assert np.unique(before, axis=0).shape == before.shape
    plant.tables.torque[-1] = 1e300
    assert gen.step(plant.tables, False) != gen.OK
    np.testing.assert_array_equal(vectors[:gen.FORCE], state)
    np.testing.assert_array_equal(past[:3], before[:3])


def test_smooth_motion_takes_fewer_iterations(root: Path) -> None:
    """The order that is chosen saves iterations against straight lines, and changes nothing."""
    mechanism = build_mechanism(load_arm(root / 'config' / 'elastic_arm.yaml'))
    ends, counts = [], []
    for straight in (False, True):
        plant = Plant(mechanism, 5e-4)
        plant.reset([0.0, 0.3, -0.2])
        for k in range(600):
            if straight:
                plant.tables.settings[gen.ORDER] = 1.0
            plant.step([0.0, 7.4 + np.sin(0.005 * k), 0.4])
        ends.append(plant.coordinates.copy())
        counts.append(plant.tables.settings[gen.ITERATIONS])
    assert counts[0] < 0.95 * counts[1]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-8)
