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

"""Ground truth of collisions in a bag: forces that were applied on purpose, and flags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.alignment import increasing
from tudor_dynamics.bags.joint_states import load_joint_states
from tudor_dynamics.bags.layouts.cdr import decode
from tudor_dynamics.bags.layouts.cdr_layout import wrench_layout, WRENCH_STAMPED
from tudor_dynamics.bags.layouts.messages import WrenchSeries
from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.sources import resolve
from tudor_dynamics.bags.storage.raw import Bag
from tudor_dynamics.errors import BagError

BOOL = 'std_msgs/msg/Bool'
BOOL_BYTES = 5
"""A Bool behind its encapsulation header."""


def _topic_of(bag: Bag, topic: str, known: Sequence[str], path: str | Path) -> str | None:
    """Find a topic of the first of some types; None where it is not there, or is empty."""
    name = resolve(topic, bag.topics, str(path))
    if name is None or not bag.topics[name].count:
        return None
    if bag.topics[name].msgtype != known[0]:
        msg = (f'{path}: topic {name} is of type {bag.topics[name].msgtype}, expected '
               f'{" or ".join(known)}; name another topic')
        raise BagError(msg)
    return name


def read_wrenches(path: str | Path, topic: str = 'applied_wrench') -> WrenchSeries | None:
    """
    Read the wrenches of a bag.

    Returns None where the bag has no such topic, or no message in it.
    """
    bag = open_bag(path)
    name = _topic_of(bag, topic, (WRENCH_STAMPED,), path)
    if name is None:
        return None
    raw = bag.read([name])[name]
    try:
        blocks = decode(raw.data, wrench_layout, name)
    except BagError as err:
        raise err.at(path) from None
    if not blocks:
        return None
    order = np.argsort(np.concatenate([block.index for block in blocks]))
    stamp = np.concatenate([block.stamp for block in blocks])[order]
    values = np.concatenate([block.values('wrench') for block in blocks])[order]
    keep = increasing(stamp).keep
    names = np.concatenate([[block.layout.frame_id] * len(block.index) for block in blocks])
    return WrenchSeries(name, stamp[keep], values[keep, :3], values[keep, 3:],
                        tuple(names[order][keep].tolist()))


def read_flags(
    path: str | Path, topic: str, clock: str = 'joint_states',
) -> tuple[NDArray[np.int64], NDArray[np.bool_]] | None:
    """
    Read a Bool topic, which has no stamps of its own, on the header stamps of another.

    Returns (n,) [ns], None where the bag has no such topic, or no message in it.
    """
    bag = open_bag(path)
    name = _topic_of(bag, topic, (BOOL, WRENCH_STAMPED), path)
    if name is None:
        return None
    raw = bag.read([name])[name]
    if any(not BOOL_BYTES <= len(data) < BOOL_BYTES + 8 or data[4] > 1 for data in raw.data):
        msg = f'{path}: topic {name} has messages that are no {BOOL}; the bag is damaged'
        raise BagError(msg)
    joints = resolve(clock, bag.topics, str(path))
    shift = 0
    if joints is not None:
        known = load_joint_states(bag, [joints])[joints]
        if known.stamp.any():
            shift = int(np.median(known.stamp - known.log_time))
    order = np.argsort(raw.log_time, kind='stable')
    return raw.log_time[order] + shift, np.array([data[4] != 0 for data in raw.data])[order]
