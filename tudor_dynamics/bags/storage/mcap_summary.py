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
Topics of an MCAP file from its summary, where that tells them.

A summary may leave out what stands in the data section already (channels, statistics). Then, or
if it is damaged, the data section is the answer.

Format: https://mcap.dev/spec
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import struct
import zlib

from tudor_dynamics.bags.storage.mcap_scan import (
    CHANNEL, Channels, FOOTER, HEADER, MAGIC, RECORD, scan_mcap, SCHEMA, STATISTICS)
from tudor_dynamics.bags.storage.unpacking import Damaged
from tudor_dynamics.files import open_regular

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
