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

"""What a monitor keeps for the question why it alarmed: its messages, as a bag at an event."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from datetime import datetime
import json
from pathlib import Path
import shutil
from typing import Any

import numpy as np

from tudor_dynamics.bags.storage import Bag, METADATA, one_line, RawMessages, read_metadata
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.online.detector import CollisionEvent, Excess, time_of_day
from tudor_dynamics.online.settings import RECORDED, RING_BYTES, RING_TIME

EVENTS = 'tudor_events'
"""Key of the records of events among the custom data of a bag: JSON, a list of `record_of`."""


def record_of(event: CollisionEvent, excess: Excess) -> dict[str, Any]:
    """
    Give all that was known at the sample that made an event certain, as JSON has it.

    excess: that of the event's method. Stamps in ns, ``time``: the onset as local time; by channel
    in its unit; motion: q, dq, ddq of the active joints [rad or m, s].
    """
    channels = list(event.ratios)
    found = {'measured': excess.residual.measured, 'expected': excess.residual.predicted,
             'residual': excess.residual.value, 'threshold': excess.threshold,
             'ratio': np.array([event.ratios[name] for name in channels])}
    return {'onset': event.onset, 'stamp': event.stamp,
            'time': time_of_day(event.onset),
            'method': event.method, 'link': event.link,
            **{name: dict(zip(channels, values.tolist(), strict=True))
               for name, values in found.items()},
            'motion': excess.residual.motion.row.tolist()}


def records_of(bag: Bag) -> list[dict[str, Any]]:
    """Read the records of a bag; none where it has none."""
    try:
        found = json.loads(bag.custom.get(EVENTS, '[]'))
        for record in found:
            int(record['onset']), record['method'], dict(record['ratio']), dict(record['settings'])
    except (KeyError, RecursionError, TypeError, ValueError) as err:
        raise BagError(f'{EVENTS} in {METADATA} are no records of events ({one_line(err)})',
                       place=str(bag.path), remedy='copy the bag again') from None
    return list(found)


class MessageRing:
    """The messages of the last 30 s as they came, at most 64 MB of them."""

    def __init__(self) -> None:
        self._messages: deque[tuple[int, str, str, bytes]] = deque()
        self._bytes = 0
        self.last = 0

    def add(self, time: int, topic: str, msgtype: str, data: bytes) -> None:
        """Keep a message: when it arrived [ns]. No two have one time: their order is kept."""
        if time < self.last - round(RING_TIME * 1e9):  # the clock was set back
            self._messages.clear()
            self._bytes = self.last = 0
        self.last = time = max(time, self.last + 1)
        self._messages.append((time, topic, msgtype, data))
        self._bytes += len(data)
        oldest = time - round(RING_TIME * 1e9)
        while self._messages[0][0] < oldest or self._bytes > RING_BYTES:
            self._bytes -= len(self._messages.popleft()[3])

    def series(self) -> list[RawMessages]:
        """Give what is kept, topic by topic."""
        found: dict[tuple[str, str], list[tuple[int, bytes]]] = {}
        for time, topic, msgtype, data in tuple(self._messages):
            found.setdefault((topic, msgtype), []).append((time, data))
        return [RawMessages(*topic, np.array([time for time, _ in items]),
                            [data for _, data in items]) for topic, items in found.items()]


def write_events(
    folder: Path, series: list[RawMessages], records: list[dict[str, Any]],
) -> Path:
    """
    Write a bag of events into a folder, whole or not at all, or say why not by a BagError.

    Of bags that hold such records the oldest goes, where there are too many.
    """
    # by the clock on the wall: simulated time begins at 0 in every run
    path = folder / datetime.now().strftime('event_%Y%m%d_%H%M%S_%f')
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_bag(path, series, custom={EVENTS: json.dumps(records)})
        own = []
        for item in sorted(folder.glob(f'event_*/{METADATA}')):
            with suppress(BagError):
                if EVENTS in read_metadata(item.parent).custom:
                    own.append(item.parent)
        for old in own[:-RECORDED]:
            shutil.rmtree(old)
    except OSError as err:
        raise BagError(f'the bag of an event cannot be written: {err.strerror or err}',
                       place=folder, remedy='check path, rights and disk') from None
    return path
