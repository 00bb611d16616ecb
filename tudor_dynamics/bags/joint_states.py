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

"""Topics that carry named values as arrays, and whether their messages keep their contract."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.layouts.carriers import (
    array_layout, DYNAMIC_JOINT_STATE, dynamic_layout, FLOAT64_MULTI_ARRAY)
from tudor_dynamics.bags.layouts.cdr import decode, MessageBatch
from tudor_dynamics.bags.layouts.cdr_layout import JOINT_STATE, joint_state_layout
from tudor_dynamics.bags.layouts.definitions import check_definition, EXPECTED
from tudor_dynamics.bags.storage.raw import Bag, RawMessages
from tudor_dynamics.errors import BagError

LAYOUTS = {JOINT_STATE: joint_state_layout, FLOAT64_MULTI_ARRAY: array_layout,
           DYNAMIC_JOINT_STATE: dynamic_layout}
"""Types of messages with named values; those of an array are named by their places."""


@dataclass(frozen=True, eq=False)
class DecodedTopic:
    """All messages of a topic of JointState, or of another type with named values."""

    topic: str  # name of the topic
    # When each was recorded, and its header stamp, zero where it has none, (n,) [ns].
    log_time: NDArray[np.int64]
    stamp: NDArray[np.int64]
    blocks: list[MessageBatch]  # messages by layout
    msgtype: str = JOINT_STATE  # type of the messages

    @property
    def stamped(self) -> bool:
        """Say whether messages of this type have a stamp."""
        return self.msgtype != FLOAT64_MULTI_ARRAY


def decode_joint_states(raw: RawMessages, path: str) -> DecodedTopic:
    """Decode a topic."""
    layout = LAYOUTS.get(raw.msgtype)
    if layout is None:
        msg = (f'{path}: topic {raw.topic} is of type {raw.msgtype}, expected {JOINT_STATE}; '
               'name another topic in the arm description')
        raise BagError(msg)
    try:
        blocks = decode(raw.data, layout, raw.topic)
    except BagError as err:
        raise err.at(path) from None
    stamp = np.zeros(len(raw.data), dtype=np.int64)
    for block in blocks:
        stamp[block.index] = block.stamp
    return DecodedTopic(raw.topic, raw.log_time, stamp, blocks, raw.msgtype)


def load_joint_states(bag: Bag, topics: Collection[str]) -> dict[str, DecodedTopic]:
    """Read and decode topics of a bag."""
    for name in topics:
        msgtype = bag.topics[name].msgtype if name in bag.topics else ''
        if msgtype in EXPECTED:
            for text in bag.definitions(msgtype):
                check_definition(msgtype, text, name, str(bag.path))
    return {name: decode_joint_states(raw, str(bag.path))
            for name, raw in bag.read(topics).items()}


def ranges_of_others(states: DecodedTopic, names: Sequence[str]) -> dict[str, float]:
    """
    Say how far joints move that are not asked for.

    Returns name to range of its positions, the outermost percents left out [rad or m].
    """
    found: dict[str, float] = {}
    for block in states.blocks:
        if not block.layout.fields.get('position', (0, 0))[1]:
            continue
        values = block.values('position')
        for i, name in enumerate(block.layout.names[:values.shape[1]]):
            column = values[:, i][np.isfinite(values[:, i])]
            if name not in names and len(column):
                low, high = np.percentile(column, [1.0, 99.0])
                found[name] = max(found.get(name, 0.0), float(high - low))
    return found


def check_lengths(states: DecodedTopic, names: Sequence[str], path: str) -> None:
    """Refuse messages whose arrays do not go with their names."""
    for block in states.blocks:
        layout = block.layout
        if not set(names) & set(layout.names):
            continue
        where = f'topic {states.topic}, message {block.index[0]}'
        for field, (_, size) in layout.fields.items():
            if size not in (0, len(layout.names)):
                msg = (f'{where}: {field} has {size} values for {len(layout.names)} names; a '
                       'JointState array has the length of name or is empty: repair the '
                       'publisher and record again')
                raise BagError(msg, place=path)
        for name in names:
            if layout.names.count(name) > 1:
                msg = (f'{where}: {name!r} stands in name {layout.names.count(name)} times; '
                       'repair the publisher and record again')
                raise BagError(msg, place=path)
