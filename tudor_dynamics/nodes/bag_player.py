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

"""Node bag_player: a bag replayed as it was recorded, no message decoded."""

from __future__ import annotations

from importlib import import_module
import time
from typing import Any

import numpy as np
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from tudor_dynamics.bags.storage import read_track, Track
from tudor_dynamics.errors import BagError, TudorError
from tudor_dynamics.nodes.common.base import Figure, OK, TudorNode
from tudor_dynamics.nodes.common.interfaces import CLOCK
from tudor_dynamics.nodes.common.messages import time_message


DELIVERY = Duration(seconds=2)  # longest time that readers get for what was published last


def message_class(msgtype: str) -> Any:
    """Find the class of a message type."""
    package, _, name = msgtype.replace('/msg/', '/').partition('/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise BagError(f'message type {msgtype} is not installed', remedy='install the package '
                       f"{package}, or leave its topics out of the parameter 'topics'") from None


class BagPlayerNode(TudorNode):
    """Player node; ``**kwargs`` go to rclpy's Node."""

    FIGURES: tuple[Figure, ...] = (
        Figure('bag', lambda node: node.value('bag')),
        Figure('skipped', lambda node: ', '.join(node.skipped) or None),
        Figure('messages in the bag', lambda node: None if node.fault or node.finished
               or node.track is None else len(node.track.data)))

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('bag_player', **kwargs)
        self.track: Track | None = None
        self.finished = False
        self._outputs: dict[str, Publisher] = {}
        self._clock_output = (self.create_publisher(Clock, CLOCK, 10)
                              if self.value('clock') else None)
        self.skipped: list[str] = []
        try:
            self._open()
        except TudorError as err:
            self.fail(err)
            if self.value('exit_at_end'):
                self.exit_code = 2
            return
        self._run_beside(self._play)

    def _open(self) -> None:
        bag, offset = self.value('bag'), float(self.value('start_offset'))
        if not bag:
            raise BagError("the parameter 'bag' is empty; set it to a rosbag2 directory or file")
        self.track = track = read_track(bag, self.value('topics'))
        self._first = int(np.searchsorted(track.time, track.time[0] + round(offset * 1e9)))
        if self._first == len(track.time):
            raise BagError(f'the bag lasts {(track.time[-1] - track.time[0]) * 1e-9:.3f} s, but '
                           f"the parameter 'start_offset' is {offset:g} s; lower it", place=bag)
        for topic, msgtype in track.topics.items():
            try:
                kind = message_class(msgtype)
            except BagError:
                if self.value('topics'):
                    raise
                self.skipped.append(f'{topic} ({msgtype})')
                continue
            # recorded names are absolute; relative ones can be remapped and get the namespace
            self._outputs[topic] = self.publish_on(kind, topic.lstrip('/'))

    def _play(self) -> None:
        closing = self._closing
        wanted = int(self.value('wait_for_subscribers'))
        while any(p.get_subscription_count() < wanted for p in self._outputs.values()):
            if closing.wait(0.02):
                return
        if wanted and closing.wait(0.3):  # a reader that is matched is not yet one that hears
            return
        while not closing.is_set():
            self._pass()
            if not self.value('loop'):
                break
        self.finished = True
        if self.value('exit_at_end') and not closing.is_set():
            for publisher in self._outputs.values():
                publisher.wait_for_all_acked(DELIVERY)
            self.exit_code = 0

    def _pass(self) -> None:
        """Publish all messages once, each when it is due."""
        track, first = self.track, self._first
        assert track is not None
        due, before = time.perf_counter(), int(track.time[first])
        for now, topic, data in zip(
                track.time[first:].tolist(), track.topic[first:], track.data[first:], strict=True):
            due += (now - before) * 1e-9 / float(self.value('rate'))
            before = now
            if self._closing.wait(max(due - time.perf_counter(), 0.0)):
                return
            publisher = self._outputs.get(topic)
            if publisher is None:
                continue
            begun = self.meter.begin()
            if self._clock_output is not None:
                self._clock_output.publish(Clock(clock=time_message(now)))
            publisher.publish(data)
            self.meter.end(begun)

    def verdict(self) -> tuple[bytes, str]:
        """Say how far the bag is; it has no input that could be missing."""
        if self.fault or (self.track is None and not self.finished):
            return super().verdict()
        if self.finished:
            return OK, 'the bag has been played to its end'
        return OK, 'waits for subscribers' if self.meter.count == 0 else 'plays the bag'
