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

"""Trajectories: the splines of joint_trajectory_controller, and what is held at the end."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
from numpy.polynomial import Polynomial
import pytest
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.errors import SignalError
from tudor_dynamics.signals.motion_profile import denser, states

JOINTS = ('a', 'b')
T = np.array([0.0, 0.5, 1.1, 2.0])
NUMBERS = st.floats(-3.0, 3.0)


def along(curves: list[Polynomial], order: int, t: np.ndarray = T) -> np.ndarray:
    """Evaluate a derivative of polynomials."""
    return np.column_stack([curve.deriv(order)(t) if order else curve(t) for curve in curves])


@settings(max_examples=30, deadline=None)
@given(arrays(float, (2, 6), elements=NUMBERS))
def test_a_quintic_is_what_three_fields_say(coefficients: np.ndarray) -> None:
    """Points of a polynomial of degree five give that polynomial between them."""
    curves = [Polynomial(row) for row in coefficients]
    path = Trajectory(JOINTS, T, *(along(curves, order) for order in range(3)))
    more = denser(path, 20.0)
    for order, found in enumerate((more.q, more.dq, more.ddq)):
        assert found == pytest.approx(along(curves, order, more.t), abs=1e-8)


@settings(max_examples=30, deadline=None)
@given(arrays(float, (2, 4), elements=NUMBERS))
def test_a_cubic_is_what_two_fields_say(coefficients: np.ndarray) -> None:
    """Accelerations between the ends are those of the cubics; they rest before and after."""
    curves = [Polynomial(row) for row in coefficients]
    path = Trajectory(JOINTS, T, along(curves, 0), along(curves, 1))
    motion = states(path)
    assert motion[1:-1, 4:] == pytest.approx(along(curves, 2)[1:-1], abs=1e-5)
    assert not motion[[0, -1], 4:].any()
    assert np.array_equal(motion[:, 2:4], path.dq)


def test_straight_lines_have_the_mean_of_both_slopes() -> None:
    """One effort stands for both sides of a corner; a held end is at rest."""
    q = np.array([[0.0, 1.0], [1.0, 1.0], [1.6, -0.2], [1.6, -0.2]])
    motion = states(Trajectory(JOINTS, T, q))
    assert motion[:, 2:4] == pytest.approx(
        np.array([[0.0, 0.0], [1.5, -1.0], [0.5, -1.0], [0.0, 0.0]]))
    assert not motion[:, 4:].any()
    lines = denser(Trajectory(JOINTS, T, q), 100.0)
    assert lines.dq is not None and lines.ddq is not None
    assert lines.dq[10] == pytest.approx([2.0, 0.0]) and not lines.ddq.any()
    assert not lines.dq[[0, -1]].any()


def test_given_fields_are_kept() -> None:
    """What a planner says is not corrected, be it at an end."""
    q = np.zeros((2, 2))
    path = Trajectory(JOINTS, T[:2], q, q + 0.3, q - 2.0)
    assert np.array_equal(states(path), np.hstack([path.q, path.dq, path.ddq]))
    one = Trajectory(JOINTS, T[:1], q[:1])
    assert np.array_equal(states(one), np.zeros((1, 6)))
    assert denser(one, 100.0) is one


def test_fields_that_a_point_leaves_empty_are_not_given() -> None:
    """As for the controller, which then lays a spline of lower order."""
    rows = [[0.0, 1.0], [1.0, 2.0]]
    path = Trajectory.from_points(JOINTS, T[:2], rows, [[0.0, 0.0], []], rows)
    assert path.dq is None and path.ddq is None
    path = Trajectory.from_points(JOINTS, T[:2], rows, rows, [[], []])
    assert np.array_equal(path.dq, rows) and path.ddq is None


@pytest.mark.parametrize(('change', 'words'), [
    ({'t': np.array([0.0, 0.5, 0.5, 1.0])}, 'time does not increase after point 2'),
    ({'t': np.array([0.0, 0.5, np.nan, 1.0])}, 'time does not increase'),
    ({'q': np.zeros((4, 3))}, 'positions have the shape'),
    ({'dq': np.full((4, 2), np.inf)}, "the velocities of point 1 of 4 have inf for 'a'"),
    ({'ddq': np.zeros((4, 2))}, 'accelerations without velocities'),
    ({'t': np.zeros(0), 'q': np.zeros((0, 2))}, 'no points')])
def test_what_is_no_trajectory_is_refused(change: dict[str, np.ndarray], words: str) -> None:
    """In one line that says what and where."""
    with pytest.raises(SignalError, match=words):
        Trajectory(**{'joints': JOINTS, 't': T, 'q': np.zeros((4, 2)), **change})


def test_joints_go_by_name() -> None:
    """In any order; what is missing or there twice is refused."""
    path = Trajectory(('b', 'c', 'a'), T[:1], np.array([[1.0, 2.0, 3.0]]))
    assert np.array_equal(path.of(JOINTS).q, [[3.0, 1.0]])
    with pytest.raises(SignalError, match="joint 'd' is missing"):
        path.of(('a', 'd'))
    with pytest.raises(SignalError, match='point 1 of 1 has 1 of 2 positions, one for each joint'):
        Trajectory.from_points(JOINTS, T[:1], [[1.0]], [[]], [[]])
    with pytest.raises(SignalError, match='lower it, as 2 s can have at most'):
        denser(Trajectory(JOINTS, T, np.zeros((4, 2))), 1e9)
