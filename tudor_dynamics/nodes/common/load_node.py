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

"""What detectors have to do with the load: they follow it, or tell it."""

from __future__ import annotations

from typing import Any

from tudor_dynamics.monitoring.settings import Found
from tudor_dynamics.nodes.common.detect_node import DetectNode
from tudor_dynamics.nodes.common.gripper import Gripper
from tudor_dynamics.nodes.common.payload_port import PayloadPort


class LoadNode(DetectNode):
    """Base of the nodes that find collisions and know of a load."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.port = PayloadPort(self, self.payload_source())
        self.gripper = Gripper(self, self.port.announce, self._arm_joints)

    def payload_source(self) -> str:
        """Give where the load is known from."""
        return str(self.value('payload_source'))

    def _arm_joints(self) -> tuple[str, ...]:
        return () if self.bundle is None else tuple(self.bundle.arm.full_model.names)

    def _reset(self) -> str:
        """Begin anew, with the load as well: nothing touches the arm now."""
        self.port.begin_anew()
        return super()._reset()

    def tell(self, found: Found) -> None:
        """Publish what was found, and the load."""
        super().tell(found)
        for load in found.loads:
            self.get_logger().info(f'no collision but a load: {load.mass:.3f} kg now')
        if found.residuals:
            self.port.tell(found.residuals[-1][1].motion.stamp, len(found.loads))

    def status(self) -> tuple[bytes, str, dict[str, str]]:
        """Add the load."""
        level, message, values = super().status()
        return level, message, {**values, **self.port.values()}
