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

"""Node trajectory_relay before a mirror of a JointTrajectoryController."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from action_msgs.msg import GoalStatus
from controller_mirrors import TrajectoryMirror
from diagnostic_msgs.msg import DiagnosticStatus
from generator_making import point, trajectory
import numpy as np
import pytest
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from ros_world import JOINTS, values_of, World
from sample_arms import random_states
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.flexible_tool import FlexibleTool
from tudor_dynamics.models.regressor import EffortRegressor
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.common.messages import trajectory_of
from tudor_dynamics.nodes.trajectory_relay import TrajectoryRelayNode
from tudor_dynamics.online.feedforward import Feedforward
from tudor_dynamics.signals.motion_profile import spline

POSE = np.array([0.8, 0.1])
MOVEIT = point(0.0, 0.8, 0.1), point(0.3, 0.85, 0.1), point(0.6, 0.9, 0.15)
SMOOTH = point(0.0, 0.8, 0.1), point(1.0, 0.95, 0.15)
LONG = point(0.0, 0.8, 0.1), point(2.0, 1.8, 0.1), point(4.0, 2.4, 0.1)


class Chain:
    """A relay and its controller."""

    def __init__(self, world: World, root: Path, *, newer: bool = False, action: Any = None,
                 **values: Any) -> None:
        self.world = world
        self.controller = world.add(
            lambda parameter_overrides, **how: TrajectoryMirror(  # noqa: ARG005
                list(JOINTS), POSE, newer=newer, action=action, **how))
        self.relay = world.add(TrajectoryRelayNode, arm=str(root / 'config/tudor.yaml'), **values)
        self.output = world.output('joint_trajectory', JointTrajectory)
        self.collision = world.probe.create_publisher(Bool, 'collision', latched())
        world.meet('joint_trajectory')
        assert world.spin(lambda: self.relay._q is not None)

    def send(self, *points: Any, **more: Any) -> None:
        """Send a trajectory, and wait until it was judged."""
        before = self.relay.forwarded, self.relay.drops['refused']
        self.output.publish(trajectory(*points, **more))
        assert self.world.spin(
            lambda: (self.relay.forwarded, self.relay.drops['refused']) != before)

    def moving(self) -> bool:
        """Say whether the arm is well on its way."""
        return bool(self.controller.dq[0] > 0.3)

    def told(self) -> Any:
        """Give the next diagnosis."""
        return self.world.status('trajectory_relay')


def test_it_forwards_what_is_right(world: World, root: Path) -> None:
    """As it came; the arm goes there."""
    chain = Chain(world, root)
    chain.send(*MOVEIT)
    assert world.spin(lambda: bool(chain.controller.taken))
    assert str(chain.controller.taken[0]) == str(trajectory(*MOVEIT))
    assert world.spin(lambda: np.allclose(chain.controller.q, [0.9, 0.15]))
    assert chain.told().message == 'running'
    assert values_of(chain.told())['forwarded'] == '1'


REFUSED: dict[str, tuple[tuple[Any, ...], dict[str, Any], str]] = {
    'beyond a limit': ((point(20.0, 9.0, 0.1), point(30.0, 0.9, 0.1)), {},
                       'joint2 reaches position 9, outside'),
    'too fast': ((point(0.0, 0.8, 0.1), point(0.1, 1.6, 0.1)), {},
                 'joint2 reaches velocity 12, outside'),
    'far from the arm': ((point(0.0, 1.0, 0.1), point(2.0, 1.2, 0.1)), {},
                         "'joint2' is 0.2 rad away from the point that is due, more"),
    'unknown joint': (LONG, {'names': ['joint2', 'wrist']}, 'wrong joints, unknown: wrist'),
    'all over': (LONG, {'stamp': 10**18}, 'all points are in the past'),
    'times': ((point(1.0, 0.8, 0.1), point(1.0, 0.9, 0.1)), {}, 'time does not increase')}


def test_it_refuses_what_is_wrong(world: World, root: Path) -> None:
    """With the reason; nothing reaches the controller, which would obey."""
    chain = Chain(world, root)
    for name, (points, more, text) in REFUSED.items():
        chain.send(*points, **more)
        assert chain.relay.refused.startswith(text), (name, chain.relay.refused)
    status = chain.told()
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith('trajectory refused: time does not increase')
    assert not chain.controller.taken and chain.controller.q == pytest.approx(POSE)


def test_without_positions(world: World, root: Path) -> None:
    """Where the arm is has to be known."""
    chain = Chain(world, root, timeout=0.2)
    chain.controller._timer.cancel()
    world.rest(0.4)
    chain.send(*MOVEIT)
    assert chain.relay.refused == (
        'no joint positions arrive on joint_states; start the driver')


@pytest.mark.parametrize('newer', [False, True])
def test_a_collision_stops_the_controller(world: World, root: Path, newer: bool) -> None:
    """It brakes on the way, also where messages without points are refused; then goals are."""
    chain = Chain(world, root, newer=newer)
    chain.send(*LONG)
    assert world.spin(chain.moving)
    chain.collision.publish(Bool(data=True))
    assert world.spin(lambda: chain.relay.held)
    begun = chain.controller.q[0]
    assert world.spin(lambda: not chain.controller.dq.any(), 3.0)
    # the relay follows in its own time: on a busy machine the arm may be ahead, and comes back
    assert begun - 0.03 < chain.controller.q[0] < begun + 0.4
    assert len(chain.controller.taken) == 2 and not chain.controller.rejected
    place = chain.controller.q
    chain.send(point(0.0, *place), point(1.0, *(place + 0.1)))
    assert chain.relay.refused == (
        'a collision was reported; free the arm and call the service ~/reset')
    assert 'a collision stopped the arm' in chain.told().message
    refused = world.call(Trigger, 'trajectory_relay/reset')
    assert not refused.success and 'still reported' in refused.message
    chain.collision.publish(Bool(data=False))
    assert world.spin(lambda: not chain.relay.collision)
    assert world.call(Trigger, 'trajectory_relay/reset').success
    chain.send(point(0.0, *place), point(1.0, *(place + 0.1)))
    assert chain.relay.refused == ''


def test_no_points_stop(world: World, root: Path) -> None:
    """On the way it brakes; at rest the message goes through."""
    chain = Chain(world, root)
    chain.send(*LONG)
    assert world.spin(chain.moving)
    chain.output.publish(trajectory())
    assert world.spin(lambda: len(chain.controller.taken) == 2)
    assert world.spin(lambda: not chain.controller.dq.any(), 3.0)
    assert len(chain.controller.taken[1].points) == 1
    chain.output.publish(trajectory())
    assert world.spin(lambda: len(chain.controller.taken) == 3)
    assert not chain.controller.taken[2].points


def test_another_leader_is_named(world: World, root: Path) -> None:
    """What it does not know of could move the arm."""
    chain = Chain(world, root)
    world.output('joint_trajectory_controller/joint_trajectory', JointTrajectory)
    assert world.spin(lambda: chain.relay.count_publishers(
        '/joint_trajectory_controller/joint_trajectory') == 2)
    status = world.status('trajectory_relay', lambda status: status.level != DiagnosticStatus.OK)
    assert status.level == DiagnosticStatus.ERROR
    assert status.message.startswith('/probe can also command the controller on /joint_traj')


def test_it_adds_efforts(world: World, root: Path, tmp_path: Path) -> None:
    """Of the bundle, to every point, for all joints."""
    arm, motion = load_arm(root / 'config/tudor.yaml'), random_states(300, 2, 0)
    weights = np.random.default_rng(0).normal(size=(6, 2))
    fitted = AnalyticalModel(EffortRegressor(arm), 2).fit(motion, motion @ weights)
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}}),
                tmp_path / 'model')
    chain = Chain(world, root, model=str(tmp_path / 'model'))
    assert chain.relay.fault == ''
    chain.send(point(0.3, 0.15), point(0.6, 0.2), names=['joint3'])
    assert world.spin(lambda: bool(chain.controller.taken))
    found = chain.controller.taken[0]
    q = np.array([[0.8, 0.15], [0.8, 0.2]])
    wanted = Feedforward(load_bundle(tmp_path / 'model')).along(
        Trajectory(tuple(JOINTS), np.array([0.3, 0.6]), q, np.zeros((2, 2))))
    assert list(found.joint_names) == JOINTS
    np.testing.assert_allclose([p.positions for p in found.points], q)
    np.testing.assert_allclose([p.effort for p in found.points], wanted.effort)


SHAPED = {'shaping': 'zv', 'shaping_frequency': 2.0, 'shaping_damping': 0.05}


def rings(sent: JointTrajectory, *joints: int) -> float:
    """Give what an oscillator on the first joint, or on some, keeps after a motion [rad]."""
    curve = spline(trajectory_of(sent))
    t = np.arange(curve.x[0], curve.x[-1], 1e-4)
    omega, damping = 2.0 * np.pi * 2.0, 0.05
    pole = omega * complex(-damping, np.sqrt(1.0 - damping**2))
    q = curve(t)[:, joints or (0,)].sum(axis=1)
    speed = np.diff(q, prepend=q[0])  # a line jumps in speed, not in place
    return float(abs(speed @ np.exp(pole * (t[-1] - t))))


@pytest.mark.parametrize('first', [0.0, 0.4])
def test_it_shapes(world: World, root: Path, first: float) -> None:
    """Half a period longer, to the same goal, and a mode is at rest there; also the way to it."""
    points = point(first, 0.8 + 0.1 * first, 0.1), point(0.6, 0.9, 0.1), point(1.0, 0.95, 0.15)
    chain = Chain(world, root, **SHAPED)
    chain.send(*points)
    assert world.spin(lambda: bool(chain.controller.taken)) and not chain.relay.not_shaped
    sent = chain.controller.taken[0]
    assert trajectory_of(sent).t[[0, -1]] == pytest.approx([0.0, 1.25], abs=1e-3)
    assert list(sent.points[-1].positions) == [0.95, 0.15] and list(sent.joint_names) == JOINTS
    alone = trajectory(point(0.0, 0.8, 0.1), *points[first == 0.0:])
    assert rings(sent) < 0.01 * rings(alone)
    assert world.spin(lambda: np.allclose(chain.controller.q, [0.95, 0.15]))
    assert values_of(chain.told())['shaping'] == 'zv'


@pytest.mark.parametrize('frequency, said', [
    (2.0, 'still moved'), (0.0, 'frequency of the tool is not known')])
def test_what_cannot_be_shaped(world: World, root: Path, frequency: float, said: str) -> None:
    """It is passed on as it is, and said; or refused, as asked."""
    chain = Chain(world, root, **{**SHAPED, 'shaping_frequency': frequency})
    chain.send(*LONG)
    assert world.spin(chain.moving)
    chain.send(point(2.0, 2.0, 0.1))
    assert world.spin(lambda: len(chain.controller.taken) == 2)
    assert said in chain.relay.not_shaped and len(chain.controller.taken[1].points) == 1
    status = chain.told()
    assert status.level == DiagnosticStatus.WARN
    assert status.message.startswith('trajectory passed on unshaped, as ')
    chain.relay.set_parameters([Parameter('not_shaped', value='refuse')])
    chain.send(point(2.0, 2.1, 0.1))
    assert chain.relay.refused.startswith('it cannot be shaped, as ')
    assert said in chain.relay.refused
    assert len(chain.controller.taken) == 2


@pytest.fixture(scope='module')
def tool_bundle(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give a bundle with a tool that both joints, which turn about one axis, drive alike."""
    path = tmp_path_factory.mktemp('bundle') / 'model'
    arm = load_arm(root / 'config/tudor.yaml')
    save_bundle(ModelBundle(arm, arm.spec.preprocessing, {}, tool=FlexibleTool.model_validate({
        'motion': 'planned', 'rests': 9, 'turn': [0.0, 0.0, 0.0], 'place': [0.0, 0.0, 0.3],
        'mass': 1.0, 'length': 0.3, 'frequencies': [2.0], 'damping': [0.05],
        'covariance': np.diag([1e-6] * 10).tolist(), 'quiet': 0.02, 'scatter': 0.01,
        'pushed': np.eye(6).tolist()})), path)
    return path


