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

"""What bags show of an arm: topics, joints, and what may be efforts and strains."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
import math

from tudor_dynamics.bags.guess import STRAIN_WORDS
from tudor_dynamics.bags.info import BagReport
from tudor_dynamics.bags.layouts.carriers import DATA, DYNAMIC_JOINT_STATE, FLOAT64_MULTI_ARRAY
from tudor_dynamics.bags.layouts.cdr_layout import JOINT_STATE
from tudor_dynamics.errors import BagError

EFFORT_WORDS = ('effort', 'torque', 'current', 'tau')
"""Interfaces, and topics of arrays, that have one of these in their names carry efforts."""


@dataclass(frozen=True)
class Carrier:
    """One field of a topic, over all bags."""

    # Topic and type of its messages.
    topic: str
    msgtype: str
    field: str  # such as `effort`, `data`, or an interface
    # Name to the smallest and the largest finite value; only names that have one.
    ranges: dict[str, tuple[float, float]]
    rate: float  # messages a second [Hz]

    def changes(self, name: str) -> bool:
        """Say whether the value of a name ever changes."""
        low, high = self.ranges.get(name, (0.0, 0.0))
        return high > low

    def speaks_of(self, words: Collection[str]) -> bool:
        """Say whether topic or interface have one of some words in their names."""
        text = self.topic if self.msgtype != DYNAMIC_JOINT_STATE else self.field
        return any(word in text.lower() for word in words)


@dataclass(frozen=True)
class Survey:
    """What bags show."""

    positions: Carrier  # of the joints
    efforts: tuple[Carrier, ...]  # what may be efforts, the likeliest first
    strains: tuple[Carrier, ...]  # what may be strains
    seconds: float  # length of all bags [s]
    payloads: tuple[float, ...]  # masses at the tip that the bags tell of themselves [kg]


def carriers(reports: Sequence[BagReport]) -> list[Carrier]:
    """Put the fields of all topics of all bags together."""
    found: dict[tuple[str, str, str], dict[str, tuple[float, float]]] = {}
    rates: dict[str, float] = {}
    for topic in (topic for report in reports for topic in report.topics):
        for channel in topic.channels:
            ranges = found.setdefault((topic.name, topic.type, channel.field), {})
            if channel.minimum is None or channel.maximum is None:
                continue
            low, high = ranges.get(channel.name, (math.inf, -math.inf))
            ranges[channel.name] = min(low, channel.minimum), max(high, channel.maximum)
            rates[topic.name] = max(rates.get(topic.name, 0.0), topic.rate or 0.0)
    return [Carrier(*key, ranges, rates[key[0]]) for key, ranges in found.items() if ranges]


def survey(reports: Sequence[BagReport], known: Collection[str] = ()) -> Survey:
    """Say what bags show."""
    found = carriers(reports)
    strains = tuple(item for item in found if item.speaks_of(STRAIN_WORDS) and (
        item.msgtype != JOINT_STATE or item.field == 'position'))
    positions = [item for item in found if item.msgtype == JOINT_STATE
                 and item.field == 'position' and item not in strains]
    if not positions:
        msg = (f'no topic of type {JOINT_STATE} has positions, in '
               f'{", ".join(report.path for report in reports)}; record the joint states')
        raise BagError(msg)
    chosen = max(positions, key=lambda item: (
        len(set(item.ranges) & set(known)), any(map(item.changes, item.ranges)),
        item.topic.endswith('joint_states'), item.rate))
    named = [item for item in found if item not in strains and (
        item.msgtype == JOINT_STATE and item.field == 'effort'
        or item.msgtype == DYNAMIC_JOINT_STATE and item.speaks_of(EFFORT_WORDS))
        and set(item.ranges) & set(chosen.ranges)]
    arrays = [item for item in found if item.msgtype == FLOAT64_MULTI_ARRAY
              and item.field == DATA and item not in strains and item.speaks_of(EFFORT_WORDS)]
    named.sort(key=lambda item: (item.msgtype != JOINT_STATE, item.topic != chosen.topic))
    return Survey(chosen, (*named, *arrays), strains, sum(report.duration for report in reports),
                  tuple(sorted({report.payload for report in reports
                                if report.payload is not None})))
