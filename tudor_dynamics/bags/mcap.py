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

"""MCAP files: topics from the summary, and raw messages of chosen topics."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
import struct
from typing import BinaryIO
import zlib

from tudor_dynamics.bags.unpacking import Damaged, MAX_PIECE, Unpacker
from tudor_dynamics.files import open_regular


# -- Data section of an MCAP file: topics, and raw messages of chosen ones.
#
# Record by record through file objects, as rosbags reads MCAP, costs more than everything that
# follows, and nothing there bounds what a chunk unpacks to. This scan walks the records of a chunk
# in memory and checks every length and checksum. A file that nobody finished, because the recorder
# was killed or its disk was full, ends before the first record that is not whole.
#
# Format: https://mcap.dev/spec

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
STATISTICS, DATA_END = 0x0B, 0x0F
MAX_LOG_TIME = (1 << 63) - 1

RECORD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_BODY = _MESSAGE.size - RECORD.size
_CHUNK = struct.Struct('<QQQI')
_U16 = struct.Struct('<H')
_U32 = struct.Struct('<I')
_U64 = struct.Struct('<Q')


@dataclass
class Scan:
    """Raw messages of one topic."""

    # Message types announced for it, in their order.
    msgtypes: dict[str, None] = field(default_factory=dict)
    log_time: list[int] = field(default_factory=list)  # time of recording [ns]
    # Messages as they were on the wire; left empty where only times were asked for.
    data: list[bytes] = field(default_factory=list)


def _text(record: bytes, offset: int) -> tuple[str, int]:
    (size,) = _U32.unpack_from(record, offset)
    start = offset + _U32.size
    if start + size > len(record):
        raise Damaged('a string leaves its record')
    return record[start:start + size].decode(), start + size


class Channels:
    """Channels of a file and the topics they carry, as their records come by."""

    def __init__(self) -> None:
        self.topics: dict[int, tuple[str, str]] = {}
        self.definitions: dict[str, str] = {}
        self._schemas = {0: '__schemaless__'}

    def schema(self, record: bytes) -> None:
        """Take a schema; Damaged if it is another than before under its number."""
        (number,) = _U16.unpack_from(record)
        name, offset = _text(record, 2)
        encoding, offset = _text(record, offset)
        if encoding == 'ros2msg':
            self.definitions[name] = _text(record, offset)[0]
        if number == 0 or self._schemas.setdefault(number, name) != name:
            raise Damaged('a schema changes its name')

    def channel(self, record: bytes) -> int:
        """Take a channel and give its number; Damaged if it is another than before."""
        number, schema = _U16.unpack_from(record)[0], _U16.unpack_from(record, 2)[0]
        topic, _ = _text(record, 4)
        if schema not in self._schemas:
            raise Damaged('a channel has no schema')
        found = topic, self._schemas[schema]
        if self.topics.setdefault(number, found) != found:
            raise Damaged('a channel changes its topic or type')
        return int(number)


class _Walk:
    """Goes through the records of one file."""

    def __init__(
        self, topics: Collection[str] | None, with_data: bool, channels: Channels,
    ) -> None:
        self.found: dict[str, Scan] = {} if topics is None else {name: Scan() for name in topics}
        self._all = topics is None
        self._with_data = with_data
        self._channels = channels
        self._sinks: dict[int, Scan | None] = {}

    def _definition(self, code: int, record: bytes) -> None:
        if code == SCHEMA:
            self._channels.schema(record)
            return
        number = self._channels.channel(record)
        topic, msgtype = self._channels.topics[number]
        if self._all:
            self.found.setdefault(topic, Scan())
        sink = self._sinks[number] = self.found.get(topic)
        if sink is not None:
            sink.msgtypes[msgtype] = None

    def records(self, chunk: bytes) -> None:
        """Go through the records of a chunk."""
        unpack = _MESSAGE.unpack_from
        overhead, body, record_size = _MESSAGE.size, _MESSAGE_BODY, RECORD.size
        end, position, with_data, sinks = len(chunk), 0, self._with_data, self._sinks
        while position < end:
            if chunk[position] == MESSAGE:
                _, size, channel, _, log_time, _ = unpack(chunk, position)
                stop = position + record_size + size
                if size < body or stop > end:
                    raise Damaged('a message leaves its chunk')
                if channel not in sinks:
                    raise Damaged('a message has no channel')
                sink = sinks[channel]
                if sink is not None:
                    if log_time > MAX_LOG_TIME:
                        raise Damaged('a log time out of range')
                    sink.log_time.append(log_time)
                    if with_data:
                        sink.data.append(chunk[position + overhead:stop])
            else:
                code, size = RECORD.unpack_from(chunk, position)
                stop = position + record_size + size
                if stop > end or code not in (SCHEMA, CHANNEL):
                    raise Damaged(f'a record of kind {code} does not belong into its chunk')
                self._definition(code, chunk[position + record_size:stop])
            position = stop

    def file(self, stream: BinaryIO, size: int, unfinished: bool) -> None:
        """Go through a file up to the end of its data."""
        unpacker = Unpacker(size)
        if stream.read(len(MAGIC)) != MAGIC:
            raise Damaged('no MCAP magic')
        while True:
            head = stream.read(RECORD.size)
            whole = (len(head) == RECORD.size
                     and RECORD.unpack(head)[1] <= size - stream.tell())
            if unfinished and not (whole and head[0]):  # 0: never written, by a crash
                return
            if not whole:
                raise Damaged('a record leaves the file')
            code, length = RECORD.unpack(head)
            if code in (DATA_END, FOOTER):
                return
            if code not in (CHUNK, SCHEMA, CHANNEL, MESSAGE):
                stream.seek(length, 1)
                continue
            if length > MAX_PIECE:
                msg = f'a record of {length} bytes; at most {MAX_PIECE} are read at once'
                raise Damaged(msg)
            record = stream.read(length)
            self.records(_unpack_chunk(record, unpacker) if code == CHUNK else head + record)


def _unpack_chunk(record: bytes, unpacker: Unpacker) -> bytes:
    _, _, size, crc = _CHUNK.unpack_from(record)
    compression, offset = _text(record, _CHUNK.size)
    (packed,) = _U64.unpack_from(record, offset)
    offset += _U64.size
    if offset + packed != len(record):
        raise Damaged('a chunk does not fill its record')
    raw = unpacker.unpack(record[offset:], compression, size)
    if crc and zlib.crc32(raw) != crc:
        raise Damaged('a chunk does not have its checksum')
    return raw


def scan_mcap(
    path: Path, topics: Collection[str] | None = None, *, with_data: bool = True,
    channels: Channels | None = None, unfinished: bool = False,
) -> dict[str, Scan]:
    """Read the raw messages of some topics; topics: all by default."""
    walk = _Walk(topics, with_data, channels or Channels())
    with open_regular(path) as stream:
        try:
            walk.file(stream, path.stat().st_size, unfinished)
        except (struct.error, UnicodeDecodeError) as err:
            raise Damaged(f'cut short or garbled: {err}') from None
    return walk.found


# -- Topics of an MCAP file from its summary, where that tells them.
#
# A summary may leave out what stands in the data section already (channels, statistics). Then, or
# if it is damaged, the data section is the answer.
#
# Format: https://mcap.dev/spec

MAX_SUMMARY_BYTES = 64 << 20

_FOOTER = struct.Struct('<QQI')
_COUNTS = struct.Struct('<QHIIIIQQI')
_COUNT = struct.Struct('<HQ')
_TAIL = RECORD.size + _FOOTER.size + len(MAGIC)
_PROFILES = (b'', b'ros2')


class BreaksOff(Damaged):
    """A file without its end: cut short, or its recorder was killed."""


def mcap_topics(path: Path, *, unfinished: bool = False) -> list[tuple[str, str, int]]:
    """Give the topics of an MCAP file."""
    summary = _Summary() if unfinished else _read(path)
    if summary.complete:
        return [(topic, msgtype, summary.counts.get(number, 0))
                for number, (topic, msgtype) in summary.channels.topics.items()]
    return [(topic, msgtype, len(scan.log_time) if number == 0 else 0)
            for topic, scan in scan_mcap(
                path, with_data=False, channels=summary.channels, unfinished=unfinished).items()
            for number, msgtype in enumerate(scan.msgtypes)]


def mcap_channels(path: Path) -> Channels:
    """Give the channels that the summary of a file names; none where it cannot be used."""
    return _read(path).channels


def mcap_definitions(path: Path, *, unfinished: bool = False) -> dict[str, str]:
    """Give the definitions of messages that a file carries."""
    summary = _Summary() if unfinished else _read(path)
    if not summary.channels.definitions:
        scan_mcap(path, (), with_data=False, channels=summary.channels, unfinished=unfinished)
    return summary.channels.definitions


@dataclass(frozen=True)
class _Summary:
    """Channels, number of messages of each, and whether that is all there is to know."""

    channels: Channels = field(default_factory=Channels)
    counts: Mapping[int, int] = field(default_factory=dict)
    complete: bool = False


def _read(path: Path) -> _Summary:
    summary = _summary(path)
    try:
        return _Summary() if summary is None else _from_summary(summary)
    except (struct.error, UnicodeDecodeError, Damaged):
        return _Summary()


def _summary(path: Path) -> bytes | None:
    size = path.stat().st_size
    with open_regular(path) as stream:
        if size < len(MAGIC) + RECORD.size + 4 + _TAIL or stream.read(len(MAGIC)) != MAGIC:
            raise Damaged('no MCAP magic')
        code, _ = RECORD.unpack(stream.read(RECORD.size))
        length = int.from_bytes(stream.read(4), 'little')
        if code != HEADER or stream.read(min(length, 5)) not in _PROFILES:
            raise Damaged('no MCAP file of ROS 2')
        stream.seek(-_TAIL, 2)
        tail = stream.read(_TAIL)
        start, offsets, checksum = _FOOTER.unpack_from(tail, RECORD.size)
        if not tail.endswith(MAGIC):
            raise BreaksOff('no MCAP footer: cut short, or never closed')
        if RECORD.unpack_from(tail) != (FOOTER, _FOOTER.size):
            raise Damaged('no MCAP footer')
        end = size - _TAIL
        if not start or not len(MAGIC) < start <= end or end - start > MAX_SUMMARY_BYTES:
            return None
        stream.seek(start)
        summary = stream.read(end - start)
    if checksum and zlib.crc32(tail[:RECORD.size + 16], zlib.crc32(summary)) != checksum:
        return None
    return summary if not offsets else summary[:max(0, offsets - start)]


def _from_summary(summary: bytes) -> _Summary:
    channels, total, position = Channels(), None, 0
    counts: dict[int, int] = {}
    while position < len(summary):
        code, size = RECORD.unpack_from(summary, position)
        position += RECORD.size
        if position + size > len(summary):
            raise Damaged('a record leaves the summary')
        record = summary[position:position + size]
        if code == SCHEMA:
            channels.schema(record)
        elif code == CHANNEL:
            channels.channel(record)
        elif code == STATISTICS:
            total, *_, length = _COUNTS.unpack_from(record)
            if _COUNTS.size + length > len(record):
                raise Damaged('statistics leave their record')
            counts = dict(_COUNT.iter_unpack(record[_COUNTS.size:_COUNTS.size + length]))
        position += size
    known = counts.keys() <= channels.topics.keys()
    return _Summary(channels, counts, known and total is not None
                    and sum(counts.values()) == total)