@pytest.mark.parametrize('kind', ['timing', 'zv'])
def test_it_shapes_for_a_tool(world: World, root: Path, kind: str, tool_bundle: Path) -> None:
    """The tool of a bundle says how: by timing, or at which frequency impulses follow."""
    chain = Chain(world, root, shaping=kind, tool=str(tool_bundle))
    chain.send(*SMOOTH)
    assert world.spin(lambda: bool(chain.controller.taken)) and not chain.relay.not_shaped
    sent = chain.controller.taken[0]
    assert trajectory_of(sent).t[-1] == pytest.approx(1.25, abs=0.06)
    assert list(sent.points[-1].positions) == [0.95, 0.15]
    assert rings(sent, 0, 1) < 0.05 * rings(trajectory(*SMOOTH), 0, 1)


def test_timing_without_a_tool(world: World, root: Path) -> None:
    """It is passed on, and said what is missing."""
    chain = Chain(world, root, shaping='timing')
    chain.send(*SMOOTH)
    assert world.spin(lambda: bool(chain.controller.taken))
    assert chain.relay.not_shaped.startswith(
        "shaping is timing, but the parameter 'tool' is empty; set it")


class Client:
    """A client of the relay's action."""

    def __init__(self, world: World, root: Path) -> None:
        from control_msgs.action import FollowJointTrajectory
        self.world, self.kind = world, FollowJointTrajectory
        self.chain = Chain(world, root, action=FollowJointTrajectory)
        self.client = ActionClient(
            world.probe, FollowJointTrajectory, 'trajectory_relay/follow_joint_trajectory')
        assert world.spin(self.client.server_is_ready)
        assert world.spin(self.chain.relay._client.server_is_ready)
        self.feedback: list[Any] = []

    def send(self, *points: Any) -> Any:
        """Send a goal."""
        future = self.client.send_goal_async(self.kind.Goal(trajectory=trajectory(*points)),
                                             feedback_callback=self.feedback.append)
        assert self.world.spin(future.done)
        return future.result()

    def result(self, goal: Any) -> tuple[int, int, str]:
        """Wait for the result."""
        future = goal.get_result_async()
        assert self.world.spin(future.done)
        found = future.result()
        return found.status, found.result.error_code, found.result.error_string


