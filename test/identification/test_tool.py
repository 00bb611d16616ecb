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

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from tool_making import (
    ARM, curved, DAMPING, FREQUENCIES, KNOWN, LENGTH, MASS, moves, ONE, PLACE, RATE, recording,
    ring_after, tool_efforts, true_frequencies, TURN)
from tudor_dynamics.arm.description import arm_from_dict
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import FitError, ModelError
from tudor_dynamics.identification.ringdowns import ring_of
from tudor_dynamics.identification.tool import check_efforts, find_moves, fit_tool, Moves
from tudor_dynamics.models.base import read
from tudor_dynamics.models.flexible_tool import Flange, FlexibleTool
from tudor_dynamics.models.still_timing import still_timing

GANTRY = arm_from_dict({
    'name': 'gantry', 'kinematics': {'dh': [
        [0.0, np.pi / 2, 0.0, 0.0], [0.0, np.pi / 2, 0.0, np.pi / 2], [0.0, 0.0, 0.0, 0.0]]},
    'joints': [{'name': f'x{k}', 'type': 'prismatic', 'effort': {
        'topic': 'joint_states', 'unit': 'N'}} for k in range(1, 4)],
    'gravity': [0.0, 0.0, -9.81]}, base=Path(), source='gantry.yaml')


def run(seed: int, count: int = 3) -> Recording:
    """Record random moves of the simulated arm, with its tool."""
    q = moves(seed, count=count, rest=3.5)
    return recording(q, tool_efforts(ARM, q), seed=seed)


def until(moves: Moves, number: int) -> Flange:
    """Give the motion up to a rest."""
    rest, flange = moves.rests[number], moves.flange
    n = int(np.searchsorted(flange.t, rest.t[0])) + 1
    return Flange(flange.t[:n], flange.motion[:n], flange.velocity[:n], rest.jacobian)


def shown(moves: Moves, number: int) -> np.ndarray:
    """Give half the range of efforts in the first period of a rest."""
    rest = moves.rests[number]
    return 0.5 * np.ptp(rest.rings[rest.t < rest.t[0] + 1.0 / FREQUENCIES[0]], axis=0)


@pytest.fixture(scope='module')
def records() -> list[Moves]:
    """Rests of five recordings."""
    return [one for seed in (1, 2, 4, 5, 6) for one in find_moves(ARM, run(seed))]


@pytest.fixture(scope='module')
def tool(records: list[Moves]) -> FlexibleTool:
    """Give the tool of the first two."""
    return fit_tool(ARM, records[:2], 'measured')


def test_frequencies_and_damping(tool: FlexibleTool) -> None:
    """Frequencies are within 1 % of the truth at any pose, the damping ratio within 0.005."""
    random = np.random.default_rng(3)
    for q in random.uniform(-0.6, 0.6, (10, 5)):
        for truth, found in zip(true_frequencies(q), tool.frequency_at(ARM, q), strict=True):
            assert found.value == pytest.approx(truth, rel=0.01)
            assert found.low - 5e-3 * truth <= truth <= found.high + 5e-3 * truth
    assert tool.damping == pytest.approx([DAMPING, DAMPING], abs=0.005)


def test_where_its_mass_is(tool: FlexibleTool) -> None:
    """Mass, place, length and axes are those of the simulation, within their uncertainty."""
    off = np.sqrt(np.diag(tool.covariance))
    apart = tool.parameters - np.array([0.0] * 3 + [*PLACE, *np.log([MASS, LENGTH])] + [0.0] * 4)
    assert (np.abs(apart)[3:8] < 4.0 * off[3:8] + 0.02).all()
    found, truth = pin.exp3(np.array(tool.turn)), pin.exp3(TURN)
    assert found[:, 2] @ truth[:, 2] > 0.999
    slow = found[:, int(np.argmin(tool.frequencies))]  # either plane may be called x
    assert abs(slow @ truth[:, 0]) > 0.995
    assert tool.hidden == [] and tool.scatter < 0.15 and tool.rests >= 6


