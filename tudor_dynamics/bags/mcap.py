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
MCAP files: their topics, and raw messages of chosen ones.

rosbags takes twice as long for raw messages alone as this and all decoding take together
(bench/read_bags.py), and nothing there bounds what a chunk unpacks to. Here the records of a
chunk are read in memory, and every length and checksum is checked. Topics come from the summary;
where it leaves something out, or is damaged, from the data section. A file that nobody finished,
because the recorder was killed or its disk was full, ends before the first record that is not
whole.

Format: https://mcap.dev/spec
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
import struct
import zlib

from tudor_dynamics.files import BreaksOff, Damaged, MAX_PIECE, open_regular, Unpacker

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06
STATISTICS, DATA_END = 0x0B, 0x0F
PROFILES = (b'', b'ros2')
MAX_LOG_TIME = (1 << 63) - 1
MAX_SUMMARY_BYTES = 64 << 20

RECORD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_BODY = _MESSAGE.size - RECORD.size
_CHUNK = struct.Struct('<QQQI')
_FOOTER = struct.Struct('<QQI')
_COUNTS = struct.Struct('<QHIIIIQQI')
_COUNT = struct.Struct('<HQ')
_U16 = struct.Struct('<H')
_U32 = struct.Struct('<I')
_U64 = struct.Struct('<Q')
_TAIL = RECORD.size + _FOOTER.size + len(MAGIC)


@dataclass
class Scan:
    """Raw messages of one topic."""

    msgtypes: dict[str, None] = field(default_factory=dict)  # announced for it, in order
    log_time: list[int] = field(default_factory=list)  # time of recording [ns]
    data: list[bytes] = field(default_factory=list)  # as on the wire; empty for times alone


def _text(record: bytes, offset: int) -> tuple[str, int]:
    (size,) = _U32.unpack_from(record, offset)
    start = offset + _U32.size
    if start + size > len(record):
        raise Damaged('a string leaves its record')
    return record[start:start + size].decode(), start + size


