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

"""MCAP files taken apart and put together again: other compressions, other summaries."""

import struct
import zlib

from backports import zstd
import lz4.frame

MAGIC = b'\x89MCAP0\r\n'
FOOTER, SCHEMA, CHANNEL, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = 0x02, 0x03, 0x04, 0x06, 0x07, 0x08
STATISTICS, DATA_END = 0x0B, 0x0F
PACK = {'': bytes, 'zstd': zstd.compress, 'lz4': lz4.frame.compress}
UNPACK = {'': bytes, 'zstd': zstd.decompress, 'lz4': lz4.frame.decompress}


def split(content):
    """Give the records of a whole file, or of a chunk: kind and body."""
    records, position = [], len(MAGIC) if content.startswith(MAGIC) else 0
    while position < len(content) and content[position:] != MAGIC:
        kind, size = struct.unpack_from('<BQ', content, position)
        records.append((kind, content[position + 9:position + 9 + size]))
        position += 9 + size
    return records


def join(records):
    """Give records as bytes."""
    return b''.join(struct.pack('<BQ', kind, len(body)) + body for kind, body in records)


def sections(content):
    """Give the records of the data section, and those of the summary."""
    records = split(content)
    end = next(i for i, (kind, _) in enumerate(records) if kind == DATA_END)
    return records[:end], [item for item in records[end + 1:] if item[0] != FOOTER]


def build(data, summary):
    """Put a file together, with the offset of its summary."""
    body = MAGIC + join(data) + join([(DATA_END, bytes(4))])
    footer = struct.pack('<QQI', len(body) if summary else 0, 0, 0)
    return body + join(summary) + join([(FOOTER, footer)]) + MAGIC


def open_chunk(body):
    """Give head (times), compression and unpacked records of a chunk."""
    (size,) = struct.unpack_from('<I', body, 28)
    compression = body[32:32 + size].decode()
    return body[:16], compression, UNPACK[compression](body[40 + size:])


def close_chunk(head, compression, raw, *, checked=True):
    """Make a chunk that is right about its size and checksum."""
    packed = PACK[compression](raw)
    crc = zlib.crc32(raw) if checked else 0
    return (head + struct.pack('<QI', len(raw), crc) + struct.pack('<I', len(compression))
            + compression.encode() + struct.pack('<Q', len(packed)) + packed)


def change_chunks(content, change):
    """Put every chunk through ``change(compression, raw) -> compression, raw``; drop indices."""
    data, summary = sections(content)
    changed = []
    for kind, body in data:
        if kind == CHUNK:
            head, compression, raw = open_chunk(body)
            body = close_chunk(head, *change(compression, raw))
        if kind != MESSAGE_INDEX:
            changed.append((kind, body))
    return build(changed, [item for item in summary if item[0] != CHUNK_INDEX])


def without_chunks(content):
    """Give the file with its messages outside of chunks."""
    data, summary = sections(content)
    loose = []
    for kind, body in data:
        loose += split(open_chunk(body)[2]) if kind == CHUNK else [(kind, body)]
    return build([item for item in loose if item[0] != MESSAGE_INDEX],
                 [item for item in summary if item[0] != CHUNK_INDEX])


def with_summary_of(content, kinds):
    """Give the file with some kinds of records alone in its summary; the data stay."""
    data, summary = sections(content)
    return build(data, [item for item in summary if item[0] in kinds])
