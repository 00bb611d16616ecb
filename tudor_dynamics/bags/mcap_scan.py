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
Quick scan of the data section of an MCAP file: raw messages of chosen topics.

rosbags reads MCAP record by record through file objects, which costs more than everything that
follows. This scan walks the records of a chunk in memory instead. It checks every length and the
chunk checksums, and raises Unusual for all that it does not know: the caller then asks rosbags,
which has the last word on what the file holds. Only files that nobody finished, because the
recorder was killed or its disk was full, are read here alone: they have no index, which rosbags
asks for.

Format: https://mcap.dev/spec
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
import struct
from typing import Any, BinaryIO
import zlib

MAGIC = b'\x89MCAP0\r\n'
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, DATA_END = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0F
NESTED = (0x01, FOOTER, CHUNK, DATA_END)
"""Records that have no business inside a chunk."""
MAX_CHUNK_BYTES = 1 << 30
MAX_LOG_TIME = (1 << 63) - 1

_RECORD = struct.Struct('<BQ')
_MESSAGE = struct.Struct('<BQHIQQ')
_MESSAGE_BODY = _MESSAGE.size - _RECORD.size
_CHUNK = struct.Struct('<QQQI')
_U16 = struct.Struct('<H')
_U32 = struct.Struct('<I')
_U64 = struct.Struct('<Q')


class Unusual(Exception):
    """A file that this scan does not understand or does not trust."""


class Damaged(Exception):
    """A file that contradicts its own checksum."""


@dataclass
class Scan:
    """
    Raw messages of one topic.

    Attributes
    ----------
    log_time : list of int
        Time of recording [ns].
    data : list of bytes
        Messages as they were on the wire; left empty where only times were asked for.

    """

    log_time: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def _text(record: bytes, offset: int) -> tuple[str, int]:
    (size,) = _U32.unpack_from(record, offset)
    start = offset + _U32.size
    if start + size > len(record):
        raise Unusual('a string leaves its record')
    return record[start:start + size].decode(), start + size


def _decompress(data: bytes, compression: str, size: int) -> bytes:
    if compression == '':
        return data
    decompressor: Any
    try:
        if compression == 'zstd':
            from backports import zstd
            decompressor = zstd.ZstdDecompressor()
        elif compression == 'lz4':
            from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
            decompressor = LZ4FrameDecompressor()
        else:
            raise Unusual(f'compression {compression!r}')
        # One byte more than promised shows a chunk that lies without unpacking all of it.
        raw = decompressor.decompress(data, max_length=size + 1)
    except ImportError as err:
        raise Unusual(str(err)) from None
    except (RuntimeError, EOFError, ValueError) as err:
        raise Unusual(str(err)) from None
    except Exception as err:
        if type(err).__name__ == 'ZstdError':  # derives from Exception alone
            raise Unusual(str(err)) from None
        raise
    return bytes(raw)


def _unpack_chunk(record: bytes) -> bytes:
    _, _, size, crc = _CHUNK.unpack_from(record)
    compression, offset = _text(record, _CHUNK.size)
    (packed,) = _U64.unpack_from(record, offset)
    offset += _U64.size
    if offset + packed != len(record) or size > MAX_CHUNK_BYTES:
        raise Unusual('a chunk does not fill its record')
    raw = _decompress(record[offset:], compression, size)
    if len(raw) != size:
        raise Unusual('a chunk differs from its size')
    if crc and zlib.crc32(raw) != crc:
        raise Damaged('a chunk does not have its checksum')
    return raw


def _scan_chunk(
    chunk: bytes,
    wanted: Collection[str],
    channels: dict[int, str],
    found: dict[str, Scan],
    with_data: bool,
) -> None:
    unpack = _MESSAGE.unpack_from
    overhead, body, record_size = _MESSAGE.size, _MESSAGE_BODY, _RECORD.size
    end, position = len(chunk), 0
    sinks: dict[int, Scan | None] = {
        number: found[topic] if topic in wanted else None for number, topic in channels.items()}
    while position < end:
        if chunk[position] == MESSAGE:
            _, size, channel, _, log_time, _ = unpack(chunk, position)
            stop = position + record_size + size
            if size < body or stop > end:
                raise Unusual('a message leaves its chunk')
            sink = sinks[channel]
            if sink is not None:
                if log_time > MAX_LOG_TIME:
                    raise Unusual('a log time out of range')
                sink.log_time.append(log_time)
                if with_data:
                    sink.data.append(chunk[position + overhead:stop])
        else:
            code, size = _RECORD.unpack_from(chunk, position)
            stop = position + record_size + size
            if stop > end or code in NESTED:
                raise Unusual('a record leaves its chunk, or does not belong there')
            if code == CHANNEL:
                record = chunk[position + record_size:stop]
                (number,) = _U16.unpack_from(record)
                topic, _ = _text(record, 4)
                if channels.setdefault(number, topic) != topic:
                    raise Unusual('a channel changes its topic')
                sinks[number] = found[topic] if topic in wanted else None
        position = stop


