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

"""A flexible tool that is identified from its rings predicts others, and says what it does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tool_making import (
    ARM, DAMPING, FREQUENCY, GRAVITY, moves, PARTICIPATION, RATE, recording, tool_efforts)
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import FitError, ModelError
from tudor_dynamics.identification.tool import check_efforts, find_rests, fit_tool, Rest
from tudor_dynamics.models.base import read
from tudor_dynamics.models.flexible_tool import flange_motion, FlexibleTool
from tudor_dynamics.signals.filters import zero_phase

GANTRY = arm_from_dict({
    'name': 'gantry', 'kinematics': {'dh': [
        [0.0, np.pi / 2, 0.0, 0.0], [0.0, np.pi / 2, 0.0, np.pi / 2], [0.0, 0.0, 0.0, 0.0]]},
    'joints': [{'name': f'x{k}', 'type': 'prismatic', 'effort': {
        'topic': 'joint_states', 'unit': 'N'}} for k in range(1, 4)],
    'gravity': [0.0, 0.0, -9.81]}, base=Path(), source='gantry.yaml')


def run(seed: int, count: int = 3) -> Recording:
    """Record random moves of the simulated arm, with its tool."""
    q = moves(seed, count=count)
    return recording(q, tool_efforts(ARM, q), seed=seed)


@pytest.fixture(scope='module')
def rests() -> list[list[Rest]]:
    """Rests of seven recordings."""
    return [find_rests(ARM, run(seed)) for seed in range(1, 8)]


@pytest.fixture(scope='module')
def tool(rests: list[list[Rest]]) -> FlexibleTool:
    """Give the tool of the first four."""
    return fit_tool(ARM, [rest for found in rests[:4] for rest in found], 'measured')


def test_frequency_and_damping(tool: FlexibleTool) -> None:
    """The frequency is within 1 % of the truth at any pose, the damping ratio within 0.005."""
    random = np.random.default_rng(3)
    for q in random.uniform(-0.6, 0.6, (10, 5)):
        still = np.zeros((4, 5))
        gravity = flange_motion(ARM, np.arange(4.0), zero_phase(
            np.arange(4.0), still + q, 0.1)).gravity[-1]
        truth = float(np.sqrt(FREQUENCY**2 + GRAVITY @ gravity))
        found = tool.frequency_at(ARM, q)
        assert found.value == pytest.approx(truth, rel=0.01)
        assert found.low - 1e-3 * truth <= truth <= found.high + 1e-3 * truth
    assert tool.damping == pytest.approx(DAMPING, abs=0.005)
    assert 0.0 < tool.damping_error < 0.005


def test_participation(tool: FlexibleTool) -> None:
    """It is that of the simulation, but for its sign."""
    off = np.sqrt(np.diag(tool.participation_covariance))
    apart = np.sign(tool.participation[1]) * np.array(tool.participation) - PARTICIPATION
    assert (np.abs(apart) < 3.0 * off + 0.005).all()
    assert tool.hidden == [] and tool.scatter < 0.15


def test_rings_of_other_motion(tool: FlexibleTool, rests: list[list[Rest]]) -> None:
    """Each is predicted within 15 %, and its interval holds the truth."""
    others = [rest for found in rests[4:] for rest in found if rest.ring is not None]
    assert len(others) > 4
    for rest in others:
        found = tool.ring(rest.flange)
        assert rest.ring is not None
        truth = float(abs(rest.ring.amplitude[found.loudest]))
        assert found.torque.value == pytest.approx(truth, rel=0.15)
        assert found.torque.low <= truth <= found.torque.high
        assert found.mode.low < found.mode.value < found.mode.high


def test_a_trajectory_of_positions(tool: FlexibleTool) -> None:
    """What rings after a trajectory is what a recording of it shows, noise aside."""
    q = moves(13, count=1)
    points = q[::4]
    (rest,) = find_rests(ARM, recording(q, tool_efforts(ARM, q)))
    assert rest.ring is not None
    trajectory = Trajectory(ARM.active_joints, np.arange(len(points)) * 4.0 / RATE, points)
    # the trajectory lasts as long as the rest does: it is cut where the arm stops
    stop = int(np.flatnonzero(np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-5)[-1]) + 2
    short = Trajectory(trajectory.joints, trajectory.t[:stop], points[:stop])
    found = tool.ring_after(ARM, short)
    assert found.torque.value == pytest.approx(
        float(abs(rest.ring.amplitude[found.loudest])), rel=0.2)
    still = Trajectory(trajectory.joints, np.zeros(1), points[:1])
    assert tool.ring_after(ARM, still).torque.high < 0.01 * found.torque.value


def test_rotation_that_moves_do_not_show() -> None:
    """A gantry does not turn its tool."""
    n, random = int(7.0 * RATE), np.random.default_rng(0)
    t = np.arange(n) / RATE
    found = []
    for _ in range(6):
        s = np.clip((t - 0.5) / 0.8, 0.0, 1.0)[:, None]
        q = s**3 * (10.0 - s * (15.0 - 6.0 * s)) * random.uniform(-0.5, 0.5, 3)
        found += find_rests(GANTRY, recording(q, tool_efforts(GANTRY, q)))
    tool = fit_tool(GANTRY, found, 'planned')
    assert tool.hidden == ['rotation']
    ring = found[0].ring
    assert ring is not None
    assert tool.ring(found[0].flange).torque.value == pytest.approx(
        float(np.abs(ring.amplitude).max()), rel=0.15)
    # a motion that turns it is less sure, by the size of what is expected of rotation
    turned = found[0].flange.acceleration.copy()
    turned[:, 3:] = 20.0 * turned[:, :3]
    flange = replace(found[0].flange, acceleration=turned)
    one, other = (tool.ring(item).torque for item in (found[0].flange, flange))
    assert (other.high - other.low) / other.value > 3.0 * (one.high - one.low) / one.value


def test_planned_motion(rests: list[list[Rest]]) -> None:
    """A recording of the reference takes the place of the measured motion."""
    own = run(1)
    (first, *_) = find_rests(ARM, own, own)
    assert np.allclose(first.flange.acceleration, rests[0][0].flange.acceleration, atol=1e-6)


def test_too_few_rings_and_efforts_in_ampere(rests: list[list[Rest]]) -> None:
    """They are refused, with what is needed."""
    with pytest.raises(FitError, match='0 rests have a clear ring; a flexible tool needs 3'):
        fit_tool(ARM, rests[0][:1], 'measured')
    ampere = ARM.changed(joints=tuple(joint.model_copy(update={
        'effort': joint.effort.model_copy(update={'unit': 'A'})}) for joint in ARM.spec.joints))
    with pytest.raises(FitError, match='those of j1, j2, j3, j4, j5 are in A; remove vibration'):
        check_efforts(ampere)


@pytest.mark.parametrize(('change', 'says'), [
    ({'damping': 7.0}, 'damping'), ({'rings': 0}, 'rings'), ({'squares': [1.0]}, 'squares'),
    ({'squares': [-1.0, 0.0, 0.0, 0.0]}, 'no square of a frequency'),
    ({'squares_covariance': [[1.0]]}, 'squares_covariance: expected a covariance of 4'),
    ({'squares_covariance': (-np.eye(4)).tolist()}, 'expected a covariance of 4'),
    ({'participation': [float('nan')] * 6}, 'participation'), ({'hidden': ['all']}, 'hidden')])
def test_what_is_no_tool(change: dict[str, object], says: str, tool: FlexibleTool) -> None:
    """Values that cannot be are refused by name."""
    assert read(FlexibleTool, tool.model_dump()) == tool
    with pytest.raises(ModelError, match=says):
        read(FlexibleTool, {**tool.model_dump(), **change})
