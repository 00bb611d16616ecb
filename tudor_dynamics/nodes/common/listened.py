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

"""Topics that are published only while somebody listens, without asking so at every sample."""

from __future__ import annotations

import math

from rclpy.publisher import Publisher

LOOK = 0.01
"""Time between two counts of the subscriptions, which take 2 us each [s]."""


class ListenedPublisher:
    """A publisher with the knowledge whether anybody listens."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self.wanted = False

    def look(self) -> None:
        """Count the subscriptions."""
        self.wanted = self._publisher.get_subscription_count() > 0

    def publish(self, message: bytes) -> None:
        """Publish a message in its serialised form."""
        self._publisher.publish(message)


class ListenedPublishers:
    """All such publishers of a node; `look`, called at every sample, counts from time to time."""

    def __init__(self) -> None:
        self._all: list[ListenedPublisher] = []
        self._looked = -math.inf

    def add(self, publisher: Publisher) -> ListenedPublisher:
        """Add one."""
        self._all.append(ListenedPublisher(publisher))
        return self._all[-1]

    def look(self, now: float) -> bool:
        """Count where the last count is too old, and say so; ``now`` is monotonic [s]."""
        if now - self._looked < LOOK:
            return False
        self._looked = now
        for publisher in self._all:
            publisher.look()
        return True