def _next_record(stream: BinaryIO, size: int, unfinished: bool) -> tuple[int, int]:
    """Read code and length of a record; an unfinished file ends where one is not whole."""
    head = stream.read(_RECORD.size)
    if unfinished and (len(head) < _RECORD.size or not head[0]):  # 0: never written, by a crash
        return DATA_END, 0
    code, length = _RECORD.unpack(head)
    if length > size - stream.tell():
        if unfinished:
            return DATA_END, 0
        raise Unusual('a record leaves the file')
    return code, length


def _scan_file(
    stream: BinaryIO,
    size: int,
    wanted: Collection[str],
    found: dict[str, Scan],
    with_data: bool,
    unfinished: bool,
) -> None:
    if stream.read(len(MAGIC)) != MAGIC:
        raise Unusual('no MCAP magic')
    channels: dict[int, str] = {}
    while True:
        code, length = _next_record(stream, size, unfinished)
        if code in (DATA_END, FOOTER):
            return
        if code == CHUNK:
            chunk = _unpack_chunk(stream.read(length))
            _scan_chunk(chunk, wanted, channels, found, with_data)
        elif code in (MESSAGE, CHANNEL):
            raise Unusual('messages outside chunks')
        else:
            stream.seek(length, 1)


def scan_mcap(
    path: Path, topics: Collection[str], *, with_data: bool = True, unfinished: bool = False,
) -> dict[str, Scan]:
    """
    Read the raw messages of some topics.

    Parameters
    ----------
    path : Path
        MCAP file with its messages in chunks.
    topics : collection of str
        Topics to read.
    with_data : bool
        Also keep the messages, not only their times.
    unfinished : bool
        The file breaks off anywhere; what is whole before is read.

    Returns
    -------
    dict of str to Scan
        Messages of each topic in the order of the file.

    Raises
    ------
    Unusual
        If anything about the file is not as expected.
    Damaged
        If a checksum is wrong, which not every version of rosbags looks at.

    """
    found = {topic: Scan() for topic in topics}
    try:
        with path.open('rb') as stream:
            _scan_file(stream, path.stat().st_size, frozenset(topics), found, with_data,
                       unfinished)
    except (OSError, struct.error, KeyError, UnicodeDecodeError, MemoryError) as err:
        raise Unusual(f'{type(err).__name__}: {err}') from None
    return found


def unfinished_topics(path: Path) -> dict[str, str]:
    """
    Find the topics of a file that nobody finished.

    Parameters
    ----------
    path : Path
        MCAP file.

    Returns
    -------
    dict of str to str
        Topic to message type; empty for a file that was finished, or has no whole chunk.

    """
    found: dict[str, str] = {}
    try:
        with path.open('rb') as stream:
            size = stream.seek(0, 2)
            stream.seek(max(size - len(MAGIC), 0))
            finished = stream.read() == MAGIC and size > len(MAGIC)
            stream.seek(0)
            if finished or stream.read(len(MAGIC)) != MAGIC:
                return {}
            schemas: dict[int, str] = {}
            while (record := _next_record(stream, size, True))[0] not in (DATA_END, FOOTER):
                if record[0] == CHUNK:
                    _learn_topics(_unpack_chunk(stream.read(record[1])), schemas, found)
                else:
                    stream.seek(record[1], 1)
    except (OSError, struct.error, KeyError, UnicodeDecodeError, MemoryError, Unusual, Damaged):
        return {}
    return found


def _learn_topics(chunk: bytes, schemas: dict[int, str], found: dict[str, str]) -> None:
    """Take topics and types out of a chunk."""
    position = 0
    while position < len(chunk):
        code, size = _RECORD.unpack_from(chunk, position)
        position += _RECORD.size
        if code in (SCHEMA, CHANNEL):
            record = chunk[position:position + size]
            (number,) = _U16.unpack_from(record)
            if code == SCHEMA:
                schemas[number], _ = _text(record, 2)
            else:
                topic, _ = _text(record, 4)
                found[topic] = schemas[_U16.unpack_from(record, 2)[0]]
        position += size
