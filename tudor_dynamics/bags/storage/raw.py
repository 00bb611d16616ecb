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
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
import hashlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.bags.storage.mcap_scan import scan_mcap
from tudor_dynamics.bags.storage.mcap_summary import mcap_channels, mcap_definitions
from tudor_dynamics.bags.storage.sqlite_scan import scan_sqlite, sqlite_definitions
from tudor_dynamics.bags.storage.unpacking import Damaged, unpacked_file, Unpacker, ZSTD_MAGIC
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import open_regular

REMEDIES = {
    '.db3': 'copy the file again, or recover what is left with `sqlite3 FILE .recover`',
    '.mcap': 'copy the file again, or recover what is left with `mcap recover`',
}


@dataclass(frozen=True)
class TopicInfo:
    """A topic as the bag announces it: name, message type, number of messages."""

    name: str
    msgtype: str  # type of its messages
    count: int  # number of messages


@dataclass(frozen=True, eq=False)
class RawMessages:
    """Messages of one topic, undecoded, in the order of their log times."""

    # Name and type, e.g. `sensor_msgs/msg/JointState`.
    topic: str
    msgtype: str
    log_time: NDArray[np.int64]  # time at which each message was recorded, (n,) [ns]
    # CDR buffers with their encapsulation header; empty where only times were asked for.
    data: list[bytes]


@dataclass(frozen=True, eq=False)
class Bag:
    """A bag that could be opened."""

    path: Path  # what the user named
    storage: str  # `sqlite3`, `mcap` or both
    files: tuple[Path, ...]  # storage files in their order
    topics: Mapping[str, TopicInfo]  # what the bag announces
    # What rosbag2 has compressed, beside chunks; None where no metadata tell, so that each message
    # has to be looked at.
    compression: str | None = ''
    # What whoever recorded wrote into `custom_data` of the metadata.
    custom: Mapping[str, str] = field(default_factory=dict)
    # Files that break off, because their recorder was killed.
    unfinished: frozenset[Path] = frozenset()

    def read(
        self, topics: Collection[str], *, with_data: bool = True,
    ) -> dict[str, RawMessages]:
        """Read raw messages; topics: a name that is not there is an empty topic."""
        for name in topics:
            if name in self.topics and ',' in self.topics[name].msgtype:
                msg = (f'{self.path}: topic {name} carries messages of several types '
                       f'({self.topics[name].msgtype}); remap one of them and record again')
                raise BagError(msg)
        times: dict[str, list[int]] = {name: [] for name in topics}
        data: dict[str, list[bytes]] = {name: [] for name in topics}
        for file in self.files:
            with storage_file(file, self.compression) as opened:
                _read_file(opened, times, data, with_data, self.compression,
                           unfinished=file in self.unfinished)
        return {name: self._ordered(name, times[name], data[name]) for name in topics}

    def _ordered(self, name: str, times: list[int], data: list[bytes]) -> RawMessages:
        msgtype = self.topics[name].msgtype if name in self.topics else ''
        log_time = np.array(times, dtype=np.int64)
        if np.any(log_time[1:] < log_time[:-1]):
            order = np.argsort(log_time, kind='stable')
            log_time = log_time[order]
            data = [data[i] for i in order] if data else data
        return RawMessages(name, msgtype, log_time, data)

    def definitions(self, msgtype: str) -> list[str]:
        """Give what the bag says that a type of message is made of, file by file."""
        found = []
        for file in self.files:
            with storage_file(file, self.compression) as opened:
                texts = (sqlite_definitions(opened) if opened.suffix == '.db3' else
                         mcap_definitions(opened, unfinished=file in self.unfinished))
            if texts.get(msgtype):
                found.append(texts[msgtype])
        return found

    def checksum(self) -> str:
        """Give the SHA-256 over the storage files, one after the other."""
        digest = hashlib.sha256()
        try:
            for file in self.files:
                with open_regular(file) as stream:
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
def storage_file(file: Path, compression: str | None = '') -> Iterator[Path]:
    """Give a storage file as it can be read; what goes wrong with it becomes a BagError."""
    remedy = REMEDIES.get(Path(file.stem if compression == 'file' else file.name).suffix,
                          'check the bag with `ros2 bag info`')
    try:
        with unpacked_file(file) if compression == 'file' else nullcontext(file) as opened:
            yield opened
    except OSError as err:
        msg = f'{file}: cannot be read ({err.strerror or err}); check file and permissions'
        raise BagError(msg) from None
    except (Damaged, MemoryError) as err:
        msg = f'{file}: damaged or no rosbag2 storage ({one_line(err)}); {remedy}'
        raise BagError(msg) from None


def _read_file(
    file: Path,
    times: dict[str, list[int]],
    data: dict[str, list[bytes]],
    with_data: bool,
    compression: str | None,
    *,
    unfinished: bool,
) -> None:
    before = {name: len(messages) for name, messages in data.items()}
    if file.suffix == '.mcap':
        scans = scan_mcap(file, tuple(times), with_data=with_data, unfinished=unfinished,
                          channels=None if unfinished else mcap_channels(file))
        for name, found in scans.items():
            times[name] += found.log_time
            data[name] += found.data
    else:
        scan_sqlite(file, times, data, with_data=with_data)
    if compression not in ('message', None):
        return
    unpacker = Unpacker(file.stat().st_size)
    for name, messages in data.items():  # no CDR begins like a compressed message
        messages[before[name]:] = [
            unpacker.unpack(message, 'zstd')
            if compression == 'message' or message[:4] == ZSTD_MAGIC else message
            for message in messages[before[name]:]]
