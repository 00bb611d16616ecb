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

"""What a monitor keeps for the question why it alarmed: messages, as a bag, and past it again."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
import json
from pathlib import Path
import shutil
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import Arm, array_places
from tudor_dynamics.bags.messages import DATA, JOINT_STATE, load_topics
from tudor_dynamics.bags.storage import Bag, METADATA, one_line, read_metadata
from tudor_dynamics.bags.writer import write_messages
from tudor_dynamics.errors import BagError
from tudor_dynamics.online.detector import CollisionEvent, Excess, time_of_day
from tudor_dynamics.online.monitor import FIELD, Found, Monitor
from tudor_dynamics.online.settings import BAGS, RECORD_ROWS, RECORD_TIME, RING_BYTES, RING_TIME
from tudor_dynamics.typing import FloatArray

Message = tuple[int, str, str, bytes]
"""When it arrived [ns], topic, type, data."""
EVENTS, STATES = 'tudor_events', 'tudor_states'
"""Keys among the custom data of a bag, as JSON: records of its events, a list of `record_of`; what
lasted for longer than the bag at the first of them."""
ASKED = 'tudor_asked'
"""Topic of what a monitor was asked for, in the ring alone: joint states with these names."""
ASKS = ('load', 'expect', 'reset')


def record_of(event: CollisionEvent, past: Iterable[Excess]) -> dict[str, Any]:
    """
    Give all that was known at the sample that made an event certain, as JSON has it.

    past: samples of the event's method. Stamps in ns, ``time``: the onset in UTC; by channel
    in its unit; channel: of the largest ratio; motion: q, dq, ddq of active joints [rad or m, s];
    last_second: rows: seconds from ``stamp``, measured, expected, threshold, ratio of the channel.
    """
    near = [item for item in past
            if 0 <= event.stamp - item.residual.motion.stamp <= RECORD_TIME * 1e9]
    place, excess = list(event.ratios).index(event.channel), near[-1]
    every = -(-len(near) // RECORD_ROWS)
    found = {'measured': excess.residual.measured, 'expected': excess.residual.predicted,
             'residual': excess.residual.value, 'threshold': excess.threshold,
             'ratio': excess.collision}
    rows = [((item.residual.motion.stamp - event.stamp) * 1e-9, item.residual.measured[place],
             item.residual.predicted[place], item.threshold[place], item.collision[place])
            for item in near[(len(near) - 1) % every::every]]
    return {'onset': event.onset, 'stamp': event.stamp, 'time': time_of_day(event.onset),
            'method': event.method, 'link': event.link, 'channel': event.channel,
            **{name: dict(zip(event.ratios, values.tolist(), strict=True))
               for name, values in found.items()},
            'motion': excess.residual.motion.row.tolist(),
            'last_second': [[float(f'{value:.7g}') for value in row] for row in rows]}


@contextmanager
def undamaged(bag: Bag, key: str, kinds: tuple[type[Exception], ...] = (
        AttributeError, LookupError, OverflowError, RecursionError, TypeError, ValueError),
) -> Iterator[None]:
    """Refuse records of events that hold what no monitor has written under a key."""
    try:
        yield
    except kinds as err:
        raise BagError(f'{METADATA} has damaged records of events (key {key}: {one_line(err)})',
                       place=str(bag.path), remedy='copy the bag again') from None


def records_of(bag: Bag) -> list[dict[str, Any]]:
    """Read the records of a bag; none where it has none."""
    with undamaged(bag, EVENTS):
        found = json.loads(bag.metadata.custom.get(EVENTS, '[]'))
        for record in found:
            int(record['onset']), record['method'], dict(record['ratio']), dict(record['settings'])
        return list(found)


class MessageRing:
    """The messages of the last 30 s as they came, at most 64 MB of them."""

    def __init__(self) -> None:
        self._messages: deque[Message] = deque()
        self._bytes = self.last = 0
        self._carried: tuple[Message, ...] = ()  # the last that is older and says the load

    def add(self, time: int, topic: str, msgtype: str, data: bytes) -> None:
        """Keep a message: when it arrived [ns]. No two have one time: their order is kept."""
        span = round(RING_TIME * 1e9)
        # those whose times are later all go where the clock was set back
        self.last = time = time if time < self.last - span else max(time, self.last + 1)
        self._messages.append((time, topic, msgtype, data))
        self._bytes += len(data)
        while self._messages and (
                not time - span <= self._messages[0][0] <= time or self._bytes > RING_BYTES):
            gone = self._messages.popleft()
            self._bytes -= len(gone[3])
            if gone[1].endswith(ASKED):
                self._carried = (gone,)

    def kept(self) -> tuple[Message, ...]:
        """Give what is kept now."""
        kept = tuple(self._messages)
        return tuple((kept[0][0] - 1, *gone[1:]) for gone in self._carried if kept) + kept


def write_events(
    folder: Path, messages: Iterable[Message], records: list[dict[str, Any]],
    states: dict[str, Any] | None = None,
) -> Path:
    """Write a bag of events, whole or not at all; the oldest goes where there are too many."""
    # by the clock on the wall: simulated time begins at 0 in every run
    path = folder / datetime.now(timezone.utc).strftime('event_%Y%m%d_%H%M%S_%f')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_messages(path, messages, custom={
            EVENTS: json.dumps(records), STATES: json.dumps(states or {})})
        own = []
        for item in sorted(folder.glob(f'event_*/{METADATA}')):
            with suppress(BagError):
                if EVENTS in read_metadata(item.parent).custom:
                    own.append(item.parent)
        for old in own[:-BAGS]:
            shutil.rmtree(old)
    except OSError as err:
        raise BagError(f'the bag of an event cannot be written: {err.strerror or err}',
                       place=folder, remedy='check path, permissions and disk space') from None
    return path


# -- A bag past a monitor, message by message, as the node heard it: gaps and delays included

@dataclass(frozen=True, eq=False)
class Heard:
    """One message as a monitor takes it."""

    time: int  # when it arrived [ns]
    stamp: int  # header stamp [ns]
    topic: str  # as the arm description names it
    # `q`, `dq`, `effort` and `strain` of the channels that the topic carries, as far as it does;
    # or `ASKED`: the load [kg], whether another one was announced, and whether all was reset
    fields: dict[str, FloatArray]


def messages_of(bag: Bag, arm: Arm) -> list[Heard]:
    """Read what a monitor of an arm listens to."""
    own = arm.spec.joint_topic
    wanted: dict[str, list[tuple[str, Sequence[str], str]]] = {
        own: [('q', arm.active_joints, 'position'), ('dq', arm.active_joints, 'velocity')],
        ASKED: [(ASKED, ASKS, 'position')]}
    for output, carried in arm.topics.items():
        for topic, names in carried.items():
            wanted.setdefault(topic, []).append((output, tuple(names), FIELD[output]))
    places = {topic: name for topic, name in bag.find(dict.fromkeys(wanted, JOINT_STATE)).items()
              if name is not None}
    if own not in places:
        raise BagError(f'the bag has no topic {own}', place=str(bag.path),
                       remedy='give a bag that the node monitor wrote, or one with that topic')
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
    for message in messages:
        fields = message.fields
        if ASKED in fields and np.isfinite(fields[ASKED]).all():
            monitor.watch.answer(*fields[ASKED].tolist())
        if message.topic == arm.spec.joint_topic:
            if 'q' not in fields:
                continue
            yield message, monitor.add_joints(message.stamp, fields['q'], fields.get('dq'))
        for output in monitor.watch.outputs:
            if output in fields:
                for stamp, whole in monitor.watch.gather(
                        output, message.topic, message.stamp, fields[output]):
                    yield message, monitor.add_measured(output, stamp, whole)
