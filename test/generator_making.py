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

"""A reference_generator on a simulated clock, and trajectories for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Duration
import numpy as np
from ros_world import joint_message, JOINTS, World
from rosgraph_msgs.msg import Clock
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tudor_dynamics.nodes.common.messages import floats, time_message
from tudor_dynamics.nodes.reference_generator import ReferenceGeneratorNode

POSE = np.array([0.8, 0.1])
PERIOD = 20_000_000
BEGUN = 10**18


def point(seconds: float, *q: float, still: bool = True) -> JointTrajectoryPoint:
    """Make a point of a trajectory; without speeds, straight lines lead there."""
    whole, part = divmod(seconds, 1.0)
    return JointTrajectoryPoint(
        positions=floats(np.array(q)), velocities=[0.0] * len(q) if still else [],
        time_from_start=Duration(sec=int(whole), nanosec=round(1e9 * part)))


def trajectory(*points: JointTrajectoryPoint, stamp: int = 0, names: list[str] = JOINTS,
               ) -> JointTrajectory:
    """Make a trajectory."""
    message = JointTrajectory(joint_names=names, points=list(points))
    message.header.stamp = time_message(stamp)
    return message


class Generator:
    """A generator on a simulated clock, with an arm that is where its reference was."""

    def __init__(self, world: World, arm: Path, **values: Any) -> None:
        self.world = world
        self.k, self.now = 0, BEGUN
        self.q = POSE.copy()
        self.follows = True
        self.node = world.add(ReferenceGeneratorNode, **{
            'arm': str(arm), 'rate': 50.0, 'use_sim_time': True, **values})
        self.node.steady = lambda: 1e-9 * PERIOD * self.k
        self.heard = world.listen('joint_reference')
        self.goals = world.output('joint_trajectory', JointTrajectory)
        world.meet('joint_states', 'joint_trajectory')
        world.output('/clock', Clock)
        world.meet('/clock')

    def step(self) -> None:
        """Let one period pass: positions, then the clock, which makes the next reference due."""
        self.k += 1
        stamp = self.now = BEGUN + PERIOD * self.k
        read = self.node.meter.count
        self.world.output('joint_states').publish(joint_message(stamp, JOINTS, position=self.q))
        assert self.world.spin(lambda: self.node.meter.count > read)
        before = self.node.get_clock().now().nanoseconds
        self.world.output('/clock').publish(Clock(clock=time_message(stamp)))
        assert self.world.spin(lambda: self.node.get_clock().now().nanoseconds > before)
        if self.node.active and self.node.source is not None:
            # the clock is there before its timer ran, on a busy machine long before
            self.world.spin(lambda: self.node._last == stamp, 1.0)
        self.world.rest(0.002)
        if self.follows and self.heard:
            self.q = np.array(self.heard[-1].position)

    def run(self, count: int) -> np.ndarray:
        """Let periods pass and give the references of that time."""
        self.heard.clear()
        for _ in range(count):
            self.step()
        return np.array([list(message.position) for message in self.heard])

    def go(self, goal: np.ndarray) -> None:
        """Send a goal and wait until it was looked at."""
        refused = self.node.drops['goal_refused']
        target = self.node.source.motion._planner._plans.copy() if self.node.source.motion else 0
        self.goals.publish(JointTrajectory(
            joint_names=JOINTS, points=[JointTrajectoryPoint(positions=floats(goal))]))
        assert self.world.spin(lambda: self.node.drops['goal_refused'] > refused or not (
            np.array_equal(self.node.source.motion._planner._plans, target)))

    def told(self) -> Any:
        """Give a diagnosis of this moment."""
        heard = self.world.heard['/diagnostics']
        for _ in range(2):  # the first one heard may have been on its way
            heard.clear()
            self.node.publish_diagnostics()
            assert self.world.spin(lambda: any(
                s.name.startswith('reference_generator') for a in heard for s in a.status))
        return [s for a in heard for s in a.status
                if s.name.startswith('reference_generator')][-1]