def test_by_the_action(world: World, root: Path, control_msgs: None) -> None:
    """Goals, feedback and results go through; refusals, cancel and collisions are its own."""
    client = Client(world, root)
    chain = client.chain
    goal = client.send(*MOVEIT)
    assert client.result(goal) == (GoalStatus.STATUS_SUCCEEDED, 0, 'as the controller says')
    assert list(client.feedback[-1].feedback.joint_names) == JOINTS
    assert chain.controller.q == pytest.approx([0.9, 0.15])
    status, code, text = client.result(client.send(point(20.0, 9.0, 0.1), point(30.0, 0.9, 0.1)))
    assert (status, code) == (GoalStatus.STATUS_ABORTED, -1) and 'position 9' in text
    far = point(2.0, 1.9, 0.15), point(4.0, 2.4, 0.15)
    goal = client.send(*far)
    assert world.spin(chain.moving)
    cancel = goal.cancel_goal_async()
    assert world.spin(cancel.done)
    assert client.result(goal) == (GoalStatus.STATUS_CANCELED, -1, 'stopped: canceled')
    assert world.spin(lambda: not chain.controller.dq.any(), 2.0)
    goal = client.send(*far)
    assert world.spin(chain.moving)
    chain.collision.publish(Bool(data=True))
    assert client.result(goal) == (GoalStatus.STATUS_ABORTED, -1, 'stopped: collision')
    assert world.spin(lambda: not chain.controller.dq.any(), 2.0)
    assert client.result(client.send(*far))[2].startswith('a collision was reported')
    client.client.destroy()


def test_no_action_of_the_controller(world: World, root: Path, control_msgs: None) -> None:
    """A goal for which nobody is there is refused, and says whose action is missing."""
    from control_msgs.action import FollowJointTrajectory
    Chain(world, root)
    client = ActionClient(
        world.probe, FollowJointTrajectory, 'trajectory_relay/follow_joint_trajectory')
    assert world.spin(client.server_is_ready)
    future = client.send_goal_async(FollowJointTrajectory.Goal(trajectory=trajectory(*MOVEIT)))
    assert world.spin(future.done)
    result = future.result().get_result_async()
    assert world.spin(result.done)
    assert result.result().result.error_string == (
        "the controller 'joint_trajectory_controller' offers no action "
        'follow_joint_trajectory; activate it')
    client.destroy()
