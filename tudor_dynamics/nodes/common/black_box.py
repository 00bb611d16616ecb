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

"""The black box of a monitor: its messages, kept for 30 s, become a bag at an event."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
from threading import Thread
from typing import Any

from tudor_dynamics.bags.storage import RawMessages
from tudor_dynamics.errors import BagError
from tudor_dynamics.nodes.common.base import TudorNode
from tudor_dynamics.online.black_box import MessageRing, write_events
from tudor_dynamics.online.settings import RECORDED_AFTER

OFF = 'off'


class BlackBox:
    """Keeps messages of a node; writes them in a thread of its own."""

    def __init__(self, node: TudorNode) -> None:
        self._node, self._ring = node, MessageRing()
        self._pending: list[dict[str, Any]] = []
        self._due = 0
        self._writer: Thread | None = None
        self._timer = node.every(0.5, self._look)

    def keeping(self, kind: Any, topic: str, take: Callable[[bytes], Any]) -> Any:
        """Keep the messages of a topic before something takes them."""
        if self._node.value('event_bags') == OFF:
            return take
        clock, ring = self._node.get_clock(), self._ring
        name = self._node.resolve_topic_name(topic)
        msgtype = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'

        def keep(data: bytes) -> Any:
            ring.add(clock.now().nanoseconds, name, msgtype, data)
            return take(data)
        return keep

    def event(self, record: dict[str, Any]) -> None:
        """Let a bag be written in 3 s; events until then go into the same."""
        if self._node.value('event_bags') == OFF:
            return
        if not self._pending:
            self._due = self._ring.last + round(RECORDED_AFTER * 1e9)
        self._pending.append({**record, 'state': self._node.status()[2], 'settings': {
            name: self._node.value(name) for name in self._node.params}})

    def _look(self) -> None:
        """Write what is due, also where messages have ended."""
        busy = self._writer is not None and self._writer.is_alive()
        now = self._node.get_clock().now().nanoseconds
        if self._pending and not busy and max(now, self._ring.last) >= self._due:
            records, self._pending = self._pending, []
            self._writer = Thread(target=self._write, args=(self._ring.series(), records))
            self._writer.start()

    def _write(self, series: list[RawMessages], records: list[dict[str, Any]]) -> None:
        home = os.environ.get('ROS_HOME') or '~/.ros'
        folder = Path(self._node.value('event_bags') or f'{home}/tudor_dynamics/events')
        try:
            path = write_events(
                folder.expanduser() / self._node.get_namespace().strip('/'), series, records)
            self._node.get_logger().info(f'the last 30 s are in {path}')
        except BagError as err:
            self._node.get_logger().error(str(err))

    def close(self) -> None:
        """Write what is pending."""
        if self._writer is not None:
            self._writer.join()
        if self._pending:
            self._write(self._ring.series(), self._pending)
