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

"""A bag on its way out, message by message, or on its way in; undecoded either way."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
import shutil
import tempfile

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.writer import METADATA_VERSION, PLUGINS
from tudor_dynamics.errors import BagError


@dataclass(frozen=True, eq=False)
class Track:
    """
    All messages of a bag in the order in which they were recorded.

    Attributes
    ----------
    topics : dict of str to str
        Topic to message type.
    time : ndarray of int64, shape (n,)
        Log times [ns].
    topic : list of str
        Topic of each message.
    data : list of bytes
        CDR buffers.

    """

    topics: dict[str, str]
    time: NDArray[np.int64]
    topic: list[str]
    data: list[bytes]


def read_track(path: str | Path, topics: Collection[str] = ()) -> Track:
    """
    Read a bag for replay.

    Parameters
    ----------
    path : str or Path
        rosbag2 directory, ``.mcap`` or ``.db3``.
    topics : collection of str
        Topics wanted; all by default.

    Returns
    -------
    Track
        Messages.

    Raises
    ------
    BagError
        If the bag is damaged, empty, or lacks a topic.

    """
    bag = open_bag(path)
    wanted = [name if name.startswith('/') else f'/{name}' for name in topics]
    missing = [name for name in wanted if name not in bag.topics]
    if missing:
        msg = (f'{path}: no topic {", ".join(missing)}; it has {", ".join(sorted(bag.topics))}')
        raise BagError(msg)
    found = bag.read(wanted or list(bag.topics))
    time = np.concatenate([np.empty(0, np.int64), *(raw.log_time for raw in found.values())])
    if not len(time):
        msg = f'{path}: no messages; record again with the drivers running'
        raise BagError(msg)
    order = np.argsort(time, kind='stable').tolist()
    names = [name for name, raw in found.items() for _ in raw.data]
    data = [item for raw in found.values() for item in raw.data]
    return Track({name: raw.msgtype for name, raw in found.items()}, time[order],
                 [names[i] for i in order], [data[i] for i in order])


class LiveWriter:
    """
    Writes messages as they come; the bag appears under its name when it is closed.

    Parameters
    ----------
    path : str or Path
        Directory to make; must not exist.
    storage : {'mcap', 'sqlite3'}
        Storage format.

    Attributes
    ----------
    count : int
        Messages written.

    """

    def __init__(self, path: str | Path, storage: str = 'mcap') -> None:
        self.path = Path(path)
        if self.path.exists() or self.path.is_symlink():
            msg = f'{path}: exists already and is not overwritten; give another name or remove it'
            raise BagError(msg)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._scratch = Path(tempfile.mkdtemp(prefix=f'.{self.path.name}.',
                                                  dir=self.path.parent))
            self._writer = Writer(self._scratch / self.path.name, version=METADATA_VERSION,
                                  storage_plugin=PLUGINS[storage])
            self._writer.open()
        except OSError as err:
            msg = f'{path}: cannot be written ({err.strerror or err}); check path, rights and disk'
            raise BagError(msg) from None
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, object] = {}
        self.count = 0

    def add(self, topic: str, msgtype: str) -> bool:
        """Announce a topic; False for a type that this program does not know."""
        if topic not in self._connections:
            if msgtype not in self._typestore.types:
                return False
            self._connections[topic] = self._writer.add_connection(
                topic, msgtype, typestore=self._typestore)
        return True

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Write a message of a topic that was announced; ``time`` in ns."""
        self._writer.write(self._connections[topic], time, data)  # type: ignore[arg-type]
        self.count += 1

    def close(self) -> None:
        """Finish the bag and give it its name; without any message there is none."""
        try:
            self._writer.close()
            if self.count:
                (self._scratch / self.path.name).rename(self.path)
        except OSError as err:
            msg = f'{self.path}: cannot be finished ({err.strerror or err})'
            raise BagError(msg) from None
        finally:
            shutil.rmtree(self._scratch, ignore_errors=True)
