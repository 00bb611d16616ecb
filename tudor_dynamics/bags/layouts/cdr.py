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

"""
Bulk decoding of CDR messages as arrays: JointState, WrenchStamped, arrays and interfaces.

Messages of one topic nearly always share one layout: the same names, the same fields, the same
frame, hence every number at the same place. The layout is parsed once, all messages that agree
with it in every structural byte are laid over each other, and their numbers are read as columns of
a structured array. A bag with several layouts is decoded group by group.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.layouts.cdr_layout import CdrError, Layout
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray

MAX_LAYOUTS = 256
"""Layouts in one topic; more are no recording of one arm, but would take for ever."""


@dataclass(frozen=True, eq=False)
class MessageBatch:
    """Messages of one layout."""

    index: NDArray[np.intp]  # their places among the messages of the topic, increasing, (n,)
    layout: Layout  # what they share
    records: NDArray[np.void]  # their numbers, one record a message, (n,)

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Header stamps, zero where the messages have none [ns]."""
        if not self.layout.stamped:
            return np.zeros(len(self.index), dtype=np.int64)
        seconds = self.records['sec'].astype(np.int64)
        return seconds * 1_000_000_000 + self.records['nanosec'].astype(np.int64)

    def values(self, field: str) -> FloatArray:
        """Give the values of a field; returns (n, length of the field)."""
        if self.layout.size(field) == 0:
            return np.empty((len(self.index), 0))
        if field in self.layout.scattered:
            values = np.full((len(self.index), len(self.layout.names)), np.nan)
            for column, place in enumerate(self.layout.scattered[field]):
                if place is not None:
                    values[:, column] = self.records[place[0]][:, place[1]]
            return values
        return np.ascontiguousarray(self.records[field], dtype=np.float64)


def _same_layout(rows: NDArray[np.uint8], layout: Layout) -> NDArray[np.bool_]:
    """Say which rows agree with the first one in every structural byte."""
    word: Any = np.uint32 if layout.length % 4 == 0 else np.uint8
    words = rows.view(word)
    mask = layout.significant.view(word)
    same = np.ones(len(rows), dtype=bool)
    places = np.flatnonzero(mask)
    for run in np.split(places, np.flatnonzero(np.diff(places) > 1) + 1):
        part = slice(int(run[0]), int(run[-1]) + 1)
        same &= ~np.any((words[:, part] ^ words[0, part]) & mask[part], axis=1)
    return same


def decode(
    messages: Sequence[bytes],
    parse: Callable[[bytes], Layout],
    topic: str,
) -> list[MessageBatch]:
    """Decode the messages of a topic."""
    lengths = np.fromiter(map(len, messages), dtype=np.int64, count=len(messages))
    blocks: list[MessageBatch] = []
    for length in np.unique(lengths).tolist():
        index = np.flatnonzero(lengths == length)
        chosen = messages if len(index) == len(messages) else [messages[i] for i in index.tolist()]
        rows = np.frombuffer(b''.join(chosen), dtype=np.uint8).reshape(len(index), length)
        while len(index):
            try:
                layout = parse(messages[int(index[0])])
            except CdrError as err:
                msg = (f'topic {topic}, message {index[0]}: {err}; the bag is damaged or '
                       'announces the wrong type')
                raise BagError(msg) from None
            if len(blocks) == MAX_LAYOUTS:
                msg = (f'topic {topic}: names, fields or frames change more than {MAX_LAYOUTS} '
                       'times; record the joints of one arm on one topic')
                raise BagError(msg)
            same = _same_layout(rows, layout)
            group = rows if same.all() else rows[same]
            blocks.append(MessageBatch(index[same], layout, group.view(layout.dtype).reshape(-1)))
            index, rows = index[~same], rows[~same]
    return sorted(blocks, key=lambda block: int(block.index[0]))
