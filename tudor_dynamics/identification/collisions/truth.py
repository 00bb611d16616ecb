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
What is known of the pushes of a bag: from a topic, from a table, or nothing.

Where nothing is known, an event is neither right nor false.
"""

from __future__ import annotations

from collections.abc import Sequence
import csv
from dataclasses import dataclass
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags import open_bag, read_flags, read_wrenches, Recording
from tudor_dynamics.bags.labels import BOOL
from tudor_dynamics.bags.sources import resolve
from tudor_dynamics.errors import BagError, UsageError
from tudor_dynamics.files import read_bounded
from tudor_dynamics.typing import FloatArray

FORCE = 0.01
"""Less is no push [N]."""
MERGE = 0.1
"""Pauses of the force that do not end a push [s]."""
TOPIC = 'applied_wrench'
"""Where forces that were applied on purpose are recorded."""
MAX_TABLE = 10_000_000
"""Bytes of a table of pushes that are read."""


@dataclass(frozen=True)
class KnownPush:
    """
    A push that was applied on purpose.

    Attributes
    ----------
    begin, end : int
        Stamps of its first and last sample [ns].
    force : float
        Largest force [N]; NaN where it is not known.

    """

    begin: int
    end: int
    force: float = float('nan')


@dataclass(frozen=True)
class Truth:
    """
    The pushes of a bag, as far as they are known.

    Attributes
    ----------
    source : str
        Where that is known from; empty where it is not.
    pushes : tuple of KnownPush
        Pushes that are known, in order.

    """

    source: str = ''
    pushes: tuple[KnownPush, ...] = ()

    @property
    def known(self) -> bool:
        """Say whether an event without a push is a false alarm."""
        return bool(self.source)


FREE = Truth('nothing touched the arm')
"""Truth of a recording of free motion."""


def find_truth(path: str, topic: str | None = None, clock: str = 'joint_states') -> Truth:
    """
    Read the pushes of a bag from a topic.

    Parameters
    ----------
    path : str
        Bag that may have pushes.
    topic : str, optional
        WrenchStamped, or Bool that is true while the arm is touched; by default
        ``applied_wrench``, which may be missing.
    clock : str
        JointState topic with the stamps of the recording.

    Returns
    -------
    Truth
        Unknown where no topic is named and there is no ``applied_wrench``.

    Raises
    ------
    BagError
        If the topic that was named is missing, or of another type.

    """
    name = topic or TOPIC
    found = resolve(name, (bag := open_bag(path)).topics, path)
    if found is not None and topic is not None and bag.topics[found].msgtype == BOOL:
        flags = read_flags(path, topic, clock)
        if flags is not None:
            return Truth(topic, _flagged(*flags))
    wrenches = read_wrenches(path, name)
    if wrenches is not None:
        return Truth(name, _pushes(wrenches.stamp, np.linalg.norm(wrenches.force, axis=1)))
    if topic is None:
        return Truth()
    msg = (f'{path}: there is no message on {topic}, from which pushes were to be read; name '
           'another topic, or give --pushes FILE.csv')
    raise BagError(msg)


def _pushes(stamp: NDArray[np.int64], size: FloatArray) -> tuple[KnownPush, ...]:
    where = np.flatnonzero(size > FORCE)
    if not len(where):
        return ()
    times = stamp[where]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(times) > MERGE * 1e9) + 1])
    ends = np.concatenate([starts[1:], [len(where)]])
    return tuple(KnownPush(int(times[a]), int(times[b - 1]), float(size[where[a:b]].max()))
                 for a, b in zip(starts.tolist(), ends.tolist(), strict=True))


def _flagged(stamp: NDArray[np.int64], touched: NDArray[np.bool_]) -> tuple[KnownPush, ...]:
    """Find where a flag that may be published on change alone is up, from rise to fall."""
    change = np.flatnonzero(np.diff(touched.astype(np.int8), prepend=0))
    rises = [int(stamp[k]) for k in change if touched[k]]
    falls = [int(stamp[k]) for k in change if not touched[k]]
    falls += [int(stamp[-1])] * (len(rises) - len(falls))
    return tuple(KnownPush(a, b) for a, b in zip(rises, falls, strict=True))


def table_of_pushes(path: str | Path) -> list[tuple[float, float]]:
    """
    Read a table of pushes, as a person writes it down.

    Parameters
    ----------
    path : str or Path
        Text with a line ``BEGIN,END`` for each push, seconds since the beginning of the bag; a
        first line may name the columns, what follows a ``#`` is a comment.

    Returns
    -------
    list of (float, float)
        Begin and end of each push [s].

    Raises
    ------
    UsageError
        If the file cannot be read or is no such table.

    """
    try:
        text = read_bounded(Path(path), MAX_TABLE).decode()
    except (OSError, ValueError) as err:
        msg = f'--pushes {path}: cannot be read ({err}); give a table of begin,end in seconds'
        raise UsageError(msg) from None
    lines = [line.split('#')[0].strip() for line in text.splitlines()]
    rows = [(number, row) for number, row in enumerate(
        next(csv.reader(io.StringIO(line)), []) for line in lines) if row]
    found = []
    for place, (number, row) in enumerate(rows):
        try:
            begin, end = float(row[0]), float(row[1])
        except (ValueError, IndexError):
            if place == 0 and len(row) >= 2:
                continue  # names of the columns
            begin, end = 0.0, -1.0
        if not 0.0 <= begin <= end < float('inf'):
            msg = (f'--pushes {path}, line {number + 1}: found {",".join(row)!r}, expected '
                   'begin,end in seconds since the beginning of the bag, such as 2.0,2.95')
            raise UsageError(msg)
        found.append((begin, end))
    return sorted(found)


def truth_of_table(
    rows: Sequence[tuple[float, float]], recording: Recording, source: str, begun: float = 0.0,
) -> Truth:
    """
    Put a table of pushes on the stamps of a recording.

    Parameters
    ----------
    rows : sequence of (float, float)
        Begin and end of each push [s].
    recording : Recording
        Signals of the bag, or of a part of it.
    source : str
        Name of the table.
    begun : float
        Time at which the part begins in its bag [s].

    Returns
    -------
    Truth
        Pushes by stamps.

    """
    first = int(recording.stamp[0]) - round(begun * 1e9)
    return Truth(source, tuple(KnownPush(first + round(begin * 1e9), first + round(end * 1e9))
                               for begin, end in rows))
