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

"""The action FollowJointTrajectory of reference_generator."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Duration
from generator_making import BEGUN, Generator, point, POSE, trajectory
import numpy as np
import pytest
from rclpy.action import ActionClient
from ros_world import JOINTS, World

WAY = point(0.5, 0.9, 0.1), point(1.0, 1.0, 0.2)


class Client:
    """A client of the action, and what it hears."""

    def __init__(self, world: World, root: Path, **values: Any) -> None:
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTolerance
        self.world, self.kind, self._tolerance = world, FollowJointTrajectory, JointTolerance
        self.arm = Generator(world, root / 'config/tudor.yaml', **values)
        self.client = ActionClient(
            world.probe, FollowJointTrajectory, 'reference_generator/follow_joint_trajectory')
        self.feedback: list[Any] = []
        assert world.spin(self.client.server_is_ready)
        self.arm.run(5)

    def tolerance(self, **values: Any) -> Any:
        """Make a tolerance of a joint."""
        return self._tolerance(**values)

    def send(self, *points: Any, stamp: int = 0, names: list[str] = JOINTS, **more: Any) -> Any:
        """Send a goal, and give it once it is accepted."""
        goal = self.kind.Goal(trajectory=trajectory(*points, stamp=stamp, names=names), **more)
        future = self.client.send_goal_async(goal, feedback_callback=self.feedback.append)
        assert self.world.spin(future.done)
        assert future.result().accepted
        return future.result()

    def result(self, goal: Any) -> tuple[int, int, str]:
        """Wait for the result: status, code and words."""
        future = goal.get_result_async()
        assert self.world.spin(future.done)
        found = future.result()
        return found.status, found.result.error_code, found.result.error_string


@pytest.fixture
def client(world: World, root: Path, control_msgs: None) -> Any:
    """Give a client of a generator that rests."""
    made = Client(world, root)
    yield made
    made.client.destroy()


def test_a_goal_is_driven(client: Client) -> None:
    """Accepted, executed, with feedback on the way, and a result when the arm is there."""
    goal = client.send(*WAY)
    client.arm.run(25)
    assert client.world.spin(lambda: bool(client.feedback) and np.allclose(
        client.feedback[-1].feedback.desired.positions, [0.9, 0.1], atol=1e-6))
    last = client.feedback[-1].feedback
    assert list(last.joint_names) == JOINTS
    np.testing.assert_allclose(
        last.error.positions, np.subtract(last.desired.positions, last.actual.positions))
    assert goal.status == GoalStatus.STATUS_EXECUTING
    assert client.arm.run(30)[-1] == pytest.approx([1.0, 0.2])
    assert client.result(goal) == (GoalStatus.STATUS_SUCCEEDED, 0, 'reached')


def test_one_point_is_a_smooth_move(client: Client) -> None:
    """It succeeds when the move has ended."""
    goal = client.send(point(0.1, 1.2, 0.1))
    client.arm.run(30)
    future = goal.get_result_async()
    client.world.rest(0.2)
    assert not future.done()
    client.arm.run(60)
    assert client.result(goal)[1:] == (0, 'reached')


def test_cancel_brakes(client: Client) -> None:
    """The reference comes to rest on its way, and the goal is canceled."""
    goal = client.send(point(1.0, 1.2, 0.1), point(3.0, 1.6, 0.1))
    client.arm.run(30)
    future = goal.cancel_goal_async()
    assert client.world.spin(future.done)
    assert client.result(goal) == (GoalStatus.STATUS_CANCELED, -1, 'stopped: canceled')
    rows = client.arm.run(60)
    assert rows[-1] == pytest.approx(rows[-2]) and 0.9 < rows[-1][0] < 1.2


def test_a_new_goal_or_message_takes_over(client: Client) -> None:
    """The goal before is aborted and says what took over; a refused goal ends nothing."""
    first = client.send(point(1.0, 1.2, 0.1), point(3.0, 1.6, 0.1))
    client.arm.run(10)
    wrong = client.send(point(1.0, 9.0, 0.1), point(3.0, 9.0, 0.1))
    assert client.result(wrong)[1] == -1
    second = client.send(*WAY)
    assert client.result(first) == (
        GoalStatus.STATUS_ABORTED, -1, 'a newer goal replaced this one')
    client.arm.run(10)
    client.arm.goals.publish(trajectory(*WAY))
    assert client.result(second) == (
        GoalStatus.STATUS_ABORTED, -1, 'a newer trajectory on joint_trajectory replaced this goal')
    third = client.send(*WAY)
    client.arm.run(10)
    client.arm.goals.publish(trajectory())
    assert client.result(third)[1:] == (
        -1, 'stopped: a trajectory without points came on joint_trajectory')


REFUSED: dict[str, tuple[Any, dict[str, Any], int, str]] = {
    'no points': ((), {}, -1, 'the trajectory has no points'),
    'unknown joint': ((point(1.0, 0.9, 0.1), point(2.0, 0.9, 0.1)),
                      {'names': ['joint2', 'wrist']}, -2,
                      'wrong joints, unknown: wrist; the joints are joint2, joint3'),
    'all over': (WAY, {'stamp': BEGUN - 5 * 10**9}, -3,
                 'all points are in the past: the last one was due'),
    'beyond a limit': ((point(20.0, 9.0, 0.1), point(40.0, 0.9, 0.1)), {}, -1,
                       'joint2 reaches position 9, outside'),
    'tolerance of an unknown joint': (
        WAY, {'path_tolerance': {'name': 'wrist', 'position': 0.1}}, -2,
        "wrong joints: path_tolerance has the unknown joint 'wrist'"),
    'tolerance of a speed': (
        WAY, {'goal_tolerance': {'name': 'joint2', 'velocity': 0.1}}, -1,
        "goal_tolerance of 'joint2' has a velocity or acceleration, but"),
    'several degrees of freedom': (
        WAY, {'component_path_tolerance': []}, -2,
        'wrong joints: the arm has no multi-DOF joints'),
    'impossible tolerance': (
        WAY, {'goal_tolerance': {'name': 'joint2', 'position': -2.0}}, -1,
        "goal_tolerance of 'joint2' has the position -2; give a bound above 0 [rad or m], 0 for "
        'the default, or -1 for none')}


def test_refusals_have_code_and_reason(client: Client) -> None:
    """Each is aborted at once, and nothing moves."""
    for name, (points, more, code, text) in REFUSED.items():
        if 'component_path_tolerance' in more:
            from control_msgs.msg import JointComponentTolerance
            more['component_path_tolerance'] = [JointComponentTolerance()]
        for key in more.keys() & {'path_tolerance', 'goal_tolerance'}:
            more[key] = [client.tolerance(**more[key])]
        status, found, words = client.result(client.send(*points, **more))
        assert (status, found) == (GoalStatus.STATUS_ABORTED, code), name
        assert words.startswith(text), name
    assert client.arm.run(20)[-1] == pytest.approx(POSE)


def test_tolerances_of_a_goal(client: Client) -> None:
    """They take the place of the parameters, joint by joint, for this goal alone."""
    client.arm.follows = False  # it stays where it is, and is off soon
    goal = client.send(*WAY, path_tolerance=[client.tolerance(name='joint2', position=0.02)])
    client.arm.run(30)
    status, code, text = client.result(goal)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, -4)
    assert text.startswith("off the path: 'joint2' is 0.02")
    client.arm.run(40)
    goal = client.send(point(0.5, 0.81, 0.1), point(1.0, 0.82, 0.1),
                       goal_tolerance=[client.tolerance(name='joint2', position=0.01)],
                       goal_time_tolerance=Duration(nanosec=200_000_000))
    client.arm.run(70)
    status, code, text = client.result(goal)
    assert (status, code) == (GoalStatus.STATUS_ABORTED, -5)
    assert text == (
        "missed the goal: 0.2 s after the end 'joint2' is 0.02 rad away (tolerance 0.01); "
        'see the diagnostics of oscillation_damper')
    goal = client.send(point(0.5, 0.83, 0.1), point(1.0, 0.82, 0.1))
    client.arm.run(60)
    assert client.result(goal)[1:] == (0, 'reached')


def test_inactive(client: Client) -> None:
    """Deactivation ends a goal; then goals are refused, with the reason."""
    goal = client.send(point(1.0, 1.2, 0.1), point(3.0, 1.6, 0.1))
    client.arm.run(10)
    client.arm.node.trigger_deactivate()
    assert client.result(goal)[1:] == (-1, 'stopped: reference_generator was deactivated')
    assert client.result(client.send(*WAY))[1:] == (-1, 'reference_generator is inactive')


def test_no_action_without_its_package(world: World, root: Path) -> None:
    """Without ``control_msgs`` all but the action is there."""
    pytest.importorskip('rclpy')
    try:
        import control_msgs  # noqa: F401
    except ImportError:
        assert Generator(world, root / 'config/tudor.yaml').node.server.action is None
