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

"""The action of joint trajectory controllers, where ``control_msgs`` can be imported."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import GoalEvent
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.control.references import MISSED, OFF_PATH, REACHED, Tolerances
from tudor_dynamics.control.trajectory import LATE, WRONG_JOINTS
from tudor_dynamics.errors import SignalError
from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.nodes.common.interfaces import FOLLOW
from tudor_dynamics.nodes.common.messages import nanoseconds
from tudor_dynamics.typing import FloatArray

CODES = {REACHED: 0, WRONG_JOINTS: -2, LATE: -3, OFF_PATH: -4, MISSED: -5}
"""Result codes of the action by how a text begins; INVALID_GOAL for others."""
INVALID_GOAL = -1


def since_start(node: TudorNode, message: JointTrajectory) -> float:
    """Time since the start of a trajectory, 0 where it begins as it comes [s]."""
    stamp = nanoseconds(message.header.stamp)
    return 1e-9 * (node.get_clock().now().nanoseconds - stamp) if stamp else 0.0


def tolerances_of(goal: Any, names: Sequence[str], default: Tolerances) -> Tolerances:
    """Read the tolerances of a goal: 0 keeps a default, -1 lifts it; SignalError for others."""
    def read(field: str, bound: FloatArray | float) -> FloatArray:
        bounds = np.array(np.broadcast_to(bound, len(names)))
        for item in getattr(goal, field):
            if item.name not in names:
                raise SignalError(f'{WRONG_JOINTS}: {field} has the unknown joint {item.name!r}',
                                  remedy=f'the joints are {", ".join(names)}')
            if item.velocity > 0.0 or item.acceleration > 0.0:
                raise SignalError(f'{field} of {item.name!r} has a velocity or acceleration, but '
                                  'only positions are checked', remedy='leave both 0')
            if not (item.position >= 0.0 or item.position == -1.0):
                raise SignalError(f'{field} of {item.name!r} has the position {item.position:g}',
                                  remedy='give a bound above 0 [rad or m], 0 for the default, '
                                         'or -1 for none')
            if item.position:
                bounds[names.index(item.name)] = max(item.position, 0.0)
        return bounds
    late = 1e-9 * nanoseconds(goal.goal_time_tolerance)
    return Tolerances(read('path_tolerance', default.path), read('goal_tolerance', default.goal),
                      max(late, 0.0) if late else default.goal_time)


class FollowServer:
    """Offers the action over what a node does with trajectories; one goal is active at a time."""

    def __init__(self, node: TudorNode, take: Callable[[Any], str], stop: Callable[[str], None],
                 ) -> None:
        self.action: Any = None
        with suppress(ImportError):  # wheels have no ``control_msgs``
            from control_msgs.action import FollowJointTrajectory
            self.action = FollowJointTrajectory
        self._take, self._stop, self._named = take, stop, node.named
        self._goal: Any = None
        self._server = None if self.action is None else ActionServer(
            node, self.action, FOLLOW, partial(self._finish, ''), cancel_callback=self._cancel,
            handle_accepted_callback=self._accepted)

    def _accepted(self, goal: Any) -> None:
        # a goal that is rejected gets no reason, one that is aborted does
        asked = goal.request
        several = (asked.multi_dof_trajectory.points, asked.component_path_tolerance,
                   asked.component_goal_tolerance)
        why = self._take(asked) if not any(several) else (
            f'{WRONG_JOINTS}: the arm has no multi-DOF joints; leave their fields empty')
        if why:
            goal.execute(partial(self._finish, why))
            return
        self.end('a newer goal replaced this one')
        # execute() would need a callback that waits, for which rclpy's executors spin all the time
        goal._update_state(GoalEvent.EXECUTE)
        self._goal = goal

    def _cancel(self, goal: Any) -> CancelResponse:
        if goal is not self._goal:
            return CancelResponse.REJECT
        self._stop('canceled')
        return CancelResponse.ACCEPT

    def end(self, text: str, code: int | None = None) -> None:
        """End the active goal, if there is one, with its result."""
        goal, self._goal = self._goal, None
        if goal is not None and self._server is not None:
            self._server.notify_execute(goal, partial(self._finish, text, code=code))

    def report(self, header: Header, names: list[str], points: Sequence[Any]) -> None:
        """Send wanted and actual state, and the difference, as feedback."""
        if self._goal is not None:
            desired, actual, error = points
            self.feedback(self.action.Feedback(
                header=header, joint_names=names, desired=desired, actual=actual, error=error))

    def feedback(self, feedback: Any) -> None:
        """Send feedback of the active goal."""
        if self._goal is not None:
            self._goal.publish_feedback(feedback)

    def _finish(self, text: str, goal: Any, code: int | None = None) -> Any:
        if code is None:
            code = next((code for head, code in CODES.items() if text.startswith(head)),
                        INVALID_GOAL)
        if goal.is_cancel_requested:
            goal.canceled()
        elif code == 0:
            goal.succeed()
        else:
            goal.abort()
        return self.action.Result(error_code=code, error_string=self._named(text))

    def destroy(self) -> None:
        """End the server."""
        if self._server is not None:
            self._server.destroy()
