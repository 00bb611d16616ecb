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

"""A tool moves as the mass on a rod that Pinocchio simulates, and slopes are those of changes."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tool_making import ARM, KNOWN, MASS, moves, ONE, RATE, tool_efforts

from tudor_dynamics.models.flexible_tool import flange_motion, row_of
from tudor_dynamics.models.tool_motion import end_slopes, follow, from_rest, MOTION, pulls
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.typing import FloatArray


def driven(q: FloatArray) -> FloatArray:
    """Give the motion of the flange."""
    dq = np.gradient(q, 1.0 / RATE, axis=0)
    ddq = np.gradient(dq, 1.0 / RATE, axis=0)
    return flange_motion(ARM, np.arange(len(q)) / RATE, MotionState(q, dq, ddq)).motion


@pytest.mark.parametrize('planes', [1, 2])
def test_efforts(planes: int) -> None:
    """They are within 2 % of those of another simulation, of a rod on a universal joint."""
    q = moves(1, count=2, rest=1.5)
    given = {'frequencies': KNOWN.frequencies[:planes], 'damping': KNOWN.damping[:planes]}
    row = row_of(KNOWN.model_copy(update=given).parameters)
    motion = driven(q)
    pulled = MASS * pulls(row, motion, from_rest(row, 1.0 / RATE, motion))
    found, data = np.empty_like(q), ARM.model.createData()
    for k, pose in enumerate(q):
        pin.computeJointJacobians(ARM.model, data, pose)
        jacobian = pin.getJointJacobian(ARM.model, data, 5, pin.ReferenceFrame.LOCAL)
        found[k] = pulled[k] @ jacobian
    truth = tool_efforts(ARM, q, **({'frequencies': ONE} if planes == 1 else {}))
    assert (np.abs(found - truth).max(axis=0) < 0.02 * np.abs(truth).max()).all()


def test_slopes() -> None:
    """They are what small changes of the motion, and of its steps, do to the end."""
    row, motion = row_of(KNOWN.parameters), driven(moves(2, count=1, rest=0.3))
    random = np.random.default_rng(0)
    ways = random.normal(size=(2, len(motion), MOTION))
    steps, begin = random.uniform(0.5, 1.5, len(motion) - 1) / RATE, np.array([0.01, 0, 0.1, 0])
    states = follow(row, steps, motion, begin)
    found, of_steps = end_slopes(row, steps, motion, states, ways)
    for k in random.integers(1, len(motion), 6):
        for way in range(2):
            changed = motion.copy()
            changed[k] += 1e-5 * ways[way, k]
            truth = (follow(row, steps, changed, begin)[-1] - states[-1]) / 1e-5
            assert found[:, way, k] == pytest.approx(truth, rel=1e-3, abs=1e-6)
        longer = steps.copy()
        longer[k - 1] += 1e-7
        truth = (follow(row, longer, motion, begin)[-1] - states[-1]) / 1e-7
        assert of_steps[:, k - 1] == pytest.approx(truth, rel=1e-3, abs=1e-5)
