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

"""The load on topics: published, listened to, announced."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import Inertia, InertiaStamped, Vector3

from tudor_dynamics.errors import TudorError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.monitoring.payload_stage import CarriedLoad, PayloadStage
from tudor_dynamics.nodes.common.base import latched, TudorNode
from tudor_dynamics.nodes.common.interfaces import EXPECT_PAYLOAD, PAYLOAD_TOPIC
from tudor_dynamics.nodes.common.messages import time_message

EVERY = 100_000_000
"""Time between two messages of a load that goes on changing [ns]."""
CHANGED = 0.1
"""Part of its standard deviation by which it has to have changed."""


class PayloadPort:
    """What a node has to do with the load; load: None where the load is a parameter."""

    def __init__(self, node: TudorNode, source: str) -> None:
        self._node, self.source = node, source
        self.load: CarriedLoad | None = None
        self._taken_back = self._announced = 0
        self._last: tuple[int, float] | None = None
        if source == 'estimate':
            self._publisher = node.publish_on(InertiaStamped, PAYLOAD_TOPIC, latch=True)
            node.serve(EXPECT_PAYLOAD, self._expect)
        elif source == 'topic':
            self._subscription = node.create_subscription(
                InertiaStamped, PAYLOAD_TOPIC, self._heard, latched())

    def prepare(self, bundle: ModelBundle, payload: float) -> CarriedLoad | None:
        """
        Build what follows the load.

        payload [kg]; returns None where the load is a parameter.
        """
        if self.source == 'parameter':
            return None
        known = payload if bundle.payload_range is not None else bundle.payload or 0.0
        made: Callable[[ModelBundle, float], CarriedLoad] = (
            PayloadStage if self.source == 'estimate' else CarriedLoad)
        return made(bundle, known)

    def use(self, load: CarriedLoad | None) -> None:
        """Put another one into use; a load that is known stays."""
        if load is not None and self.load is not None and self.source == 'topic':
            load.carry(self.load.mass)
        self.load = load

    def tell(self, stamp: int, taken_back: int = 0) -> None:
        """Publish the load where it has changed: stamp [ns]."""
        load = self.load
        self._taken_back += taken_back
        if not isinstance(load, PayloadStage):
            return
        if self._last is not None and not taken_back:
            since, mass = self._last
            if 0 <= stamp - since < EVERY or abs(load.mass - mass) < CHANGED * load.std:
                return
        self._last = stamp, load.mass
        message = InertiaStamped()
        message.header.stamp, message.header.frame_id = time_message(stamp), load.frame
        x, y, z = (float(value) for value in load.place)
        # a point: what one kilogram more or less turns by is in its place
        message.inertia = Inertia(m=float(load.mass), com=Vector3(x=x, y=y, z=z))
        self._publisher.publish(message)

    def _heard(self, message: InertiaStamped) -> None:
        mass = float(message.inertia.m)
        if self.load is not None and 0.0 <= mass < float('inf'):
            self.load.carry(mass)

    def _expect(self) -> str:
        if not isinstance(self.load, PayloadStage):
            msg = 'there is no model yet that could tell a load; see the diagnostics'
            raise TudorError(msg)
        self.announce()
        return 'a load may come or go within 3 s without being a collision'

    def announce(self) -> None:
        """Let a load come or go now; of no effect where the load is a parameter."""
        if self.load is not None:
            self.load.expect()
            self._announced += 1

    def begin_anew(self) -> None:
        """Learn the load from nothing, where it is estimated."""
        if isinstance(self.load, PayloadStage):
            self.load.observer.reset()

    def values(self) -> dict[str, str]:
        """Give what diagnostics tell of the load."""
        load = self.load
        if load is None:
            return {}
        found = {'payload [kg]': f'{load.mass:.4f}', 'payload source': self.source}
        if isinstance(load, PayloadStage):
            found['payload std [kg]'] = f'{load.std:.4f}'
            found['payload told by'] = load.output + (', bent links' if load.bent else '')
        found['collisions that were loads'] = str(self._taken_back)
        found['loads announced'] = str(self._announced)
        return found
