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

"""Node reference_generator: where it begins, which goals it takes, and who has to watch."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import Any

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from elastic_making import identified
from generator_making import Generator, PERIOD, point, POSE, trajectory
from geometry_msgs.msg import InertiaStamped
import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_world import JOINTS, values_of, World
from schedule_making import schedule
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.models.bundle import ModelBundle, save_bundle
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.common.messages import nanoseconds
from tudor_dynamics.nodes.reference_generator import ReferenceGeneratorNode
from tudor_dynamics.signals.motion_profile import motion_limits, MotionPlanner
from tudor_dynamics.signals.shaping import Profile

INACTIVE = 'the node is inactive; run `ros2 lifecycle set reference_generator activate`'
GOAL = np.array([1.2, -0.3])


@pytest.fixture
def tudor(root: Path) -> Path:
    """Give a description with limits."""
    return root / 'config/tudor.yaml'


def test_goals_beyond_limits_are_refused(world: World, tudor: Path) -> None:
    """The reference begins at the arm, moves to goals within the limits, and to no others."""
    generator = Generator(world, tudor)
    assert generator.run(10)[0] == pytest.approx(POSE)
    generator.go(np.degrees(GOAL))
    assert generator.node.drops['goal_refused'] == 1
    generator.go(GOAL)
    assert generator.run(120)[-1] == pytest.approx(GOAL)
    assert generator.told().message == 'running'


def test_trajectories_are_driven_and_stopped(world: World, tudor: Path) -> None:
    """Points at their times, from a stamp on; a message without points brakes."""
    generator = Generator(world, tudor)
    generator.run(10)

    def send(stamp: int, *points: JointTrajectoryPoint) -> None:
        generator.goals.publish(trajectory(*points, stamp=stamp, names=JOINTS[::-1]))

    def following() -> bool:
        return generator.node.source.motion.follower.progress is not None
    way = point(0.5, 0.0, 0.9), point(1.0, -0.1, 1.0)
    send(10**18 + PERIOD * (generator.k + 25), *way)  # half a second from now on
    assert world.spin(following)
    rows = generator.run(80)
    assert rows[20] == pytest.approx(POSE)
    # by its time; a busy machine may have lost a sample before
    assert any(row == pytest.approx([0.9, 0.0], abs=1e-6) for row in rows[47:52])
    assert rows[-1] == pytest.approx([1.0, -0.1])
    assert values_of(generator.told())['trajectory'] == 'reached'
    send(0, point(2.0, 0.0, 0.9), point(4.0, 0.5, 1.2))
    assert world.spin(following)
    generator.run(30)
    assert values_of(generator.told())['trajectory'] == '0.6 of 4.0 s'
    send(0)
    assert world.spin(lambda: not following())
    rows = generator.run(40)
    assert rows[-1] == pytest.approx(rows[-2]) and rows[-1][0] > 0.95
    send(0, point(2.0, 0.0, 0.9), point(1.0, 0.5, 1.2))
    assert world.spin(lambda: generator.node.drops['goal_refused'] == 1)


def test_begins_again_where_the_arm_is(world: World, tudor: Path) -> None:
    """An arm that lags is not left: the reference comes back to it, and says so."""
    generator = Generator(world, tudor)
    generator.run(10)
    generator.follows = False
    generator.go(GOAL + [0.6, 0.0])
    seen = generator.run(120)
    assert np.abs(seen - POSE).max() < 0.45
    assert seen[-1] == pytest.approx(POSE)
    assert 'restarted where the arm is' in {
        item.key: item.value for item in generator.told().values}['begun again']


def test_collision_before_the_first_positions(world: World, tudor: Path) -> None:
    """A latched collision is known before any position: no goals until ~/reset, said twice."""
    publisher = world.probe.create_publisher(Bool, 'collision', latched())
    publisher.publish(Bool(data=True))
    generator = Generator(world, tudor)
    assert world.spin(lambda: generator.node.source.collision)
    generator.run(5)
    generator.go(GOAL)
    assert generator.node.drops['goal_refused'] == 1
    status = generator.told()
    assert status.level == DiagnosticStatus.WARN and 'collision' in status.message
    refused = world.call(Trigger, 'reference_generator/reset')
    assert not refused.success and 'still reported' in refused.message
    generator.go(GOAL)
    assert generator.node.drops['goal_refused'] == 2
    assert world.call(Trigger, 'reference_generator/reset').success
    generator.go(GOAL)
    assert generator.run(120)[-1] == pytest.approx(GOAL)


def test_a_live_monitor_is_required(world: World, tudor: Path) -> None:
    """Without, with a blind, a silent, and a living monitor: goals only with the last."""
    generator = Generator(world, tudor, require_monitor=True)
    diagnostics = world.probe.create_publisher(DiagnosticArray, '/diagnostics', 10)
    assert world.spin(lambda: diagnostics.get_subscription_count() > 1)
    generator.run(5)

    def say(level: bytes) -> None:
        heard = len(generator.node._heard), generator.node._heard.get('/probe')
        diagnostics.publish(DiagnosticArray(status=[
            DiagnosticStatus(name='probe: /', level=level)]))
        assert world.spin(lambda: (len(generator.node._heard),
                                   generator.node._heard.get('/probe')) != heard)
        generator.node._look()

    def refused(cause: str) -> None:
        before = generator.node.drops['goal_refused']
        generator.go(GOAL)
        assert generator.node.drops['goal_refused'] == before + 1
        status = generator.told()
        assert status.level == DiagnosticStatus.WARN and cause in status.message
    generator.node._look()
    refused("no node publishes the topic 'collision'")
    publisher = world.probe.create_publisher(Bool, 'collision', latched())
    assert world.spin(lambda: publisher.get_subscription_count() > 0)
    generator.node._look()
    refused('no diagnostics come from')
    say(DiagnosticStatus.STALE)
    refused('cannot detect collisions')
    generator.run(1)
    say(DiagnosticStatus.OK)
    generator.go(GOAL)
    seen = generator.run(40)
    assert np.abs(seen[-1] - POSE).max() > 0.01
    generator.run(150)  # it fell silent
    generator.node._look()
    refused('no diagnostics come from')
    assert generator.node.set_parameters([
        Parameter('require_monitor', value=False)])[0].successful
    generator.node._look()
    assert 'collisions are not detected any more' in generator.told().message


def test_two_publishers_of_collisions(world: World, tudor: Path) -> None:
    """Two nodes on the topic are noticed and named."""
    generator = Generator(world, tudor)
    generator.run(3)
    for _ in range(2):
        world.probe.create_publisher(Bool, 'collision', latched())
    assert world.spin(lambda: generator.node.count_publishers('/collision') == 2)
    generator.node._look()
    status = generator.told()
    assert status.level == DiagnosticStatus.WARN
    assert "the topic 'collision' has 2 publishers" in status.message


def test_moves_are_shaped(world: World, root: Path, tmp_path: Path) -> None:
    """With a schedule and a payload: longer by half a period, within limits, at the goal."""
    path = tmp_path / 'schedule.yaml'
    schedule().save(path)
    generator = Generator(world, root / 'config/tudor.yaml', shaping='elastic',
                          gain_schedule=str(path))
    generator.run(5)
    generator.go(GOAL)
    generator.run(100)
    assert 'payload' in generator.node.status()[2]['not shaped']
    told = InertiaStamped()
    told.inertia.m = 0.2
    world.probe.create_publisher(InertiaStamped, 'payload', latched()).publish(told)
    assert world.spin(lambda: generator.node.source.shaping.payload == 0.2)
    generator.go(POSE)
    plain = MotionPlanner(motion_limits(load_arm(root / 'config/tudor.yaml')), GOAL)
    plain.go(POSE)
    assert generator.node.source.motion.remaining == pytest.approx(
        plain.remaining + 0.5 / 2.8, abs=0.01)
    generator.run(120)
    assert 'not shaped' not in generator.node.status()[2]
    np.testing.assert_allclose(generator.node.source.q, POSE, atol=1e-6)


def test_moves_are_refined_beside(world: World, root: Path, tmp_path: Path) -> None:
    """With an elastic model: the reference rests until the move is planned, then reaches it."""
    arm = load_arm(root / 'config/tudor.yaml')
    schedule().save(tmp_path / 'schedule.yaml')
    bundle = identified(arm, {})
    strain = bundle.models['strain']['elastic']
    strain.coefficients_ = tuple(np.array([121.4, 0.0]) for _ in arm.gauges)
    strain.standard_errors_ = tuple(np.ones(2) for _ in arm.gauges)
    save_bundle(bundle, tmp_path / 'model')
    generator = Generator(world, root / 'config/tudor.yaml', shaping='elastic',
                          gain_schedule=str(tmp_path / 'schedule.yaml'),
                          model=str(tmp_path / 'model'))
    source = generator.node.source
    assert source is not None and source.shaping.refine is not None
    source.shaping.payload = 0.2
    begun, go_on = Event(), Event()
    refine = source.shaping.refine

    def slowly(*given: Any) -> Profile:
        begun.set()
        assert go_on.wait(60.0)
        return refine(*given)
    source.shaping.refine = slowly
    generator.run(5)
    generator.go(GOAL)
    assert begun.wait(60.0)
    np.testing.assert_array_equal(generator.run(20)[-1], POSE)
    go_on.set()
    assert source.shaping.beside is not None
    source.shaping.beside.submit(abs, 0).result(60.0)  # after the move
    generator.run(120)
    assert 'not shaped' not in generator.node.status()[2]
    np.testing.assert_allclose(source.q, GOAL, atol=1e-6)


def test_model_that_cannot_refine(world: World, root: Path, tmp_path: Path) -> None:
    """Without an elastic model it says what is missing, and publishes nothing."""
    arm = load_arm(root / 'config/tudor.yaml')
    schedule().save(tmp_path / 'schedule.yaml')
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {}), tmp_path / 'model')
    node = world.add(ReferenceGeneratorNode, arm=str(root / 'config/tudor.yaml'),
                     shaping='elastic', gain_schedule=str(tmp_path / 'schedule.yaml'),
                     model=str(tmp_path / 'model'))
    assert node.source is None and 'elastic model' in node.fault


def test_shaping_without_modes(world: World, root: Path) -> None:
    """It says what is missing, and publishes nothing."""
    node = world.add(ReferenceGeneratorNode, arm=str(root / 'config/tudor.yaml'),
                     shaping='elastic')
    assert node.source is None and 'gain_schedule' in node.fault


def test_state_says_how_far_it_is(world: World, tudor: Path) -> None:
    """Wanted, actual and their difference, at the time of the trajectory; figures as well."""
    generator = Generator(world, tudor)
    states = world.listen('reference_generator/state', JointTrajectory)
    generator.run(5)
    generator.goals.publish(trajectory(point(1.0, 0.9, 0.1), point(2.0, 1.0, 0.0)))
    assert world.spin(lambda: generator.node.source.motion.follower.progress is not None)
    generator.run(50)
    generator.follows = False
    generator.run(25)
    states.clear()
    assert world.spin(lambda: bool(states))
    wanted, actual, error = states[-1].points
    assert list(states[-1].joint_names) == JOINTS
    assert wanted.time_from_start == Duration(sec=1, nanosec=500_000_000)
    np.testing.assert_allclose(wanted.positions, [0.95, 0.05], atol=1e-6)
    np.testing.assert_allclose(wanted.velocities, [0.15, -0.15], atol=1e-6)
    np.testing.assert_allclose(actual.positions, [0.9, 0.1], atol=0.01)
    np.testing.assert_allclose(error.positions, np.subtract(wanted.positions, actual.positions))
    values = values_of(generator.told())
    assert values['trajectory'] == '1.5 of 2.0 s'
    assert float(values['off the reference joint2 [rad]']) == pytest.approx(0.05, abs=0.01)


def test_lifecycle(world: World, tudor: Path) -> None:
    """Inactive it publishes nothing, once it has braked, and says why goals are refused."""
    node = world.add(ReferenceGeneratorNode, arm=str(tudor), autostart=False)
    assert node.phase == 'unconfigured' and node.source is None
    world.end(node)
    generator = Generator(world, tudor)
    node = generator.node
    assert node.trigger_deactivate().name == 'SUCCESS'
    assert generator.run(3).size == 0
    assert generator.told().message == INACTIVE
    generator.goals.publish(trajectory(point(1.0, *GOAL)))
    assert world.spin(lambda: node.drops['goal_refused'] == 1)
    assert node.trigger_activate().name == 'SUCCESS'
    assert generator.run(5)[-1] == pytest.approx(POSE)
    generator.goals.publish(trajectory(point(1.0, 1.2, 0.1), point(2.0, 1.4, 0.1)))
    assert world.spin(lambda: node.source.motion.follower.progress is not None)
    generator.run(30)
    before = generator.heard[-1]
    assert node.trigger_deactivate().name == 'SUCCESS'
    assert node.source.outcome == 'stopped: reference_generator was deactivated'
    generator.run(60)
    braked = np.array([[*m.position, *m.velocity] for m in generator.heard])
    assert 3 < len(braked) < 60 and not braked[-1, 2:].any()
    # by its stamps: a busy machine may have lost a sample
    way = [before, *generator.heard[:len(braked)]]
    elapsed = 1e-9 * np.diff([nanoseconds(m.header.stamp) for m in way])
    assert np.abs(np.diff([m.position for m in way], axis=0) / elapsed[:, None]).max() < 1.0
    assert node.source.motion is None
    assert generator.told().message == INACTIVE
    assert node.trigger_activate().name == 'SUCCESS'
    assert generator.run(5)[-1] == pytest.approx(generator.q)
    assert node.trigger_shutdown().name == 'SUCCESS'
    assert generator.told().message.startswith('the node was shut down')


def test_no_goals_among_random_targets(world: World, tudor: Path) -> None:
    """They would not be driven to."""
    generator = Generator(world, tudor, mode='aprbs', seed=3)
    generator.run(5)
    assert generator.node._take(trajectory(point(1.0, *GOAL))) == (
        'this node drives random targets; restart it with the parameter mode:=goals')
    assert np.ptp(generator.run(160), axis=0).max() > 0.02


def test_rivals_are_named(world: World, tudor: Path) -> None:
    """Another node that leads the arm is an ERROR, a second source of positions a WARN."""
    generator = Generator(world, tudor)
    generator.run(3)
    second = world.probe.create_publisher(JointState, 'joint_states', 10)
    assert world.spin(lambda: generator.node.count_publishers('/joint_states') == 2)
    generator.node._look()
    status = generator.told()
    assert status.level == DiagnosticStatus.WARN
    assert ('2 publishers send positions on joint_states, in nodes /probe, /probe; stop'
            in status.message)
    rival = world.probe.create_publisher(JointState, 'joint_reference', 10)
    assert world.spin(lambda: generator.node.count_publishers('/joint_reference') == 2)
    generator.node._look()
    status = generator.told()
    assert status.level == DiagnosticStatus.ERROR
    assert status.message == (
        '/probe can also send references on /joint_reference; let only one node publish there')
    for publisher in (second, rival):
        world.probe.destroy_publisher(publisher)
