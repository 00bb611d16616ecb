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

"""Arms with a prismatic joint and names of their own: nothing is taken for TUDOR."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
import math
from pathlib import Path

import numpy as np
import pytest
from ros_world import joint_message, World
from std_msgs.msg import Bool, Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.nodes import damper_sign_test as program
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.common.messages import floats
from tudor_dynamics.nodes.oscillation_damper import OscillationDamperNode
from tudor_dynamics.nodes.reference_generator import ReferenceGeneratorNode
import yaml

ARM = {
    'name': 'gantry',
    'kinematics': {'dh': [[0.0, -math.pi / 2, 0.2, 0.0], [0.5, 0.0, 0.0, 0.0]]},
    'joint_topic': 'drive_states',
    'joints': [
        {'name': 'lift', 'type': 'prismatic', 'effort': {'unit': 'N', 'topic': 'drive_states'},
         'limits': {'lower': 0.0, 'upper': 0.4, 'velocity': 0.3, 'acceleration': 1.0}},
        {'name': 'boom', 'effort': {'unit': 'N m', 'topic': 'drive_states'},
         'limits': {'lower': -1.0, 'upper': 1.0, 'velocity': 1.0, 'acceleration': 3.0}}],
    'gauges': [{'name': 'root', 'joint': 'boom', 'distance': 0.05, 'unit': 'm/m',
                'topic': 'boom_strain'},
               {'name': 'mast', 'joint': 'lift', 'distance': 0.05, 'axis': 'y',
                'topic': 'mast_strain'}],
    'damper': {'position_gain': 3.0, 'rate': 1000.0, 'velocity_bandwidth': 20.0,
               'mean_frequency': 0.3,
               'joints': [{'joint': 'boom', 'gauge': 'root', 'gain': 800.0}]},
}


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    """Describe a lift with a boom."""
    path = tmp_path / 'gantry.yaml'
    path.write_text(yaml.safe_dump(ARM))
    return path


def goal(**places: float) -> JointTrajectory:
    """Make a goal."""
    return JointTrajectory(joint_names=list(places), points=[
        JointTrajectoryPoint(positions=floats(np.array(list(places.values()))))])


def test_reference_of_a_lift(world: World, gantry: Path) -> None:
    """Goals in m and rad by name, within the limits of each; complying by its own gauges."""
    node = world.add(ReferenceGeneratorNode, arm=str(gantry), rate=200.0, reaction='comply')
    assert not node.fault
    heard = world.listen('joint_reference')
    world.output('collision', Bool)
    world.output('joint_trajectory', JointTrajectory)
    world.meet('drive_states', 'joint_trajectory', 'strain_residuals')

    def there(done: Callable[[], bool]) -> bool:
        """Let the arm be where its reference was until something is true."""
        lift, boom = heard[-1].position if heard else (0.1, 0.2)
        world.output('drive_states').publish(joint_message(
            10**18, ['boom', 'spare', 'lift'], position=[boom, 5.0, lift]))
        return done()
    assert world.spin(lambda: there(lambda: bool(heard)))
    assert list(heard[-1].name) == ['lift', 'boom']
    assert list(heard[-1].position) == [0.1, 0.2]
    world.output('joint_trajectory', JointTrajectory).publish(goal(lift=0.7))
    world.output('joint_trajectory', JointTrajectory).publish(goal(boom=0.0, lift=0.2))
    assert world.spin(lambda: there(
        lambda: heard[-1].position[0] > 0.1999 and heard[-1].position[1] < 1e-4))
    assert node.drops['goal_refused'] == 1
    speeds = np.array([list(message.velocity) for message in heard])
    assert (np.abs(speeds).max(axis=0) <= [0.3, 1.0]).all()
    late = world.probe.create_publisher(Bool, 'collision', latched())
    late.publish(Bool(data=True))
    assert world.spin(lambda: there(lambda: node.source.reacting))
    world.output('strain_residuals').publish(joint_message(
        10**18, ['mast', 'root'], position=[-20.0, 1e-4]))
    assert world.spin(lambda: there(lambda: node.source.motion.yielding.any()))
    # 1000 rad/s (m/s) per m/m; the mast counts in um/m
    assert node.source.motion.yielding == pytest.approx([0.02, -0.1])


def test_damper_of_a_boom(world: World, gantry: Path) -> None:
    """The boom's gauge, in m/m and on its own topic, moves the boom alone."""
    node = world.add(OscillationDamperNode, arm=str(gantry), timeout=1.0)
    commands = world.listen('velocity_commands', Float64MultiArray)
    world.meet('drive_states', 'boom_strain')
    q, period, k = np.array([0.1, 0.2]), 0.005, 0
    node.steady = lambda: period * k
    node.ros_time = lambda: 10**18 + round(1e9 * period * k)
    while k < 500:
        k, before = k + 1, len(commands)
        stamp = node.ros_time()
        world.output('boom_strain').publish(joint_message(
            stamp, ['root'], position=[1e-4 * math.sin(25.0 * period * k)]))
        if commands:  # an arm that does not answer is not trusted with more
            q += period * np.array(commands[-1].data)
        world.output('drive_states').publish(joint_message(
            stamp, ['lift', 'boom'], position=q.tolist()))
        # the first ones tell how fast the arm is and are not answered
        assert world.spin(lambda: node.gate.last == stamp)  # noqa: B023
        assert k < 100 or world.spin(lambda: len(commands) > before)  # noqa: B023
    seen = np.array([list(command.data) for command in commands])[-60:]
    assert not seen[:, 0].any()
    assert 0.04 < np.abs(seen[:, 1]).max() < 0.1
    assert node.controller.damper.report() == ['boom (root): damps']


def test_sign_test_knows_other_arms(gantry: Path, world: World,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    """Joints by the damper, steps by their kind, gauges by the damper's choice."""
    arm = load_arm(gantry)
    assert program.damped_joints(arm) == ['boom']
    sizes = Namespace(step=3.0, slide=10.0)
    assert program.step_size(arm, 'boom', sizes) == pytest.approx(math.radians(3.0))
    assert program.step_size(arm, 'lift', sizes) == 0.01
    tester = program.SignTester(arm, context=world.context)
    try:
        assert tester._gauge('boom') == 0
        assert {topic for topic, _ in tester.get_subscriber_names_and_types_by_node(
            'damper_sign_test', '/')} >= {'/drive_states', '/boom_strain'}
    finally:
        tester.destroy_node()
    assert program.main(['damper_sign_test', '--arm', str(gantry), '--joints', 'lift']) == 2
    assert "'lift' is not in damper.joints" in capsys.readouterr().err
    assert program.main(['damper_sign_test', '--arm', str(gantry), '--slide', '500']) == 2
    assert 'up to 100 mm' in capsys.readouterr().err
