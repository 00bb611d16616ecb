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

"""Loads that are picked up and put down: their choice, and what the arm makes of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import InertiaPart
from tudor_dynamics.errors import SimulationError
from tudor_dynamics.mechanics.campaign import carried_at, LoadChange, random_loads
from tudor_dynamics.mechanics.closed_loop import ClosedLoop
from tudor_dynamics.mechanics.hardware import Imperfections, with_payload
from tudor_dynamics.mechanics.settings import BETWEEN_CHANGES, FIRST_CHANGE


def test_choice() -> None:
    """Picked up where nothing is carried, put down where something is, and apart in time."""
    changes = random_loads(8, 80.0, 0.0, 3)
    assert changes == random_loads(8, 80.0, 0.0, 3) != random_loads(8, 80.0, 0.0, 4)
    assert [change.mass > 0.0 for change in changes] == [True, False] * 4
    times = np.array([change.time for change in changes])
    assert times[0] >= FIRST_CHANGE and np.diff(times).min() >= BETWEEN_CHANGES - 2e-3
    assert random_loads(1, 20.0, 0.2, 3)[0].mass == 0.0
    with pytest.raises(SimulationError, match='raise seconds=, or lower loads='):
        random_loads(8, 30.0, 0.0, 3)
    with pytest.raises(SimulationError, match='0 or more'):
        LoadChange(1.0, -0.1)


def test_carried() -> None:
    """From its time on a load is there."""
    changes = (LoadChange(1.0, 0.3), LoadChange(2.0, 0.0))
    found = carried_at(changes, 0.1, np.array([0.0, 0.999, 1.0, 1.5, 2.0, 3.0]))
    assert found.tolist() == [0.1, 0.1, 0.3, 0.3, 0.0, 0.0]


def test_put_on_while_it_runs(root: Path) -> None:
    """Behind a pick-up the arm comes to rest as one that carried the load from the beginning."""
    arm = load_arm(root / 'config/tudor.yaml')
    empty = Arm(arm.spec.model_copy(update={'payload': InertiaPart(mass=0.0)}), arm.full_model,
                arm.source, arm.urdf)
    strains = []
    for described, picked in ((empty, 0.3), (with_payload(arm, 0.3), None)):
        loop = ClosedLoop(described, imperfections=Imperfections.none())
        q = np.tile([0.3, 0.2], (3000, 1))
        loop.reset(q[0])
        if picked is not None:
            loop.run(q[:200], 0.0 * q[:200])
            loop.set_payload(picked)
        strains.append(np.mean(loop.run(q, 0.0 * q).strain[-600:], axis=0))
    assert strains[0] == pytest.approx(strains[1], rel=0.05)
    with pytest.raises(SimulationError, match="the key 'payload' to the arm description"):
        ClosedLoop(with_payload(arm, 0.0)).set_payload(0.1)
    with pytest.raises(SimulationError, match='payload= -0.1 kg: give 0 or more'):
        ClosedLoop(empty).set_payload(-0.1)
