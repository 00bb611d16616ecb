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

"""The node that adds efforts, through real topics."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from elastic_making import blade_arm
from geometry_msgs.msg import InertiaStamped
import numpy as np
from payload_making import true_outputs, two_gauge_arm
import pytest
from ros_world import joint_message, values_of, World
from sample_arms import random_states
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.trajectory import Trajectory
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, save_bundle
from tudor_dynamics.models.elastic.model import ElasticModel
from tudor_dynamics.models.regressor import EffortRegressor, PayloadRegressor
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.feedforward import FeedforwardNode
from tudor_dynamics.online.feedforward import Feedforward

JOINTS = ('j1', 'j2')
T = np.array([0.0, 0.5, 1.5, 2.0])
Q = np.array([[0.0, 0.1], [0.4, -0.2], [1.1, 0.3], [1.2, 0.3]])


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Save a model of efforts from 0 to 400 g."""
    arm, motion = two_gauge_arm(), random_states(300, 2, 0)
    inputs = np.vstack([np.column_stack([motion, np.full(300, m)]) for m in (0.0, 0.4)])
    values = np.vstack([true_outputs(arm, motion, m)['effort'] for m in (0.0, 0.4)])
    fitted = AnalyticalModel(PayloadRegressor(EffortRegressor(arm), arm, (0.0, 0.4)), 2).fit(
        inputs, values)
    save_bundle(ModelBundle(arm, PreprocessingSpec(), {'effort': {'analytical': fitted}}),
                tmp_path / 'model')
    return tmp_path / 'model'


def message(q: np.ndarray, t: np.ndarray = T, joints: tuple[str, ...] = JOINTS) -> Any:
    """Make a trajectory of positions alone."""
    points = [JointTrajectoryPoint(positions=row) for row in q.tolist()]
    for point, time in zip(points, t.tolist(), strict=True):
        point.time_from_start.sec = int(time)
        point.time_from_start.nanosec = round(1e9 * (time % 1.0))
    made = JointTrajectory(joint_names=list(joints), points=points)
    made.header.frame_id, made.header.stamp.sec = 'base', 12
    return made


def efforts(found: Any) -> np.ndarray:
    """Read the efforts of a trajectory."""
    return np.array([point.effort for point in found.points])


def test_trajectories_states_and_a_load_that_comes(world: World, model: Path) -> None:
    """The numbers are those of the library, with the payload that the estimator tells."""
    node = world.add(FeedforwardNode, model=str(model), payload=0.1, payload_source='topic')
    heard = world.listen('trajectory_with_effort', JointTrajectory)
    states = world.listen('states_with_effort')
    load = world.probe.create_publisher(InertiaStamped, 'payload', latched())
    world.meet('wanted_states')
    output = world.output('wanted_trajectory', JointTrajectory)
    world.meet('wanted_trajectory')
    bundle = load_bundle(model)
    for k, payload in enumerate((0.1, 0.3)):
        if k:
            told = InertiaStamped()
            told.inertia.m = payload
            load.publish(told)
            assert world.spin(lambda: node.port.load.mass == 0.3)
        output.publish(message(Q))
        assert world.spin(lambda: len(heard) > k)  # noqa: B023
        expected = Feedforward(bundle, payload=payload).along(Trajectory(JOINTS, T, Q))
        assert np.array_equal(efforts(heard[k]), expected.effort)
    same = heard[0]
    assert same.header.frame_id == 'base' and same.header.stamp.sec == 12
    assert [list(point.positions) for point in same.points] == Q.tolist()
    assert not len(same.points[0].velocities)

    singles = world.output('wanted_states')
    singles.publish(joint_message(5_000_000_007, ['j2', 'x', 'j1'], position=[0.3, 9.0, 1.1]))
    singles.publish(joint_message(6_000_000_000, ['j1', 'j2'], position=[1.1, 0.3],
                                  velocity=[0.5, -0.4]))
    assert world.spin(lambda: len(states) == 2)
    for found, speed in zip(states, ([0.0, 0.0], [0.5, -0.4]), strict=True):
        motion = np.array([[1.1, 0.3, *speed, 0.0, 0.0]])
        assert list(found.name) == list(JOINTS)
        assert list(found.effort) == pytest.approx(
            true_outputs(two_gauge_arm(), motion, 0.3)['effort'][0], rel=1e-6)
    assert (states[0].header.stamp.sec, states[0].header.stamp.nanosec) == (5, 7)
    told = values_of(world.status('feedforward', lambda s: s.level == b'\0'))
    assert told['payload [kg]'] == '0.3' and told['unit'] == 'N m, N m'


