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

"""Node payload_estimator: what the arm carries, beside a predictor and a detector."""

from __future__ import annotations

from typing import Any

from rclpy.publisher import Publisher

from tudor_dynamics.nodes.common.base import OK
from tudor_dynamics.nodes.common.interfaces import PAYLOAD_TOPIC
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.online.coverage import CoverageLevel


class PayloadEstimatorNode(MonitorNode):
    """Estimator node; ``**kwargs`` go to rclpy's Node."""

    # It is a monitor, which knows what touches the arm, and keeps all but the load to itself.

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('payload_estimator', **kwargs)

    def publish_on(self, kind: Any, topic: str, *, latch: bool = False) -> Publisher:
        """Publish the load; residuals and collisions are those of other nodes."""
        return super().publish_on(kind, topic if topic == PAYLOAD_TOPIC else f'~/{topic}',
                                  latch=latch)

    def verdict(self) -> tuple[bytes, str]:
        """Say what it means for the load that contacts go unseen."""
        level, message = super().verdict()
        unsure = '' if self.watch is None else self.watch.outside_training
        blind = level != OK and (self.coverage.verdict.level is not CoverageLevel.ENOUGH
                                 or unsure != '' and message.startswith(unsure))
        return level, f'a touch may be estimated as a load, as {message}' if blind else message
