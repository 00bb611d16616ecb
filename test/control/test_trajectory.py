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

"""Trajectories through points in time: what is driven, what takes over, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.interpolate import BPoly
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.control import trajectory as driven
from tudor_dynamics.control.references import ReferenceSource, Tolerances
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.filters import MotionState
from tudor_dynamics.signals.motion_profile import spline

DT = 0.01
POSE = np.array([1.0, 0.2])
JOINTS = ('joint2', 'joint3')


class Driver:
    """A source of references with an arm that is where its reference was, or off by some."""

    def __init__(self, root: Path) -> None:
        self.source = ReferenceSource(load_arm(root / 'config/tudor.yaml'))
        self.k, self.off = 0, np.zeros(2)
        self.run(0.05)

    @property
    def q(self) -> np.ndarray:
        """Give the reference, or the pose before there is one."""
        return POSE if self.source.q is None else self.source.q

    def run(self, seconds: float) -> np.ndarray:
        """Let time pass; give positions and speeds of the reference at the steps."""
        rows = []
        for _ in range(round(seconds / DT)):
            self.k += 1
            self.source.measured(DT * self.k, self.q + self.off)
            q, dq = self.source.step(DT * self.k, DT)
            rows.append([*q, *dq])
        return np.array(rows)


@pytest.fixture
def driver(root: Path) -> Driver:
    """Give a reference that rests at the pose."""
    return Driver(root)


def points(times: list[float], *moved: Any, joints: tuple[str, ...] = JOINTS, **more: Any,
           ) -> Trajectory:
    """Make a trajectory by what the joints have moved from the pose."""
    places = np.array([[name == joint for joint in JOINTS] for name in joints], dtype=float)
    q = np.array(moved, dtype=float).reshape(len(times), -1) + POSE @ places.T
    return Trajectory(joints, np.array(times), q, **{
        name: np.array(values, dtype=float) for name, values in more.items()})


@pytest.mark.parametrize(('more', 'middle'), [
    ({}, 0.1), ({'dq': [[0.3, 0.0], [0.0, 0.0]]}, 0.1 - 0.3 / 8.0),
    ({'dq': [[0.3, 0.0], [0.0, 0.0]], 'ddq': [[0.5, 0.0], [0.0, 0.0]]},
     0.1 - 0.3 * 5.0 / 32.0 + 0.5 / 64.0)])
def test_straight_cubic_and_quintic(driver: Driver, more: dict, middle: float) -> None:
    """
    By what is given, as the polynomials have it in the middle of the first second.

    Of a cubic (p0 + p1) / 2 + T (v0 - v1) / 8, of a quintic 5/32 instead of 1/8, and
    T^2 (a0 + a1) / 64.
    """
    assert driver.source.take(points([1.0, 2.0], [0.2, 0.0], [0.3, 0.0], **more)) == ''
    rows = driver.run(2.5)
    assert rows[49, :2] == pytest.approx(POSE + [middle, 0.0])
    assert rows[99, :2] == pytest.approx(POSE + [0.2, 0.0])
    assert rows[-1] == pytest.approx([*(POSE + [0.3, 0.0]), 0.0, 0.0])
    assert driver.source.outcome == 'reached'


def test_one_point_is_a_smooth_move(driver: Driver) -> None:
    """Its time does not count; joints that it does not name stay."""
    assert driver.source.take(points([9.0], [0.3], joints=('joint2',))) == ''
    rows = driver.run(3.0)
    assert rows[-1, :2] == pytest.approx(POSE + [0.3, 0.0])
    assert np.abs(np.diff(rows[:, 2])).max() < 0.05


def test_starts_later_and_goes_on_until_then(driver: Driver) -> None:
    """A trajectory to come leaves what is driven alone, and takes over at its start."""
    source = driver.source
    assert source.take(points([1.0, 2.0], [0.2, 0.0], [0.4, 0.0])) == ''
    assert source.take(points([1.0, 2.0], [0.1, 0.1], [0.0, 0.2]), since=-1.0) == ''
    assert source.motion is not None and source.motion.follower.progress == (0.0, 2.0)
    rows = driver.run(3.5)
    assert rows[99, :2] == pytest.approx(POSE + [0.2, 0.0])  # still along the first
    assert rows[199, :2] == pytest.approx(POSE + [0.1, 0.1])
    assert rows[-1, :2] == pytest.approx(POSE + [0.0, 0.2])


def test_points_that_are_over_are_left_out(driver: Driver) -> None:
    """Half a second late it goes straight to the point that is due next."""
    late = points([0.4, 1.0, 2.0], [0.4, 0.0], [0.1, 0.0], [0.2, 0.0])
    assert driver.source.take(late, since=0.5) == ''
    rows = driver.run(2.0)
    assert rows[49, :2] == pytest.approx(POSE + [0.1, 0.0])
    assert rows[:, 0].max() < POSE[0] + 0.2 + 1e-9
    assert 'all points are in the past' in driver.source.take(late, since=2.5)


def test_a_new_one_takes_over_with_the_speed(driver: Driver) -> None:
    """No jump in position or speed where cubics meet, also from a smooth move."""
    still = {'dq': [[0.0, 0.0], [0.0, 0.0]]}
    driver.source.go(POSE + [0.5, 0.0])
    before = driver.run(0.4)
    assert driver.source.take(points([0.8, 1.5], [0.3, 0.0], [0.2, 0.0], **still)) == ''
    middle = driver.run(0.4)
    assert driver.source.take(points([0.8, 1.5], [0.1, 0.1], [0.0, 0.2], **still)) == ''
    rows = np.vstack([before, middle, driver.run(2.0)])
    assert np.abs(np.diff(rows[:, 2:], axis=0)).max() < 0.1
    assert np.allclose(np.diff(rows[:, :2], axis=0), 0.5 * DT * (rows[1:, 2:] + rows[:-1, 2:]),
                       atol=1e-3)


def test_empty_ones_and_collisions_brake(driver: Driver) -> None:
    """The reference comes to rest before the trajectory would, and stays there."""
    for stop in (lambda: driver.source.stop('asked'), lambda: driver.source.collide(True)):
        assert driver.source.take(points([1.0, 5.0], [0.3, 0.0], [0.3, 0.3])) == ''
        driver.run(0.5)
        stop()
        rows = driver.run(1.0)
        assert driver.source.outcome.startswith('stopped')
        assert not rows[-1, 2:].any() or driver.source.reacting
        assert np.abs(rows[:, 0] - POSE[0]).max() < 0.25
        driver.source.clear()
        driver.source.go(POSE)
        driver.run(3.0)


WRONG = {
    'positions beyond a limit': (points([1, 2, 3], [0.1, 0], [3.0, 0], [0, 0]), 'position'),
    'too fast': (points([0.1, 0.2], [0.6, 0], [0, 0]), 'velocity'),
    'too fast between points': (points(
        [1.0, 1.4], [0, 0], [0.6, 0], dq=[[0, 0], [0, 0]]), 'velocity'),
    'too steep': (points([0.1, 0.2], [0, 0.01], [0, 0.01], dq=[[0, 0], [0, 0]],
                         ddq=[[0, 100.0], [0, 0]]), 'acceleration'),
    'in motion at the end': (points([1, 2], [0.1, 0], [0.2, 0], dq=[[0, 0], [0.1, 0]]),
                             'last point is in motion'),
    'unknown names': (points([1, 2], [0, 0], [0, 0], joints=('joint2', 'wrist')), 'wrist'),
    'double names': (points([1, 2], [0, 0], [0, 0], joints=('joint2', 'joint2')), 'twice')}


@pytest.mark.parametrize('name', WRONG)
def test_wrong_ones_are_refused_before_anything_moves(driver: Driver, name: str) -> None:
    """With the reason; what is driven goes on."""
    trajectory, reason = WRONG[name]
    assert driver.source.take(points([1.0, 2.0], [0.1, 0.0], [0.2, 0.0])) == ''
    assert reason in driver.source.take(trajectory)
    assert driver.run(2.5)[-1, :2] == pytest.approx(POSE + [0.2, 0.0])


def test_a_goal_at_a_limit_is_within_it(driver: Driver) -> None:
    """To single precision, as messages of planners have it."""
    upper = driver.source.hard.upper
    places = np.float32([0.5 * (POSE + upper), upper]).astype(float)
    assert driver.source.take(Trajectory(JOINTS, np.array([2.0, 4.0]), places)) == ''


def test_some_joints_are_held_or_refused(driver: Driver) -> None:
    """By ``allow_partial_joints_goal``."""
    some = points([1.0, 2.0], [0.1], [0.2], joints=('joint3',))
    driver.source.partial = False
    assert 'wrong joints, missing: joint2; the' in driver.source.take(some)
    driver.source.partial = True
    assert driver.source.take(some) == ''
    rows = driver.run(2.5)
    assert rows[-1, :2] == pytest.approx(POSE + [0.0, 0.2]) and np.ptp(rows[:, 0]) < 1e-9


def test_a_later_one_that_does_not_fit_brakes(driver: Driver) -> None:
    """What can only be seen where it begins is seen there: it brakes, and keeps the cause."""
    driver.source.go(POSE + [0.5, 0.0])  # on the way, so that the place at its start is open
    assert driver.source.take(points([0.05, 2.0], [-0.3, 0.0], [0.0, 0.0]), since=-0.5) == ''
    rows = driver.run(2.0)
    assert driver.source.outcome.startswith('not begun: joint2 reaches velocity')
    assert not rows[-1, 2:].any()
    place = driver.q - POSE
    assert driver.source.take(points([1.0, 2.0], place, place + [0.1, 0.0])) == ''
    driver.run(2.5)
    assert driver.source.outcome == 'reached'


def test_tolerances(driver: Driver) -> None:
    """Off the path it stops; off the goal, after a time, it is missed; within, reached."""
    source = driver.source
    source.tolerances = Tolerances(path=0.05)
    assert source.take(points([1.0, 2.0], [0.1, 0.0], [0.2, 0.0])) == ''
    driver.run(0.5)
    driver.off = np.array([0.0, 0.06])
    driver.run(0.5)
    assert source.outcome.startswith("off the path: 'joint3' is 0.06 rad away (tolerance 0.05)")
    source.tolerances = Tolerances(goal=0.03, goal_time=0.3)
    assert source.take(points([1.0, 2.0], [0.1, 0.0], [0.2, 0.0])) == ''
    driver.run(2.2)
    assert source.outcome == ''
    driver.run(0.3)
    assert source.outcome.startswith('missed the goal: 0.3')
    driver.off = np.zeros(2)
    assert source.take(points([1.0, 2.0], [0.1, 0.0], [0.2, 0.0])) == ''
    driver.run(2.2)
    assert source.outcome == 'reached'


def test_spline_is_that_of_scipy() -> None:
    """Piece by piece, with what each point gives."""
    rng = np.random.default_rng(1)
    t, x = np.cumsum(rng.uniform(0.1, 1.0, 6)), rng.normal(size=(3, 6, 2))
    for given_fields in (x[:1], x[:2], x):
        ours = spline(Trajectory(JOINTS, t, *given_fields))
        other = BPoly.from_derivatives(t, np.stack(given_fields, axis=1))
        assert np.allclose(ours.c, other.c, rtol=1e-12, atol=1e-12)


numbers = st.floats(-1.0, 1.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(0.05, 2.0), numbers, numbers, numbers, numbers),
                min_size=2, max_size=6), st.booleans(), st.floats(-0.5, 0.5))
def test_what_is_taken_stays_within_the_limits(
    root: Path, rows: list[tuple[float, ...]], cubic: bool, since: float,
) -> None:
    """Whatever is taken, no reference is beyond a hard limit of position or speed."""
    driver = Driver(root)
    table = np.array(rows)
    dq = 2.0 * table[:, 3:]
    dq[-1] = 0.0
    trajectory = Trajectory(JOINTS, np.cumsum(table[:, 0]), POSE + table[:, 1:3],
                            dq if cubic else None)
    driver.source.take(trajectory, since)
    moved = driver.run(float(trajectory.t[-1]) + 1.0)
    hard = driver.source.hard
    assert (moved[:, :2] >= hard.lower - 1e-5).all() and (moved[:, :2] <= hard.upper + 1e-5).all()
    assert (np.abs(moved[:, 2:]) <= hard.velocity + 1e-5).all()


def test_no_path_without_points_to_come() -> None:
    """An error of its own says how late it is."""
    state = MotionState(*np.zeros((3, 2)))
    with pytest.raises(SignalError, match='due 1 s ago'):
        driven.Path(state, points([1.0, 2.0], [0, 0], [0, 0]), 3.0)
