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

"""MCAP files as other writers make them: other chunks, other summaries, nothing at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import struct

from bag_making import currents, joint_states, make_bag, plain_arm, times
import mcap_records as mcap
import numpy as np
import pytest

from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import BagError

TOPICS = {'/joint_states': 300, '/motor_currents': 150}


@pytest.fixture(scope='module')
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Give an MCAP file of two topics, all indices in its summary."""
    bag = make_bag(tmp_path_factory.mktemp('mcap') / 'b', joint_states(),
                   currents(times(150, 0.02)))
    return (bag / 'b.mcap').read_bytes()


def with_checksum(content: bytes) -> bytes:
    """Give the file with the checksum of its summary in the footer."""
    start, = struct.unpack_from('<Q', content, len(content) - 28)
    return (content[:-12] + struct.pack('<I', mcap.zlib.crc32(content[start:-12]))
            + mcap.MAGIC)


KINDS = (mcap.SCHEMA, mcap.CHANNEL, mcap.CHUNK_INDEX, mcap.STATISTICS)


@pytest.mark.parametrize('change', [
    lambda c: c,
    lambda c: mcap.with_summary_of(c, [k for k in KINDS if k not in (mcap.SCHEMA, mcap.CHANNEL)]),
    lambda c: mcap.with_summary_of(c, [k for k in KINDS if k != mcap.CHANNEL]),
    lambda c: mcap.with_summary_of(c, [k for k in KINDS if k != mcap.STATISTICS]),
    lambda c: mcap.with_summary_of(c, [mcap.STATISTICS]),
    lambda c: mcap.with_summary_of(c, [mcap.CHUNK_INDEX]),
    lambda c: mcap.with_summary_of(c, []),
    lambda c: with_checksum(mcap.with_summary_of(c, KINDS)),
    lambda c: with_checksum(mcap.with_summary_of(c, KINDS)).replace(b'/motor', b'/notor'),
    mcap.without_chunks,
    lambda c: mcap.change_chunks(c, lambda _, raw: ('lz4', raw)),
    lambda c: mcap.change_chunks(c, lambda _, raw: ('zstd', raw)),
], ids=['as written', 'no repeated channels', 'no repeated channels but schemas', 'no statistics',
        'statistics alone', 'chunk index alone', 'no summary', 'checksum', 'damaged summary',
        'no chunks', 'lz4', 'zstd'])
def test_legal_files_are_read(
    content: bytes, change: Callable[[bytes], bytes], tmp_path: Path,
) -> None:
    """What a summary leaves out is found in the data section; the messages are the same."""
    file = tmp_path / 'a.mcap'
    changed = change(content)
    if b'/notor' in changed:  # in the summary alone, whose checksum tells
        start, = struct.unpack_from('<Q', changed, len(changed) - 28)
        changed = change(content)[:start].replace(b'/notor', b'/motor') + changed[start:]
    file.write_bytes(changed)
    bag = open_bag(file)
    assert {name: info.count for name, info in bag.topics.items()} == TOPICS
    found = read_recording(file, plain_arm())
    np.testing.assert_array_equal(found.q, joint_states().values['position'])
    assert describe(file).odd == []
    raw = bag.read(['/motor_currents'])['/motor_currents']
    assert raw.data == encode(currents(times(150, 0.02))).data


def records(raw: bytes) -> list[tuple[int, bytes]]:
    """Give the records of a chunk, for changing them."""
    return list(mcap.split(raw))


def changed_records(content: bytes, change: Callable[[list], list]) -> bytes:
    """Put the records of each chunk through a change; chunks stay right in themselves."""
    return mcap.change_chunks(content, lambda how, raw: (how, mcap.join(change(records(raw)))))


def other_log_time(items: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Let a message have been recorded beyond all times."""
    at = next(i for i, (kind, _) in enumerate(items) if kind == 0x05)
    body = items[at][1]
    items[at] = 0x05, body[:6] + b'\xff' * 8 + body[14:]
    return items


@pytest.mark.parametrize(('change', 'cause'), [
    (lambda c: changed_records(c, lambda r: [(0x80, b''), *r]), 'kind 128 does not belong'),
    (lambda c: changed_records(c, lambda r: [i for i in r if i[0] != mcap.CHANNEL]),
     'a message has no channel'),
    (lambda c: mcap.with_summary_of(changed_records(
        c, lambda r: [i for i in r if i[0] != mcap.SCHEMA]), []), 'has no schema'),
    (lambda c: changed_records(
        c, lambda r: r + [(k, b.replace(b'/joint_states', b'/joint_statez'))
                          for k, b in r if k == mcap.CHANNEL]), 'changes its topic'),
    (lambda c: changed_records(
        c, lambda r: r + [(k, b.replace(b'JointState', b'JointStatf'))
                          for k, b in r if k == mcap.SCHEMA]), 'a schema changes its name'),
    (lambda c: changed_records(c, other_log_time), 'a log time out of range'),
    (lambda c: changed_records(c, lambda r: [*r, (0x05, b'x')]), 'leaves its chunk|cut short'),
    (lambda c: mcap.change_chunks(c, lambda how, raw: (how, raw + b'\x05')), 'cut short'),
    (lambda c: c[:-37] + b'\0' * 29 + mcap.MAGIC, 'does not end as MCAP'),
    (lambda c: c.replace(b'ros2', b'ros1', 1), 'no MCAP file of ROS 2'),
])
def test_what_contradicts_itself_is_refused(
    content: bytes, change: Callable[[bytes], bytes], cause: str, tmp_path: Path,
) -> None:
    """One line names the cause, and nothing is guessed."""
    file = tmp_path / 'a.mcap'
    file.write_bytes(change(content))
    with pytest.raises(BagError, match=cause) as caught:
        read_recording(file, plain_arm())
    assert str(caught.value).endswith('recover its messages with `mcap recover`')


def test_summary_and_data_that_contradict_each_other(content: bytes, tmp_path: Path) -> None:
    """A topic that has another name in the data section is not silently empty."""
    file = tmp_path / 'a.mcap'
    file.write_bytes(mcap.change_chunks(
        content, lambda how, raw: (how, raw.replace(b'/motor_', b'/notor_'))))
    bag = open_bag(file)
    assert set(bag.topics) == set(TOPICS)
    with pytest.raises(BagError, match='changes its topic or type'):
        bag.read(['/motor_currents'])
