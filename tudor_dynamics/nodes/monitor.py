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

"""Node monitor: filter, predictor and detector in one, with no message between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial
import os
from pathlib import Path
import shlex
from threading import Thread
import time
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rosbags.typesys import get_typestore, Stores
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from tudor_dynamics.errors import BagError
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.nodes.common.base import Figure
from tudor_dynamics.nodes.common.detection import DetectNode
from tudor_dynamics.nodes.common.interfaces import JOINT_MOTION, PREDICTED
from tudor_dynamics.nodes.common.messages import (
    JointSample, JointStateEncoder, ListenedPublisher, MotionEncoder, NamedReader)
from tudor_dynamics.online.black_box import ASKED, ASKS, Message, MessageRing, write_events
from tudor_dynamics.online.monitor import FIELD, Monitor
from tudor_dynamics.online.settings import RECORDED_AFTER


OFF = 'none', 'off'  # a bare off is a truth value in YAML


class BlackBox:
    """Keeps messages of a node; writes them in a thread of its own."""

    def __init__(self, node: DetectNode) -> None:
        self._node, self._ring = node, MessageRing()
        self._pending: list[dict[str, Any]] = []
        self._states: dict[str, Any] = {}
        self._due = 0
        self._writer: Thread | None = None
        self._closing = False  # no sample waits any more
        self.last: dict[str, str] = {}  # what the diagnostics say of the last bag

    def keeping(self, kind: Any, topic: str, take: Callable[[bytes], Any]) -> Any:
        """Keep the messages of a topic before something takes them."""
        if self._node.value('event_bags') in OFF:
            return take
        # the first use takes 60 ms, which the thread that writes would take from the loop
        get_typestore(Stores.ROS2_JAZZY)
        # a quarter of the time of the clock's own now() (bench/monitor_cost.py)
        now, ring = self._node.get_clock().handle.get_now, self._ring
        name = self._node.resolve_topic_name(topic)
        msgtype = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'

        def keep(data: bytes) -> Any:
            ring.add(now().nanoseconds, name, msgtype, data)
            return take(data)
        return keep

    def event(self, record: dict[str, Any], states: Callable[[], dict[str, Any]]) -> None:
        """Let a bag be written in 3 s; events until then go into the same."""
        if self._node.value('event_bags') in OFF:
            return
        if not self._pending:
            self._due = self._ring.last + round(RECORDED_AFTER * 1e9)
            self._states = states()
        self._pending.append(record)

    def look(self) -> None:
        """Write what is due, also where messages have ended."""
        busy = self._writer is not None and self._writer.is_alive()
        now = self._node.get_clock().now().nanoseconds
        if self._pending and not busy and max(now, self._ring.last) >= self._due:
            records, self._pending = self._pending, []
            self._writer = Thread(target=self._write, args=(
                self._ring.kept(), records, self._states))
            self._writer.start()

    def _write(self, messages: tuple[Message, ...], records: list[dict[str, Any]],
               states: dict[str, Any]) -> None:
        home = os.environ.get('ROS_HOME') or '~/.ros'
        folder = Path(self._node.value('event_bags') or f'{home}/tudor_dynamics/events')
        try:
            path = write_events(
                folder.expanduser().absolute() / self._node.get_namespace().strip('/'),
                self._paced(messages), records, states)
            self.last = {'last bag': str(path), 'events in it': ', '.join(
                record['time'] for record in records)}
            command = shlex.join(['tudor', 'why', str(path)])
            self._node.get_logger().info(f'to see why: {command} (the last 30 s)')
        except BagError as err:
            self._node.get_logger().error(str(err))

    def _paced(self, messages: tuple[Message, ...]) -> Iterator[Message]:
        """Rest between messages: else samples wait for up to 20 ms (bench/node_rates.py)."""
        for number, message in enumerate(messages):
            if not (self._closing or number % 20):
                time.sleep(1e-3)
            yield message

    def close(self) -> None:
        """Write what is pending."""
        self._closing = True
        if self._writer is not None:
            self._writer.join()
        if self._pending:
            self._write(self._ring.kept(), self._pending, self._states)


class MonitorNode(DetectNode):
    """Monitor node; ``**kwargs`` go to rclpy's Node."""

    CHAIN = Monitor
    FIGURES: tuple[Figure, ...] = (Figure('', lambda box: box.last, '_box'),)

    def __init__(self, name: str = 'monitor', **kwargs: Any) -> None:
        self._box = BlackBox(self)  # hears what the base subscribes to
        super().__init__(name, **kwargs)
        self._looking = self.every(0.5, self._box.look)
        self.monitor: Monitor | None = None
        self._motion = ListenedPublisher(self.publish_on(JointTrajectory, JOINT_MOTION))
        self._predicted = {output: ListenedPublisher(self.publish_on(JointState, topic))
                           for output, topic in PREDICTED.items()}
        self._joint_drops: Counter[str] = Counter()
        self._inputs: dict[str, Any] = {}
        self.start()

    def use(self, bundle: ModelBundle, prepared: Monitor) -> None:
        if self.monitor is not None and self.bundle is not None and (
                bundle.preprocessing == self.bundle.preprocessing):
            prepared.filter = self.monitor.filter
        own = self._own = bundle.arm.spec.joint_topic
        self.adopt(bundle, prepared, own, (self._joint_drops, prepared.filter.drops), {})
        self.monitor = prepared
        self._motion.encoder = MotionEncoder(bundle.arm.active_joints)
        for output, publisher in self._predicted.items():
            publisher.encoder = JointStateEncoder(bundle.arm.channels[output], (FIELD[output],))
        self._joints = NamedReader(bundle.arm.active_joints, self._joint_drops)
        measured = [topic for output in prepared.watch.outputs
                    for topic in bundle.arm.topics[output]]
        for topic in (own, *measured):
            if topic not in self._inputs:  # one each, whatever the topic carries
                self._inputs[topic] = self.hear_sensors(
                    bundle.arm, topic,
                    self._on_joints if topic == own else partial(self.on_measured, topic))

    def _on_joints(self, message: JointSample) -> None:
        begun = self.meter.begin()
        self.came(self._own, message.stamp)
        monitor = self.monitor
        if monitor is None:
            return
        q = self._joints.read(message, 'position')
        if q is None:
            return
        velocity = self._joints.read(message, 'velocity', optional=True)
        monitor.wanted = {output for output, publisher in self._predicted.items()
                          if output in monitor.watch.outputs or publisher.wanted}
        found = monitor.add_joints(message.stamp, q, velocity)
        motion = monitor.motion
        if motion is not None:
            self._motion.publish(motion.stamp, round(motion.elapsed * 1e9), motion.row)
            for output, values in (monitor.predicted or {}).items():
                self._predicted[output].publish(motion.stamp, values)
        self.report(found)
        self.measured(self._own, message)
        self.meter.end(begun)

    def subscribe(self, kind: Any, topic: str, callback: Any, **options: Any) -> Subscription:
        """Keep the messages, too."""
        take = callback if options.pop('raw', False) else (
            lambda data: callback(deserialize_message(data, kind)))
        return super().subscribe(
            kind, topic, self._box.keeping(kind, topic, take), raw=True, **options)

    def asked(self, what: str) -> None:
        """Keep it among the messages."""
        self._box.keeping(JointState, ASKED, len)(JointStateEncoder(ASKS, ('position',)).encode(
            0, np.array([self.port.load.mass if self.port.load else 0.0,
                         what == 'expect', what == 'reset'])))

    def keep(self, record: dict[str, Any], states: Callable[[], dict[str, Any]]) -> None:
        """Let a bag of the event be written."""
        self._box.event(record, states)

    def close(self) -> None:
        """Write the bag of an event that has just come."""
        self._box.close()

    def counters(self) -> list[Counter[str]]:
        more = [] if self.monitor is None else [self.monitor.filter.drops]
        return [*super().counters(), self._joint_drops, *more]