class McapFile:
    """An MCAP file of ROS 2; `BreaksOff` where it has no end and none is to be expected."""

    def __init__(self, path: Path, *, unfinished: bool = False) -> None:
        self.path, self._unfinished = path, unfinished
        self._forget()
        if unfinished:
            return
        summary = self._summary()
        try:
            self._complete = summary is not None and self._read_summary(summary)
        except (struct.error, UnicodeDecodeError, Damaged):
            self._forget()

    def _forget(self) -> None:
        """Know nothing of the file: no channels, no definitions of messages, no counts."""
        self._channels: dict[int, tuple[str, str]] = {}
        self._schemas = {0: '__schemaless__'}
        self._definitions: dict[str, str] = {}
        self._counts: dict[int, int] = {}
        self._complete = False

    def topics(self) -> list[tuple[str, str, int]]:
        """Give the topics with their types and numbers of messages."""
        if self._complete:
            return [(topic, msgtype, self._counts.get(number, 0))
                    for number, (topic, msgtype) in self._channels.items()]
        return [(topic, msgtype, len(scan.log_time) if number == 0 else 0)
                for topic, scan in self.read(None, with_data=False).items()
                for number, msgtype in enumerate(scan.msgtypes)]

    def definitions(self) -> dict[str, str]:
        """Give the definitions of messages that the file carries."""
        if not self._definitions:
            self.read((), with_data=False)
        return self._definitions

    def _summary(self) -> bytes | None:
        """Read the bytes of the summary; None where it cannot be used."""
        size = self.path.stat().st_size
        with open_regular(self.path) as stream:
            if size < len(MAGIC) + RECORD.size + 4 + _TAIL or stream.read(len(MAGIC)) != MAGIC:
                raise Damaged('it does not begin as MCAP does')
            code, _ = RECORD.unpack(stream.read(RECORD.size))
            length = int.from_bytes(stream.read(4), 'little')
            if code != HEADER or stream.read(min(length, 5)) not in PROFILES:
                raise Damaged('no MCAP file of ROS 2')
            stream.seek(-_TAIL, 2)
            tail = stream.read(_TAIL)
            start, offsets, checksum = _FOOTER.unpack_from(tail, RECORD.size)
            if not tail.endswith(MAGIC):
                raise BreaksOff('it was cut short, or never closed')
            if RECORD.unpack_from(tail) != (FOOTER, _FOOTER.size):
                raise Damaged('it does not end as MCAP does')
            end = size - _TAIL
            if not start or not len(MAGIC) < start <= end or end - start > MAX_SUMMARY_BYTES:
                return None
            stream.seek(start)
            summary = stream.read(end - start)
        if checksum and zlib.crc32(tail[:RECORD.size + 16], zlib.crc32(summary)) != checksum:
            return None
        return summary if not offsets else summary[:max(0, offsets - start)]

    def _read_summary(self, summary: bytes) -> bool:
        """Take channels and counts from the summary; whether that is all there is to know."""
        total, position = None, 0
        while position < len(summary):
            code, size = RECORD.unpack_from(summary, position)
            position += RECORD.size
            if position + size > len(summary):
                raise Damaged('a record leaves the summary')
            record = summary[position:position + size]
            if code == SCHEMA:
                self._schema(record)
            elif code == CHANNEL:
                self._channel(record)
            elif code == STATISTICS:
                total, *_, length = _COUNTS.unpack_from(record)
                if _COUNTS.size + length > len(record):
                    raise Damaged('statistics leave their record')
                self._counts = dict(_COUNT.iter_unpack(record[_COUNTS.size:_COUNTS.size + length]))
            position += size
        return (self._counts.keys() <= self._channels.keys() and total is not None
                and sum(self._counts.values()) == total)

    def _schema(self, record: bytes) -> None:
        """Take a schema; Damaged if it is another than before under its number."""
        (number,) = _U16.unpack_from(record)
        name, offset = _text(record, 2)
        encoding, offset = _text(record, offset)
        if encoding == 'ros2msg':
            self._definitions[name] = _text(record, offset)[0]
        if number == 0 or self._schemas.setdefault(number, name) != name:
            raise Damaged('a schema changes its name')

    def _channel(self, record: bytes) -> int:
        """Take a channel and give its number; Damaged if it is another than before."""
        number, schema = _U16.unpack_from(record)[0], _U16.unpack_from(record, 2)[0]
        topic, _ = _text(record, 4)
        if schema not in self._schemas:
            raise Damaged(f'topic {topic} has no schema')
        found = topic, self._schemas[schema]
        if self._channels.setdefault(number, found) != found:
            raise Damaged(f'channel {number} changes its topic or type')
        return int(number)

    def read(self, topics: Collection[str] | None, *, with_data: bool) -> dict[str, Scan]:
        """Go through the data section for some topics, or for all."""
        found = {} if topics is None else {name: Scan() for name in topics}
        sinks: dict[int, Scan | None] = {}
        size = self.path.stat().st_size
        unpacker = Unpacker(size)
        with open_regular(self.path) as stream:
            try:
                if stream.read(len(MAGIC)) != MAGIC:
                    raise Damaged('it does not begin as MCAP does')
                while True:
                    head = stream.read(RECORD.size)
                    whole = (len(head) == RECORD.size
                             and RECORD.unpack(head)[1] <= size - stream.tell())
                    if self._unfinished and not (whole and head[0]):  # 0: not written, by a crash
                        break
                    if not whole:
                        raise Damaged('a record leaves the file')
                    code, length = RECORD.unpack(head)
                    if code in (DATA_END, FOOTER):
                        break
                    if code not in (CHUNK, SCHEMA, CHANNEL, MESSAGE):
                        stream.seek(length, 1)
                        continue
                    if length > MAX_PIECE:
                        raise Damaged(f'a record of {length} bytes, more than {MAX_PIECE}')
                    record = stream.read(length)
                    self._records(
                        _unpack_chunk(record, unpacker) if code == CHUNK else head + record,
                        found, sinks, topics is None, with_data)
            except (struct.error, UnicodeDecodeError) as err:
                raise Damaged(f'cut short or garbled: {err}') from None
        return found

    def _records(
        self, chunk: bytes, found: dict[str, Scan], sinks: dict[int, Scan | None], every: bool,
        with_data: bool,
    ) -> None:
        """Go through the records of a chunk."""
        unpack = _MESSAGE.unpack_from
        overhead, body, record_size = _MESSAGE.size, _MESSAGE_BODY, RECORD.size
        end, position = len(chunk), 0
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
                record = chunk[position + record_size:stop]
                if code == SCHEMA:
                    self._schema(record)
                else:
                    number = self._channel(record)
                    topic, msgtype = self._channels[number]
                    if every:
                        found.setdefault(topic, Scan())
                    sink = sinks[number] = found.get(topic)
                    if sink is not None:
                        sink.msgtypes[msgtype] = None
            position = stop


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