def test_rings_of_other_motion(tool: FlexibleTool, records: list[Moves]) -> None:
    """Each is predicted within 15 %, and most intervals hold the truth."""
    inside = []
    for one in records[2:]:
        for k, rest in enumerate(one.rests):
            found, truth = tool.ring(until(one, k)), shown(one, k)
            assert found.torque.value == pytest.approx(
                truth[found.loudest], rel=0.15, abs=0.08)
            low, high = found.torque.low - 0.02, found.torque.high + 0.02  # noise
            inside.append(low < truth[found.loudest] < high)
    assert np.mean(inside) > 0.7 and len(inside) > 6


def test_a_trajectory_of_positions(tool: FlexibleTool) -> None:
    """What rings after a trajectory is what a recording of it shows, noise aside."""
    q = moves(13, count=1)
    points = q[::4]
    (one,) = find_moves(ARM, recording(q, tool_efforts(ARM, q)))
    trajectory = Trajectory(ARM.active_joints, np.arange(len(points)) * 4.0 / RATE, points)
    # the trajectory lasts as long as the rest does: it is cut where the arm stops
    stop = int(np.flatnonzero(np.abs(np.diff(points, axis=0)).max(axis=1) > 1e-5)[-1]) + 2
    short = Trajectory(trajectory.joints, trajectory.t[:stop], points[:stop])
    found = tool.ring_after(ARM, short)
    assert found.torque.value == pytest.approx(shown(one, 0)[found.loudest], rel=0.2)
    still = Trajectory(trajectory.joints, np.zeros(1), points[:1])
    assert tool.ring_after(ARM, still).torque.high < 0.01 * found.torque.value


def test_a_timing_for_it(tool: FlexibleTool) -> None:
    """A trajectory that is timed for it leaves it still, and it is said what is left."""
    for seed in range(6, 9):
        wanted = curved(seed)
        found = still_timing(ARM, tool, wanted)
        before, after = (tool.ring_after(ARM, item).torque for item in (wanted, found))
        assert after.value < 0.15 * before.value and after.low <= after.value <= after.high
        assert ring_after(found) < 0.1 * ring_after(wanted)


def test_one_plane_and_rotation_that_moves_do_not_show() -> None:
    """A gantry does not turn its tool, which bends in one plane."""
    n, random = int(5.5 * RATE), np.random.default_rng(0)
    t = np.arange(n) / RATE
    found = []
    for _ in range(3):
        s = np.clip((t - 0.5) / 0.8, 0.0, 1.0)[:, None]
        q = s**3 * (10.0 - s * (15.0 - 6.0 * s)) * random.uniform(-0.5, 0.5, 3)
        found += find_moves(GANTRY, recording(q, tool_efforts(GANTRY, q, frequencies=ONE)))
    tool = fit_tool(GANTRY, found, 'planned')
    assert tool.hidden == ['rotation'] and len(tool.frequencies) == 1
    ring = tool.ring(until(found[0], 0)).torque
    assert ring.value == pytest.approx(shown(found[0], 0).max(), rel=0.15)
    assert read(FlexibleTool, tool.model_dump()) == tool


def test_planned_motion_and_a_rest_that_ends(records: list[Moves]) -> None:
    """A recording of the reference replaces the measured motion; rests end before motion."""
    own = run(1)
    (one,) = find_moves(ARM, own, own)
    assert np.allclose(one.flange.motion, records[0].flange.motion, atol=1e-6)
    speed = np.abs(np.gradient(own.q, 1.0 / RATE, axis=0)).max(axis=1)
    for rest in one.rests:
        inside = (own.t >= rest.t[0]) & (own.t <= rest.t[-1] + 0.2)
        assert speed[inside].max() < 1e-3


def test_rings_that_nothing_was_learned_from_err_more() -> None:
    """By what the rests scatter where they were pushed alike, by half of it where never."""
    seen = np.diag([3.0, 3.0, 3.0, 0.0, 0.0, 0.0]).tolist()
    tool = KNOWN.model_copy(update={'pushed': seen, 'scatter': 0.1})
    t = np.arange(0.0, 2.0, 0.01)

    def error(column: int) -> float:
        motion = np.zeros((len(t), 12))
        motion[:, column] = np.sin(2.0 * np.pi * tool.frequencies[0] * t)
        return tool.error_of(Flange(t, motion, np.zeros((len(t), 3)), np.zeros((6, 5))))
    assert 0.1 < error(0) < 0.13 and error(4) == pytest.approx(np.hypot(0.1, 0.5))
    assert error(0) < tool.error_of(Flange(t, np.tile(
        np.sin(2.0 * np.pi * tool.frequencies[0] * t)[:, None], 12), np.zeros((len(t), 3)),
        np.zeros((6, 5)))) < error(4)


