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

"""A node whose faults do not end the process: what its callbacks raise is kept, not passed on."""

from __future__ import annotations

from collections.abc import Callable
import traceback
from typing import Any

from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer


class GuardedNode(Node):
    """
    Mix-in for a node beside others in one process; before the class of the node.

    An executor passes on what a callback raises, and so ends every node that it serves. Here the
    node alone falls silent, until whoever looks after it makes another one.
    """

    failure = ''  # what a callback raised, with its traceback; empty while nothing has

    def _call(self, callback: Callable[..., Any], *args: Any) -> Any:
        if self.failure:
            return None
        try:
            return callback(*args)
        except Exception:  # whatever it is, the other nodes go on
            self.failure = traceback.format_exc()
            return None

    def create_subscription(  # type: ignore[override]
        self, kind: Any, topic: str, callback: Callable[[Any], None], *args: Any, **options: Any,
    ) -> Subscription:
        """Subscribe as rclpy does."""
        return super().create_subscription(
            kind, topic, lambda message: self._call(callback, message), *args, **options)

    def create_timer(  # type: ignore[override]
        self, period: float, callback: Callable[[], None], *args: Any, **options: Any,
    ) -> Timer:
        """Make a timer as rclpy does."""
        return super().create_timer(period, lambda: self._call(callback), *args, **options)

    def create_service(  # type: ignore[override]
        self, kind: Any, name: str, callback: Callable[[Any, Any], Any], *args: Any,
        **options: Any,
    ) -> Service:
        """Offer a service as rclpy does; a node that has failed answers with nothing done."""
        def answer(request: Any, response: Any) -> Any:
            done = self._call(callback, request, response)
            return response if done is None else done
        return super().create_service(kind, name, answer, *args, **options)
