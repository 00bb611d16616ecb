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

"""A bag past a monitor, message by message, as the node heard it: gaps and delays included."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from tudor_dynamics.arm.description import Arm, array_places
from tudor_dynamics.bags.messages import DATA, JOINT_STATE, load_topics
from tudor_dynamics.bags.storage import Bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.online.monitor import FIELD, Found, Monitor
from tudor_dynamics.online.streams import Gathering
from tudor_dynamics.typing import FloatArray


@dataclass(frozen=True, eq=False)
class Heard:
    """One message as a monitor takes it."""

    time: int  # when it arrived [ns]
    stamp: int  # header stamp [ns]
    topic: str  # as the arm description names it
    # `q`, `dq`, `effort` and `strain` of the channels that the topic carries, as far as it does
    fields: dict[str, FloatArray]


def messages_of(bag: Bag, arm: Arm) -> list[Heard]:
    """Read what a monitor of an arm listens to."""
    own = arm.spec.joint_topic
    wanted: dict[str, list[tuple[str, Sequence[str], str]]] = {
        own: [('q', arm.active_joints, 'position'), ('dq', arm.active_joints, 'velocity')]}
    for output, carried in arm.topics.items():
        for topic, names in carried.items():
            wanted.setdefault(topic, []).append(
                (output, tuple(names), FIELD[output]))
    places = {topic: name for topic, name in bag.find(dict.fromkeys(wanted, JOINT_STATE)).items()
              if name is not None}
    if own not in places:
        raise BagError(f'no topic {own}', place=str(bag.path),
                       remedy='give a bag of the node monitor, or of what it listens to')
    topics, arrays, found = load_topics(bag, list(places.values())), array_places(arm), []
    for topic, name in places.items():
        decoded = topics[name]
        rows: list[dict[str, FloatArray]] = [{} for _ in decoded.stamp]
        for key, of, part in wanted[topic]:
            columns: Sequence[str] = of
            if topic in arrays:
                columns, part = [str(arrays[topic][item]) for item in of], DATA
            for row, values in zip(*decoded.select(columns, part, str(bag.path)), strict=True):
                rows[row][key] = values
        stamps = decoded.stamp if decoded.stamped else decoded.log_time
        found += [Heard(time, stamp, topic, row) for time, stamp, row in zip(
            decoded.log_time.tolist(), stamps.tolist(), rows, strict=True)]
    return sorted(found, key=lambda message: message.time)


def replayed(
    messages: Iterable[Heard], arm: Arm, monitor: Monitor,
) -> Iterator[tuple[Heard, Found]]:
    """Let a monitor take messages as the node does: joint states first, then what they carry."""
    gathering = {output: Gathering(arm.channels[output], arm.topics[output])
                 for output in monitor.watch.outputs}
    for message in messages:
        fields = message.fields
        if message.topic == arm.spec.joint_topic:
            if 'q' not in fields:
                continue
            yield message, monitor.add_joints(message.stamp, fields['q'], fields.get('dq'))
        for output, stage in gathering.items():
            if output in fields:
                for stamp, whole in stage.add(message.topic, message.stamp, fields[output]):
                    yield message, monitor.add_measured(output, stamp, whole)
