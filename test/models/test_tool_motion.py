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

"""A tool moves as the mass on a rod that Pinocchio simulates, alone and beside others."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from tool_making import ARM, KNOWN, MASS, moves, ONE, RATE, tool_efforts

from tudor_dynamics.compiled import LANES
from tudor_dynamics.models.flexible_tool import flange_motion, row_of
from tudor_dynamics.models.tool_motion import follow
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
    steps = np.full(len(q) - 1, 1.0 / RATE)
    pulled = MASS * follow(row[None], steps, motion, at=np.arange(len(q)))[1][:, :, 0]
    found, data = np.empty_like(q), ARM.model.createData()
    for k, pose in enumerate(q):
        pin.computeJointJacobians(ARM.model, data, pose)
        jacobian = pin.getJointJacobian(ARM.model, data, 5, pin.ReferenceFrame.LOCAL)
        found[k] = pulled[k] @ jacobian
    truth = tool_efforts(ARM, q, **({'frequencies': ONE} if planes == 1 else {}))
    assert (np.abs(found - truth).max(axis=0) < 0.02 * np.abs(truth).max()).all()


def test_several_are_as_each_alone() -> None:
    """Beside others, along motions, in steps and from states of their own, it moves the same."""
    motion, random = driven(moves(2, count=1, rest=0.3)), np.random.default_rng(0)
    rows = np.array([row_of(KNOWN.parameters + 0.05 * k) for k in range(3)])
    motions = motion[:, :, None] * random.uniform(0.9, 1.1, LANES)
    steps = random.uniform(0.5, 1.5, (len(motion) - 1, LANES)) / RATE
    begin, at = random.normal(0.0, 0.01, (3, 4)), np.array([0, 7, len(motion) - 1])
    states, pulled = follow(rows, steps, motions, begin, at)
    assert states.shape == (len(motion), 4, 3) and np.array_equal(states[0].T, begin)
    for k, row in enumerate(rows):
        own = follow(row[None], steps[:, k], motions[:, :, k], begin[k:k + 1], at)
        assert states[:, :, k] == pytest.approx(own[0][:, :, 0], rel=1e-12, abs=1e-12)
        assert pulled[:, :, k] == pytest.approx(own[1][:, :, 0], rel=1e-12, abs=1e-12)
    assert np.ptp(states[-1], axis=1).max() > 1e-3
