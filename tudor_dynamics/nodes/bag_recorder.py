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

"""Node bag_recorder: topics to a rosbag2, no message decoded."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from tudor_dynamics.bags.writer import LiveWriter
from tudor_dynamics.errors import BagError, TudorError
from tudor_dynamics.nodes.bag_player import message_class
from tudor_dynamics.nodes.common.base import Figure, TudorNode
from tudor_dynamics.nodes.settings import RECORDER_DEPTH, SAVE, TOPICS_LOOK

DELIVERY = Duration(seconds=1)  # longest time that readers get for the last diagnosis
IGNORED = ('/rosout', '/parameter_events')


class BagRecorderNode(TudorNode):
    """Recorder node; ``**kwargs`` go to rclpy's Node."""

    FIGURES: tuple[Figure, ...] = (
        Figure('bag', lambda node: node.value('bag')),
        Figure('topics', lambda node: ', '.join(
            sorted(topic for topic, heard in node.recorded.items() if heard)) or 'none'))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('bag_recorder', **kwargs)
        self.writer: LiveWriter | None = None
        self.recorded: dict[str, Any] = {}
        self._own = 'the topics to record'
        try:
            if not self.value('bag'):
                raise BagError("the parameter 'bag' is empty; set it to the directory to create")
            self.writer = LiveWriter(self.value('bag'), self.value('storage'))
        except TudorError as err:
            self.fail(err)
            return
        self._wanted = {self.resolve_topic_name(name) for name in self.value('topics')}
        self._look()
        self._regular = [self.every(TOPICS_LOOK, self._look), self.every(SAVE, self._save)]

    def _to_bag(self, action: Callable[..., Any], *args: Any) -> Any:
        """Do something with the bag; one that takes no more ends the process."""
        try:
            return action(*args)
        except BagError as err:
            self.writer = None
            self.exit_code = 1
            self.fail(err)
            self.publish_diagnostics()
            self._diagnostics.wait_for_all_acked(DELIVERY)
            return None

    def _save(self) -> None:
        if self.writer is not None:
            self._to_bag(self.writer.save)

    def _look(self) -> None:
        """Subscribe to topics that have appeared."""
        if self.writer is None:
            return
        for topic, types in self.get_topic_names_and_types():
            if topic in self.recorded or (topic not in self._wanted if self._wanted
                                          else topic in IGNORED):
                continue
            offers = self.get_publishers_info_by_topic(topic)
            if offers:
                self._record(topic, types[0], [offer.qos_profile for offer in offers])

    def _record(self, topic: str, msgtype: str, offers: list[QoSProfile]) -> None:
        if self.writer is None:
            return
        try:
            kind = message_class(msgtype)
        except BagError as err:
            self.recorded[topic] = None
            self.get_logger().warning(f'{topic} is not recorded: {err}')
            return
        known = self._to_bag(self.writer.add, topic, msgtype)
        if known is None:
            return
        if not known:
            self.recorded[topic] = None
            self.get_logger().warning(f'unknown type {msgtype}; record {topic} by ros2 bag record')
            return
        reliable = all(q.reliability == ReliabilityPolicy.RELIABLE for q in offers)
        kept = all(q.durability == DurabilityPolicy.TRANSIENT_LOCAL for q in offers)
        qos = QoSProfile(
            depth=RECORDER_DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=(DurabilityPolicy.TRANSIENT_LOCAL if kept
                        else DurabilityPolicy.VOLATILE))
        self.recorded[topic] = self.create_subscription(
            kind, topic, partial(self._on_message, topic), qos, raw=True)

    def _on_message(self, topic: str, data: bytes) -> None:
        begun = self.meter.begin()
        if self.writer is not None:
            self._to_bag(self.writer.write, topic, self.get_clock().now().nanoseconds, data)
        self.meter.end(begun)

    def close(self) -> None:
        writer, self.writer = self.writer, None
        if writer is not None:
            self._to_bag(writer.close)
