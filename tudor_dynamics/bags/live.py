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

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
import shutil

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.opening import open_bag
from tudor_dynamics.bags.saving import SavedWriter
from tudor_dynamics.bags.writer import FAILURES, METADATA_VERSION, PLUGINS, reason
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import scratch_folder

RESERVE, RESERVED = 'reserve', 1 << 20
"""File and bytes that are kept for index and metadata."""


@dataclass(frozen=True, eq=False)
class Track:
    """All messages of a bag in the order in which they were recorded."""

    topics: dict[str, str]  # topic to message type
    time: NDArray[np.int64]  # log times, (n,) [ns]
    topic: list[str]  # topic of each message
    data: list[bytes]  # messages as CDR buffers


def read_track(path: str | Path, topics: Collection[str] = ()) -> Track:
    """Read a bag for replay; topics: all by default."""
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

    Until then it lies in a hidden directory beside. What was saved there can be read whatever
    becomes of the process, see `open_bag`. A disk that becomes full ends the bag with what was
    saved: room for that is kept from the start.
    """

    def __init__(self, path: str | Path, storage: str = 'mcap') -> None:
        self.path = Path(path)
        if self.path.exists() or self.path.is_symlink():
            msg = f'{path}: exists already and is not overwritten; give another name or remove it'
            raise BagError(msg)
        scratch: Path | None = None
        try:
            scratch = scratch_folder(self.path)
            (scratch / RESERVE).write_bytes(bytes(RESERVED))
            writer = Writer(scratch / self.path.name, version=METADATA_VERSION,
                            storage_plugin=PLUGINS[storage])
            writer.open()
            self._bag = SavedWriter(writer, storage)
        except FAILURES as err:
            if scratch is not None:
                shutil.rmtree(scratch, ignore_errors=True)
            msg = f'{path}: cannot be written ({reason(err)}); check path, rights and disk'
            raise BagError(msg) from None
        self._scratch = scratch
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, object] = {}
        self._open = True

    @property
    def count(self) -> int:
        """Messages written."""
        return self._bag.count

    def add(self, topic: str, msgtype: str) -> bool:
        """Announce a topic; False for a type that this program does not know."""
        if topic not in self._connections:
            if msgtype not in self._typestore.types:
                return False
            with self._ending():
                self._connections[topic] = self._bag.writer.add_connection(
                    topic, msgtype, typestore=self._typestore)
                self._bag.save()
        return True

    def write(self, topic: str, time: int, data: bytes) -> None:
        """
        Write a message of a topic that was announced; ``time`` in ns.

        time [ns].
        """
        with self._ending():
            self._bag.writer.write(self._connections[topic], time, data)

    def save(self) -> None:
        """Bring what was written to disk, where it outlives the process."""
        with self._ending():
            self._bag.save()

    def close(self) -> None:
        """Finish the bag and give it its name; without any message there is none."""
        if self._open:
            self.save()
        if self._open:
            self._finish('')

    @contextmanager
    def _ending(self) -> Iterator[None]:
        """End the bag with what was saved if the disk takes no more."""
        try:
            yield
        except FAILURES as err:
            self._finish(f'cannot be written any more ({reason(err)})')

    def _finish(self, failure: str) -> None:
        """Finish the bag, and raise what has failed."""
        self._open = False
        made = self._scratch / self.path.name
        try:
            (self._scratch / RESERVE).unlink()
            if failure:
                self._bag.restore()
            count = self._bag.count
            try:
                self._bag.writer.close()
            except FAILURES as err:
                failure = failure or f'cannot be finished ({reason(err)})'
                self._bag.writer.abort()
                (made / 'metadata.yaml.tmp').unlink(missing_ok=True)
            if count:
                made.rename(self.path)
            shutil.rmtree(self._scratch, ignore_errors=True)
        except FAILURES as err:
            msg = (f'{self.path}: {failure or "cannot be finished"}; what was recorded is left in '
                   f'{made} ({reason(err)})')
            raise BagError(msg) from None
        if failure:
            msg = (f'{self.path}: {failure}; recording has ended, the {count} messages that were '
                   'on disk are kept; make room and record on under another name')
            raise BagError(msg)
