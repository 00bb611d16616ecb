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

"""What grippers say of themselves, as an announcement that a load may come or go."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.nodes.common.interfaces import GRIPPERS

MOVED = 1e-3
"""Way of a finger from which on it moves [rad or m]."""
AT_WORK = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)


class Gripper:
    """Listens to a gripper."""

    def __init__(
        self, node: TudorNode, announce: Callable[[], None],
        arm_joints: Callable[[], Collection[str]],
    ) -> None:
        self._announce, self._arm_joints = announce, arm_joints
        self.heard = 0
        self._closed: bool | None = None
        self._places: dict[str, float] = {}
        self._goals: set[bytes] | None = None
        topic = str(node.value('gripper_topic'))
        if topic:
            kind, heard = {
                GRIPPERS[0]: (Bool, self._switched), GRIPPERS[1]: (JointState, self._moved),
                GRIPPERS[2]: (GoalStatusArray, self._sent)}[str(node.value('gripper_type'))]
            self._subscription = node.subscribe(kind, topic, heard)

    def _switched(self, message: Any) -> None:
        self.heard += 1
        changed = self._closed is not None and message.data != self._closed
        self._closed = message.data
        if changed:
            self._announce()

    def _moved(self, message: Any) -> None:
        self.heard += 1
        own = self._arm_joints()
        moved = False
        for name, place in zip(message.name, message.position, strict=False):
            if name in own:
                continue
            before = self._places.setdefault(name, place)
            if not abs(place - before) <= MOVED:  # NaN never comes to rest, and is no place
                moved = moved or place == place
                self._places[name] = place
        if moved:
            self._announce()

    def _sent(self, message: Any) -> None:
        self.heard += 1
        goals = {bytes(status.goal_info.goal_id.uuid) for status in message.status_list
                 if status.status in AT_WORK}
        new = goals - (self._goals or set())
        self._goals = goals
        if new:
            self._announce()
