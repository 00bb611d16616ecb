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

"""Readings of one output that arrive on several topics, put together to whole ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from tudor_dynamics.monitoring.pairing import Pairing
from tudor_dynamics.monitoring.stamps import StampGate
from tudor_dynamics.monitoring.state_filter import Motion
from tudor_dynamics.typing import FloatArray


class Gathering:
    """
    Puts readings of several topics together, on the stamps of the first topic.

    Equal stamps go together as they are; where they differ, the other topics are interpolated
    between their neighbours. Readings of a single topic pass as they are, in its order.
    """

    def __init__(self, channels: Sequence[str], topics: Mapping[str, Sequence[str]]) -> None:
        self.topics = tuple(topics)
        order = [name for names in topics.values() for name in names]
        self._order = [order.index(name) for name in channels]
        self._gate = StampGate()
        self._stages = [Pairing() for _ in self.topics[1:]]

    @property
    def drops(self) -> list[Counter[str]]:
        """Give the readings left out, by cause; one topic's pairing with the motion counts."""
        return [self._gate.drops, *(stage.drops for stage in self._stages)]

    def add(
        self, topic: str, stamp: int, values: FloatArray,
    ) -> list[tuple[int, FloatArray]]:
        """
        Take a message into account.

        stamp [ns], values (channels_of_topic,); returns (channels,).
        """
        if not self._stages:
            return [(stamp, values)]
        place = self.topics.index(topic)
        if place:
            done = [(pair.motion.stamp, np.concatenate([pair.motion.row, pair.measured]))
                    for pair in self._stages[place - 1].add_measured(stamp, values)]
        elif self._gate.step(stamp) is None:
            return []
        else:
            done = [(stamp, values)]
        for stage in self._stages[place:]:
            done = [(pair.motion.stamp, np.concatenate([pair.motion.row, pair.measured]))
                    for when, row in done
                    for pair in stage.add_motion(Motion(when, 0.0, 0.0, row), None)]
        return [(when, row[self._order]) for when, row in done]
