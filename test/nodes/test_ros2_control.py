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

"""docs/howto/ros2_control.md: its commands, as processes, against controllers in small."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import re
import shlex
import signal
import subprocess
from typing import Any

from controller_mirrors import TrajectoryMirror, VelocityMirror
from generator_making import point, trajectory
from node_processes import finish, launch
import numpy as np
from patience import PATIENCE
import pytest
from ros_world import JOINTS, values_of, World
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.common.interfaces import FOLLOW
import yaml

POSE = np.array([0.8, 0.1])


def page(root: Path, heading: str, kind: str) -> list[str]:
    """Give the blocks of a section."""
    text = (root / 'docs/howto/ros2_control.md').read_text().split(f'\n## {heading}\n')[1]
    return re.findall(rf'```{kind}\n(.*?)```', text.split('\n## ')[0], re.DOTALL)


@pytest.fixture
def started(root: Path) -> Iterator[Any]:
    """Give what starts the nodes of a section; ends them."""
    processes: list[subprocess.Popen] = []

    def start(heading: str) -> list[subprocess.Popen]:
        for line in page(root, heading, 'sh ros')[0].replace('\\\n', ' ').splitlines():
            words = shlex.split(line)
            assert words[:3] == ['ros2', 'run', 'tudor_dynamics'] and words[4] == '--ros-args'
            processes.append(launch(words[3], *words[5:], cwd=root))
        return processes
    yield start
    for process in processes:
        process.kill()
        process.communicate()


def test_controllers_have_the_joints_of_the_arm(root: Path) -> None:
    """In their order, under the names that the commands use."""
    joints = list(load_arm(root / 'config/tudor.yaml').active_joints)
    for heading, name in (('Velocity commands', 'velocity_controller'),
                          ('Trajectories', 'joint_trajectory_controller')):
        content = yaml.safe_load(page(root, heading, 'yaml')[0])
        assert name in content['controller_manager']['ros__parameters']
        assert content[name]['ros__parameters']['joints'] == joints
        assert name in page(root, heading, 'sh ros')[0]
    moveit = yaml.safe_load(page(root, 'Trajectories', 'yaml')[1])[
        'moveit_simple_controller_manager']
    relay, = moveit['controller_names']
    assert moveit[relay]['joints'] == joints
    assert f'~/{moveit[relay]["action_ns"]}' == FOLLOW
    assert relay in page(root, 'Trajectories', 'sh ros')[0]


def test_velocity_commands(world: World, root: Path, started: Any) -> None:
    """A goal is reached through the array of the controller; a signal leaves it at rest."""
    arm = world.add(lambda parameter_overrides, **how: VelocityMirror(
        list(JOINTS), POSE, **how))
    reference = world.listen('joint_reference')
    nodes = started('Velocity commands')
    goals = world.output('joint_trajectory', JointTrajectory)
    assert world.spin(lambda: len(reference) > 100 and goals.get_subscription_count() > 0)
    assert world.spin(lambda: arm._commands.get_publisher_count() == 1)

    def go(joint2: float, done: Callable[[], bool]) -> bool:
        """Send a goal, again where a message was lost or a busy machine held the arm."""
        for _ in range(10):
            # Until it follows, a reference that leaves is one that the arm is not with.
            world.status('oscillation_damper',
                         lambda status: values_of(status).get('state') == 'following')
            goals.publish(trajectory(point(1.0, joint2, -0.2)))
            if world.spin(done, PATIENCE / 20):
                return True
            world.call(Trigger, 'oscillation_damper/reset')
        return False
    assert go(1.2, lambda: np.allclose(arm.q, [1.2, -0.2], atol=0.02)), arm.q
    assert go(2.2, lambda: bool(arm.dq[0] > 0.3)), arm.q
    for process in nodes:
        process.send_signal(signal.SIGINT)
    assert world.spin(lambda: all(process.poll() is not None for process in nodes))
    world.rest(0.1)
    assert not arm.dq.any()
    for process in nodes:
        finish(process, signal.SIGINT)


def test_trajectories(world: World, root: Path, started: Any) -> None:
    """The page's message goes through the relay, and a collision stops the controller."""
    arm = world.add(lambda parameter_overrides, **how: TrajectoryMirror(
        list(JOINTS), POSE, **how))
    started('Trajectories')
    shown = yaml.safe_load(shlex.split(page(root, 'Trajectories', 'sh ros')[1].replace(
        '\\\n', ' '))[-1])
    goals = world.output('joint_trajectory', JointTrajectory)
    assert world.spin(lambda: goals.get_subscription_count() > 0
                      and arm._topic.get_publisher_count() > 0)
    world.rest(0.5)
    goals.publish(trajectory(*(
        point(float(item['time_from_start']['sec']), *item['positions'], still=False)
        for item in shown['points']), names=shown['joint_names']))
    assert world.spin(lambda: np.allclose(arm.q, [0.95, 0.05], atol=0.02))
    world.probe.create_publisher(Bool, 'collision', latched()).publish(Bool(data=True))
    assert world.spin(lambda: not arm.dq.any(), 3.0)
    assert arm.q[0] < 0.99 and not arm.rejected
