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
Raw messages of a rosbag2 in sqlite3 or MCAP.

A bag is untrusted. Whatever its bytes are, what leaves this module is data or a BagError on one
line that names the file, the cause and the remedy.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader

from tudor_dynamics.bags.mcap_scan import Damaged, scan_mcap, Unusual
from tudor_dynamics.errors import BagError

REMEDIES = {
    '.db3': 'copy the file again, or recover what is left with `sqlite3 FILE .recover`',
    '.mcap': 'copy the file again, or recover what is left with `mcap recover`',
}


@dataclass(frozen=True)
class TopicInfo:
    """A topic as the bag announces it: name, message type, number of messages."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True, eq=False)
class RawMessages:
    """
    Messages of one topic, undecoded, in the order of their log times.

    Attributes
    ----------
    topic, msgtype : str
        Name and type, e.g. ``sensor_msgs/msg/JointState``.
    log_time : ndarray of int64, shape (n,)
        Time at which each message was recorded [ns].
    data : list of bytes
        CDR buffers with their encapsulation header; empty where only times were asked for.

    """

    topic: str
    msgtype: str
    log_time: NDArray[np.int64]
    data: list[bytes]


@dataclass(frozen=True, eq=False)
class Bag:
    """
    A bag that could be opened.

    Attributes
    ----------
    path : Path
        What the user named.
    storage : str
        ``sqlite3``, ``mcap`` or both.
    files : tuple of Path
        Storage files in their order.
    topics : dict of str to TopicInfo
        What the bag announces.
    sources : tuple of Path
        What rosbags is asked to open: the directory, or each file.
    packed : bool
        Whether messages or files are compressed by rosbag2.
    custom : dict of str to str
        What whoever recorded wrote into ``custom_data`` of the metadata.
    unfinished : frozenset of Path
        Files that break off, because their recorder was killed.

    """

    path: Path
    storage: str
    files: tuple[Path, ...]
    topics: Mapping[str, TopicInfo]
    sources: tuple[Path, ...]
    packed: bool
    custom: Mapping[str, str] = field(default_factory=dict)
    unfinished: frozenset[Path] = frozenset()

    def read(
        self, topics: Collection[str], *, with_data: bool = True,
    ) -> dict[str, RawMessages]:
        """
        Read raw messages.

        Parameters
        ----------
        topics : collection of str
            Names as in ``self.topics``; a name that is not there is an empty topic.
        with_data : bool
            Also keep the messages, not only their times.

        Returns
        -------
        dict of str to RawMessages
            Messages of each topic, ordered by log time (stable).

        Raises
        ------
        BagError
            If the storage is damaged, or a topic carries two types.

        """
        for name in topics:
            if name in self.topics and ',' in self.topics[name].msgtype:
                msg = (f'{self.path}: topic {name} carries messages of several types '
                       f'({self.topics[name].msgtype}); remap one of them and record again')
                raise BagError(msg)
        times: dict[str, list[int]] = {name: [] for name in topics}
        data: dict[str, list[bytes]] = {name: [] for name in topics}
        if not self._scan(times, data, with_data):
            for source in self.sources:
                _read_with_rosbags(source, times, data, with_data)
        return {name: self._ordered(name, times[name], data[name]) for name in topics}

    def _scan(
        self, times: dict[str, list[int]], data: dict[str, list[bytes]], with_data: bool,
    ) -> bool:
        if self.packed or any(file.suffix != '.mcap' for file in self.files):
            return False
        try:
            scans = [scan_mcap(file, tuple(times), with_data=with_data,
                               unfinished=file in self.unfinished) for file in self.files]
        except Unusual:
            return False
        except Damaged as err:
            msg = f'{self.path}: damaged ({err}); {REMEDIES[".mcap"]}'
            raise BagError(msg) from None
        for name in times:
            count = sum(len(scan[name].log_time) for scan in scans)
            if count != (self.topics[name].count if name in self.topics else 0):
                return False
        for scan in scans:
            for name, found in scan.items():
                times[name] += found.log_time
                data[name] += found.data
        return True

    def _ordered(self, name: str, times: list[int], data: list[bytes]) -> RawMessages:
        msgtype = self.topics[name].msgtype if name in self.topics else ''
        try:
            log_time = np.array(times, dtype=np.int64)
        except (OverflowError, TypeError, ValueError):
            msg = (f'{self.path}: topic {name} has log times that are no times; '
                   f'{REMEDIES[self.files[0].suffix]}')
            raise BagError(msg) from None
        if len(times) > 1 and np.any(np.diff(log_time) < 0):
            order = np.argsort(log_time, kind='stable')
            log_time = log_time[order]
            data = [data[i] for i in order] if data else data
        return RawMessages(name, msgtype, log_time, data)

    def checksum(self) -> str:
        """
        Give the SHA-256 over the storage files, one after the other.

        Returns
        -------
        str
            Hexadecimal digest.

        """
        digest = hashlib.sha256()
        try:
            for file in self.files:
                with file.open('rb') as stream:
                    while block := stream.read(1 << 20):
                        digest.update(block)
        except OSError as err:
            msg = f'{self.path}: cannot be read ({err.strerror}); check the permissions'
            raise BagError(msg) from None
        return digest.hexdigest()


def one_line(err: BaseException) -> str:
    """Put the text of an exception on one line of bounded length."""
    text = ' '.join(str(err).split()) or 'no reason given'
    return text if len(text) <= 300 else text[:300] + '...'


@contextmanager
def guard(path: Path) -> Iterator[None]:
    """Turn whatever a parser raises on the bytes of a file into a BagError."""
    # Damaged bytes reach rosbags' parsers, apsw, lz4 and zstd; what these raise is not one
    # family (struct.error, AssertionError, TypeError, MemoryError, apsw.Error, ...).
    try:
        yield
    except BagError:
        raise
    except PermissionError:
        msg = f'{path}: cannot be read (permission denied); check the permissions'
        raise BagError(msg) from None
    except Exception as err:
        remedy = REMEDIES.get(path.suffix, 'check the bag with `ros2 bag info`')
        if path.suffix == '.db3' and any(char in str(path) for char in '?#%'):
            remedy = 'its path contains ?, # or %, which SQLite cannot open: rename it'
        cause = one_line(err).replace(f'{path}/', '').replace(str(path), path.name)
        msg = f'{path}: damaged or no rosbag2 storage ({cause}); {remedy}'
        raise BagError(msg) from None


def _read_with_rosbags(
    source: Path,
    times: dict[str, list[int]],
    data: dict[str, list[bytes]],
    with_data: bool,
) -> None:
    with guard(source), Reader(source) as reader:
        connections = [item for item in reader.connections if item.topic in times]
        if not connections:
            return
        sinks = {item.topic: (times[item.topic].append, data[item.topic].append)
                 for item in connections}
        if not with_data:
            for connection, log_time, _ in reader.messages(connections):
                sinks[connection.topic][0](log_time)
            return
        for connection, log_time, message in reader.messages(connections):
            add_time, add_data = sinks[connection.topic]
            add_time(log_time)
            add_data(message)
        for topic in sinks:
            for message in data[topic]:
                # sqlite3 can hand out text or numbers where a blob should be
                if not isinstance(message, bytes):
                    msg = (f'{source}: topic {topic} holds a {type(message).__name__} in place '
                           f'of a message; {REMEDIES[".db3"]}')
                    raise BagError(msg)