def test_nothing_that_rings_and_efforts_in_ampere() -> None:
    """They are refused, with what is needed."""
    q = moves(1, count=2)
    own = find_moves(ARM, recording(q, np.zeros_like(q)))
    with pytest.raises(FitError, match='have 2 rests after a motion, but .* needs 3'):
        fit_tool(ARM, own, 'measured')
    assert ring_of(own[0].rests[0].t, own[0].rests[0].effort) is None
    ampere = ARM.changed(joints=tuple(joint.model_copy(update={
        'effort': joint.effort.model_copy(update={'unit': 'A'})}) for joint in ARM.spec.joints))
    with pytest.raises(FitError, match="'j4', 'j5' are in A, but the model"):
        check_efforts(ampere)


@pytest.mark.parametrize(('change', 'says'), [
    ({'damping': [7.0]}, 'damping: expected one ratio'), ({'rests': 0}, 'rests'),
    ({'frequencies': [-1.0, 2.0]}, 'frequencies'), ({'mass': 0.0}, 'mass'),
    ({'covariance': [[1.0]]}, 'covariance: expected a covariance of 12'),
    ({'covariance': (-np.eye(12)).tolist()}, 'expected a covariance of 12'),
    ({'place': [float('nan')] * 3}, 'place'), ({'pushed': [[1.0]]}, 'pushed')])
def test_what_is_no_tool(change: dict[str, object], says: str) -> None:
    """Values that cannot be are refused by name."""
    assert read(FlexibleTool, KNOWN.model_dump()) == KNOWN
    with pytest.raises(ModelError, match=says):
        read(FlexibleTool, {**KNOWN.model_dump(), **change})


def test_a_second_plane_whose_peak_hides() -> None:
    """Two planes of 1.3 and 2.1 Hz are found, where the spectrum shows the first alone."""
    found = []
    for seed in (1, 2):
        q = moves(seed, count=2, rest=3.5)
        effort = tool_efforts(ARM, q, frequencies=(1.3, 2.1))
        found += find_moves(ARM, recording(q, effort, noise=0.05, seed=seed))
    tool = fit_tool(ARM, found, 'measured')
    assert sorted(tool.frequencies) == pytest.approx([1.3, 2.1], rel=0.01)
    assert tool.damping == pytest.approx([DAMPING, DAMPING], abs=0.005)


class Yielding:
    """Efforts that accelerate the arm."""

    def predict(self, motion: np.ndarray) -> np.ndarray:
        """Predict them of positions, velocities and accelerations."""
        return motion[:, 10:] @ (4.0 * np.eye(5) + 2.0) + 3.0 * np.cos(motion[:, :5])


def test_an_arm_that_yields() -> None:
    """Efforts that accelerate an arm, which its tool shakes, are no pull of the tool."""
    q = moves(4, count=1)
    effort = tool_efforts(ARM, q)
    t = np.arange(len(q)) / RATE
    shaken = 3e-4 * np.sin(2.0 * np.pi * 3.0 * t)[:, None] * np.array([1.0, -0.5, 0.2, 0.7, 0.3])
    ddq = np.gradient(np.gradient(q + shaken, 1.0 / RATE, axis=0), 1.0 / RATE, axis=0)
    model = Yielding()
    felt = effort + model.predict(np.hstack([q + shaken, 0.0 * q, ddq]))
    (clean,), (raw,), (found,) = (find_moves(ARM, *args)[0].rests for args in (
        (recording(q, effort, noise=0.0),), (recording(q + shaken, felt, noise=0.0),),
        (recording(q + shaken, felt, noise=0.0), None, model)))
    size = np.abs(clean.rings).max()
    assert np.abs(raw.rings - clean.rings).max() > 0.3 * size
    assert np.abs(found.rings - clean.rings).max() < 0.1 * size
