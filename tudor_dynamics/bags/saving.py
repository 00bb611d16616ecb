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
The way back of a bag that is being written: what is safe on disk, and how to return to it.

rosbags writes a bag for those who finish it. MCAP keeps up to a megabyte in memory, SQLite all of
the bag in one transaction; whoever is killed before the end has nothing, and whoever meets a full
disk has half a record at the end of the file. Here, what was saved stays.
"""

from __future__ import annotations

from collections import defaultdict
from io import BytesIO, FileIO
from typing import Any, Protocol

from rosbags.rosbag2 import Writer


class Saver(Protocol):
    """Way back of one storage."""

    def save(self) -> None:
        """Bring everything to disk."""

    def restore(self) -> None:
        """Forget what was written after the last `save`."""


class WholeFile(FileIO):
    """A file without buffer that writes all or raises; a buffer would keep what failed."""

    def write(self, data: Any) -> int:
        """Write all bytes; a disk that becomes full takes some of them first."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._some(rest):]
        return len(data)

    def _some(self, data: memoryview) -> int:
        return super().write(data)


class McapSaver:
    """MCAP: a chunk is ended, and the file cut behind the last whole one."""

    def __init__(self, writer: Any) -> None:
        self._storage = storage = writer.storage
        storage.bio.close()
        storage.bio = WholeFile(storage.path, 'r+')
        storage.bio.seek(0, 2)
        self._new_chunk = type(storage.chunk)
        self._mark()

    def _mark(self) -> None:
        storage = self._storage
        self._saved = (storage.bio.tell(), len(storage.chunks), dict(storage.channel_stats),
                       storage.message_start_time, storage.message_end_time)

    def save(self) -> None:
        """End the chunk."""
        if self._storage.chunk.msgs:
            self._storage.close_chunk()
        self._mark()

    def restore(self) -> None:
        """Cut the file."""
        storage = self._storage
        end, chunks, counts, first, last = self._saved
        storage.bio.seek(end)
        storage.bio.truncate()
        del storage.chunks[chunks:]
        storage.channel_stats = dict.fromkeys(storage.channel_stats, 0) | counts
        storage.message_start_time, storage.message_end_time = first, last
        storage.chunk = self._new_chunk(2**63 - 1, 0, BytesIO(), defaultdict(list))


class SqliteSaver:
    """SQLite: a transaction is ended, or taken back."""

    def __init__(self, writer: Any) -> None:
        self._connection = writer.storage.conn
        # what is not saved stays out of the file: a killed process leaves it whole
        self._connection.execute('PRAGMA cache_spill = OFF')

    def save(self) -> None:
        """Commit."""
        self._connection.commit()

    def restore(self) -> None:
        """Roll back."""
        self._connection.rollback()


class SavedWriter:
    """rosbags' writer with a way back."""

    def __init__(self, writer: Writer, storage: str) -> None:
        self.writer: Any = writer
        self._saver: Saver = McapSaver(writer) if storage == 'mcap' else SqliteSaver(writer)
        self._mark()

    def _mark(self) -> None:
        writer = self.writer
        self._saved = dict(writer.counts), writer.min_timestamp, writer.max_timestamp

    def save(self) -> None:
        """Bring everything to disk; what is there stays, whatever becomes of the process."""
        self._saver.save()
        self._mark()

    def restore(self) -> None:
        """Forget what was written after the last `save`."""
        self._saver.restore()
        counts, first, last = self._saved
        self.writer.counts = dict.fromkeys(self.writer.counts, 0) | counts
        self.writer.min_timestamp, self.writer.max_timestamp = first, last

    @property
    def count(self) -> int:
        """Messages written."""
        return sum(self.writer.counts.values())