def test_what_cannot_be_used_is_said_and_a_stop_goes_through(world: World, model: Path) -> None:
    """Nothing is published for a motion that is refused; the next good one ends the warning."""
    world.add(FeedforwardNode, model=str(model))
    heard = world.listen('trajectory_with_effort', JointTrajectory)
    output = world.output('wanted_trajectory', JointTrajectory)
    world.meet('wanted_trajectory')
    for wrong, words in (
            (message(Q, joints=('j1', 'j9')), "the joint 'j9'"),
            (message(Q, t=np.array([0.0, 1.0, 1.0, 2.0])), 'time does not increase'),
            (message(np.full((4, 2), np.nan)), 'point 1 of 4 have nan'),
            (message(Q[:, :1]), 'point 1 of 4 has 1 of 2 positions')):
        output.publish(wrong)
        status = world.status('feedforward', lambda s: words in s.message)  # noqa: B023
        assert status.level == b'\1' and status.message.startswith('motion refused')
    assert not heard
    output.publish(JointTrajectory(joint_names=list(JOINTS)))  # stop
    assert world.spin(lambda: len(heard) == 1) and not heard[0].points
    output.publish(message(Q))
    assert world.spin(lambda: len(heard) == 2)
    assert world.status('feedforward', lambda s: s.level == b'\0').message == 'running'


def test_motors_are_led(world: World, tmp_path: Path) -> None:
    """Positions are those of the motors, with the velocities and accelerations of their path."""
    arm = blade_arm()
    effort = ElasticModel(arm, 'effort')
    effort.coefficients_ = tuple(np.array([0.1, 0.05, 0.2, 0.1, 0.0]) for _ in range(2))
    effort.standard_errors_ = effort.coefficients_
    effort.noise_ = np.ones(2)
    whole = ModelBundle(arm, PreprocessingSpec(), {'effort': {'elastic': effort}})
    save_bundle(whole, tmp_path / 'elastic')
    world.add(FeedforwardNode, model=str(tmp_path / 'elastic'), kind='elastic', positions='motor')
    heard = world.listen('trajectory_with_effort', JointTrajectory)
    output = world.output('wanted_trajectory', JointTrajectory)
    world.meet('wanted_trajectory')
    output.publish(message(Q))
    assert world.spin(lambda: len(heard) == 1)
    expected = Feedforward(whole, kind='elastic', positions='motor').along(
        Trajectory(JOINTS, T, Q))
    for field, name in (('positions', 'q'), ('velocities', 'dq'), ('accelerations', 'ddq'),
                        ('effort', 'effort')):
        values = np.array([getattr(point, field) for point in heard[0].points])
        assert values == pytest.approx(getattr(expected, name), abs=1e-9)
    assert np.abs(np.array([point.positions for point in heard[0].points]) - Q).max() > 0.02


def test_a_model_that_cannot_do_it_says_so(world: World, model: Path) -> None:
    """A rigid arm has no motors to be led; torques of unknown constants are not made up."""
    assert 'elastic model' in world.add(FeedforwardNode, model=str(model),
                                        positions='motor').fault
    node = world.add(FeedforwardNode, model=str(model), unit='current')
    assert 'torque constant' in node.fault
    assert node.status()[0] == b'\2'
