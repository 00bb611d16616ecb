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

"""Streams: the values of chosen names in a topic, with stamps, before they are aligned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.joint_states import DecodedTopic
from tudor_dynamics.bags.notes import Notes
from tudor_dynamics.errors import BagError
from tudor_dynamics.typing import FloatArray

FEW = 0.05
"""Share of samples of a channel that may be no numbers and are left out with a warning."""
MAX_VALUE = 1e12
"""Nothing about an arm is larger in any unit; squares and products stay far from overflowing."""


@dataclass(frozen=True, eq=False)
class Stream:
    """Values of some names."""

    # For messages, e.g. `effort in /motor_currents`.
    what: str
    names: tuple[str, ...]  # names of the columns
    stamp: NDArray[np.int64]  # times of the samples, (n,) [ns]
    values: FloatArray  # in the units of the topic, (n, names)

    def at(self, rows: NDArray) -> Stream:
        """Give the stream with a selection of its rows."""
        return Stream(self.what, self.names, self.stamp[rows], self.values[rows])


def select(
    states: DecodedTopic,
    names: Sequence[str],
    field: str,
    stamp: NDArray[np.int64],
) -> tuple[Stream, NDArray[np.intp]]:
    """Take the values of names from all messages that have them: stamp [ns]."""
    rows, parts = [], []
    for block in states.blocks:
        layout = block.layout
        if layout.size(field) and set(names) <= set(layout.names):
            columns = [layout.names.index(name) for name in names]
            rows.append(block.index)
            parts.append(block.values(field)[:, columns])
    what = f'{field} in {states.topic}'
    if not rows:
        nothing = Stream(what, tuple(names), np.empty(0, np.int64), np.empty((0, len(names))))
        return nothing, np.empty(0, np.intp)
    index, values = np.concatenate(rows), np.concatenate(parts)
    if len(rows) > 1:
        order = np.argsort(index)
        index, values = index[order], values[order]
    return Stream(what, tuple(names), stamp[index], values), index


def choose_clock(
    topics: Mapping[str, DecodedTopic], notes: Notes, path: str,
) -> dict[str, NDArray[np.int64]]:
    """
    Take header stamps, or log times where a topic has no header stamps.

    A stamp of zero means "not set" in ROS. Streams with different clocks could not be aligned, so
    one topic without stamps sends all to their log times. Messages of a type that has no stamp get
    their log times less what stamped messages of the bag take to be recorded.

    Returns time of each message of each topic [ns].
    """
    unset = [name for name, states in topics.items()
             if states.stamped and len(states.stamp) > 1 and not states.stamp.any()]
    if not unset:
        delays = [states.log_time - states.stamp for states in topics.values() if states.stamped]
        delay = int(np.median(np.concatenate([*delays, np.zeros(0, np.int64)]))) if any(
            map(len, delays)) else 0
        for name, states in topics.items():
            if not states.stamped and len(states.stamp):
                notes.add(f'messages in {name} have no stamp: their log times count, less '
                          f'{delay * 1e-6:.3g} ms that stamped messages take to be recorded')
        return {name: states.stamp if states.stamped else states.log_time - delay
                for name, states in topics.items()}
    for name, states in topics.items():
        if len(states.stamp) > 1 and np.mean(np.diff(states.log_time) > 0) < 0.9:
            msg = (f'all header stamps in {", ".join(unset)} are zero and the log times '
                   f'in {name} do not increase; let the publisher set header.stamp and record '
                   'again')
            raise BagError(msg, place=path)
    notes.add(f'all header stamps in {", ".join(unset)} are zero; log times are used, which '
              'include the delays of the network')
    return {name: states.log_time for name, states in topics.items()}


def check_finite(stream: Stream, notes: Notes, path: str) -> Stream:
    """Mark samples that are no measured numbers, refuse channels that are mostly so."""
    bad = ~(np.abs(stream.values) <= MAX_VALUE)
    if not bad.any():
        return stream
    counts = bad.sum(axis=0)
    first = int(np.argmax(bad.any(axis=1)))
    seconds = (stream.stamp[first] - stream.stamp[0]) * 1e-9
    who = ', '.join(f'{name} {count}' for name, count in zip(stream.names, counts, strict=True)
                    if count)
    large = '' if not np.isfinite(stream.values[bad]).any() else f' or beyond {MAX_VALUE:g}'
    text = (f'{stream.what}: of {len(bad)} samples are NaN or infinite{large}: {who}, the first '
            f'at {seconds:.3f} s')
    if counts.max() > FEW * len(bad):
        msg = f'{text}; repair the driver or leave this channel out, and record again'
        raise BagError(msg, place=path)
    notes.add(f'{text}; left out')
    return Stream(stream.what, stream.names, stream.stamp,
                  np.where(bad, np.nan, stream.values))
