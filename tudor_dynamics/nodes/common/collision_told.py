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

"""Topics of whether something touches the arm, and of collisions."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from std_msgs.msg import Bool, Header

from tudor_dynamics.monitoring.detector import CollisionEvent, Level
from tudor_dynamics.nodes.common.base import TudorNode, WARN
from tudor_dynamics.nodes.common.interfaces import COLLISION, COLLISION_EVENT, CONTACT
from tudor_dynamics.nodes.common.messages import time_message


class CollisionTold:
    """Publishes levels as they change, and collisions as they come."""

    def __init__(self, node: TudorNode) -> None:
        self._node = node
        self._flags = {Level.COLLISION: node.publish_on(Bool, COLLISION, latch=True),
                       Level.CONTACT: node.publish_on(Bool, CONTACT, latch=True)}
        self._events = node.publish_on(Header, COLLISION_EVENT)
        self._told: dict[Level, bool] = {}
        self._last: CollisionEvent | None = None
        self.level(Level.FREE)

    def level(self, level: Level) -> None:
        """Tell how strongly the arm is touched."""
        for of, publisher in self._flags.items():
            state = level >= of
            if self._told.get(of) is not state:
                self._told[of] = state
                publisher.publish(Bool(data=state))

    def event(self, event: CollisionEvent) -> None:
        """Tell of a collision."""
        self._last = event
        header = Header(frame_id=event.link)
        header.stamp = time_message(event.onset)
        self._events.publish(header)
        values = {'method': event.method, 'link': event.link, 'onset [ns]': str(event.onset),
                  'certain after [ms]': f'{(event.stamp - event.onset) * 1e-6:.1f}',
                  **{f'residual {k}': f'{v:.6g}' for k, v in event.residuals.items()},
                  **{f'ratio {k}': f'{v:.3f}' for k, v in event.ratios.items()}}
        node = self._node
        node.publish_diagnostics(DiagnosticStatus(
            level=WARN, name=f'{node.get_name()}: collision', hardware_id=node.hardware(),
            message=f'collision at {event.link}, by {event.method}',
            values=[KeyValue(key=k, value=v) for k, v in values.items()]))

    def values(self) -> dict[str, str]:
        """Give the last collision, for the diagnostics."""
        if self._last is None:
            return {}
        return {'last collision [ns]': str(self._last.onset), 'last link': self._last.link}

    def rivals(self) -> list[str]:
        """Name other nodes that tell of collisions on the same topic."""
        return self._node.rivals(self._flags[Level.COLLISION])
