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

"""Controllers of ros2_control in small, for tests: topics, rules, and joints that obey."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import GoalEvent
from rclpy.node import Node
from scipy.interpolate import CubicHermiteSpline, PPoly
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory
from tudor_dynamics.nodes.common.messages import floats, nanoseconds

PERIOD = 0.01


class Mirror(Node):
    """A controller with joints, which publishes where they are."""

    def __init__(self, name: str, joints: list[str], q: np.ndarray, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.joints, self.q, self.dq = joints, q.copy(), np.zeros_like(q)
        self._states = self.create_publisher(JointState, '/joint_states', 10)
        self._timer = self.create_timer(PERIOD, self._tick)

    def advance(self) -> None:
        """Let the joints move for a period."""
        raise NotImplementedError

    def _tick(self) -> None:
        self.advance()
        message = JointState(name=self.joints, position=floats(self.q), velocity=floats(self.dq))
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)

    def close(self) -> None:
        """Do what nodes of the package do at their end."""


class VelocityMirror(Mirror):
    """JointGroupVelocityController: an array of speeds in the order of its joints."""

    def __init__(self, joints: list[str], q: np.ndarray, **kwargs: Any) -> None:
        super().__init__('velocity_controller', joints, q, **kwargs)
        self._commands = self.create_subscription(
            Float64MultiArray, '~/commands', self._command, 10)

    def _command(self, message: Float64MultiArray) -> None:
        if len(message.data) == len(self.joints):
            self.dq = np.array(message.data)

    def advance(self) -> None:
        """Go on at the commanded speeds."""
        self.q = self.q + PERIOD * self.dq


class TrajectoryMirror(Mirror):
    """
    JointTrajectoryController, with cubics or straight lines.

    It refuses names, counts and times that do not fit, and a last point in motion; it knows no
    limits, jumps to a first point at its start, and holds at a message without points, which newer
    ones refuse (``newer``).
    """

    def __init__(self, joints: list[str], q: np.ndarray, *, newer: bool = False,
                 action: Any = None, **kwargs: Any) -> None:
        super().__init__('joint_trajectory_controller', joints, q, **kwargs)
        self.newer, self.taken, self.rejected = newer, [], 0
        self._curve: Any = None
        self._begun = 0.0
        self._goal: Any = None
        self._action = action
        self._topic = self.create_subscription(
            JointTrajectory, '~/joint_trajectory', self.take, 10)
        self._server = None if action is None else ActionServer(
            self, action, '~/follow_joint_trajectory', self._finish,
            handle_accepted_callback=self._accepted, cancel_callback=self._cancel)

    def take(self, message: JointTrajectory) -> bool:
        """Take a trajectory where it is valid."""
        points, names = message.points, list(message.joint_names)
        times = [1e-9 * nanoseconds(point.time_from_start) for point in points]
        if sorted(names) != sorted(self.joints) or (self.newer and not points) or any(
                b <= a for a, b in zip(times, times[1:], strict=False)) or (
                points and any(points[-1].velocities)) or any(
                len(point.positions) != len(names) for point in points):
            self.rejected += 1
            return False
        self.taken.append(message)
        self._begun, order = time.monotonic(), [names.index(name) for name in self.joints]
        if not points:
            self._curve, self.dq = None, np.zeros_like(self.q)
            return True
        q = [np.array(point.positions)[order] for point in points]
        still = all(len(point.velocities) for point in points)
        dq = [np.array(point.velocities)[order] for point in points] if still else []
        if times[0] > 0.0:
            times, q, dq = [0.0, *times], [self.q, *q], [self.dq, *dq] if still else []
        if len(times) == 1:
            times, q, dq = [0.0, PERIOD], [q[0], q[0]], []
        self._curve = CubicHermiteSpline(times, q, dq) if dq else PPoly(
            np.stack([np.diff(q, axis=0) / np.diff(times)[:, None], q[:-1]]), times)
        return True

    def advance(self) -> None:
        """Go on along the trajectory."""
        if self._curve is None:
            return
        now = time.monotonic() - self._begun
        end = float(self._curve.x[-1])
        self.q = self._curve(min(now, end))
        self.dq = self._curve(now, 1) if now < end else np.zeros_like(self.q)
        if self._goal is not None:
            self._goal.publish_feedback(self._action.Feedback(joint_names=self.joints))
        if now >= end:
            self._curve = None
            self._end()

    def _accepted(self, goal: Any) -> None:
        self._end()
        if not self.take(goal.request.trajectory):
            goal.execute(self._finish)
            return
        goal._update_state(GoalEvent.EXECUTE)
        self._goal = goal

    def _cancel(self, goal: Any) -> CancelResponse:
        self._curve, self.dq = None, np.zeros_like(self.q)
        self._end()
        return CancelResponse.ACCEPT

    def _end(self) -> None:
        goal, self._goal = self._goal, None
        if goal is not None and self._server is not None:
            self._server.notify_execute(goal, self._finish)

    def _finish(self, goal: Any) -> Any:
        if goal.is_cancel_requested:
            goal.canceled()
        elif self._curve is None:
            goal.succeed()
        else:
            goal.abort()
        return self._action.Result(error_code=0, error_string='as the controller says')

    def close(self) -> None:
        """End the action."""
        if self._server is not None:
            self._server.destroy()
