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

"""Bags that would unpack, compute or wait without end."""

from __future__ import annotations

from collections.abc import Callable
import os
from pathlib import Path
import sqlite3
import struct
from typing import Any

from backports import zstd
from bag_making import joint_states, make_bag, plain_arm
import mcap_records as mcap
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores
from tudor_dynamics import files
from tudor_dynamics.bags import sqlite
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.messages import CdrError, joint_state_layout, MAX_NAMES
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import Damaged, FREE_BYTES, MAX_PIECE, Unpacker
import yaml

FRAME = zstd.compress(bytes(1 << 24))
"""Sixteen megabytes in five hundred bytes."""


@pytest.mark.parametrize('compression', ['zstd', 'lz4'])
def test_pieces_are_bounded(compression: str) -> None:
    """A piece is what it says, no more and no less; frames may follow each other."""
    pack = mcap.PACK[compression]
    packed = pack(b'abc') + pack(b'def')
    assert Unpacker(10).unpack(packed, compression, 6) == b'abcdef'
    assert Unpacker(10).unpack(packed, compression) == b'abcdef'
    for wrong in (5, 7):
        with pytest.raises(Damaged, match=f'announces {wrong} bytes unpacks to'):
            Unpacker(10).unpack(packed, compression, wrong)
    with pytest.raises(Damaged, match='cut short'):
        Unpacker(10).unpack(packed[:-2], compression, 6)
    with pytest.raises(Damaged, match=compression):
        Unpacker(10).unpack(b'garbage' * 9, compression, 6)
    with pytest.raises(Damaged, match=f'at most {MAX_PIECE} are unpacked'):
        Unpacker(10).unpack(packed, compression, MAX_PIECE + 1)


def test_the_sum_is_bounded() -> None:
    """Many pieces come to no more than one may, and a large file may unpack to more."""
    unpacker = Unpacker(len(FRAME))
    for _ in range(FREE_BYTES >> 24):
        assert len(unpacker.unpack(FRAME, 'zstd')) == 1 << 24
    with pytest.raises(Damaged, match='more than 64 times its size and more than 64 MB'):
        unpacker.unpack(FRAME, 'zstd')
    larger = Unpacker(10_000_000)
    for _ in range(3):
        larger.unpack(FRAME * 3, 'zstd', 3 << 24)


def chunk_bomb(path: Path, size: int) -> Path:
    """Write an MCAP file with one chunk of zeros that says it has a size."""
    content = (make_bag(path / 'b') / 'b.mcap').read_bytes()
    data, summary = mcap.sections(content)
    packed = FRAME * 256
    chunk = (bytes(16) + struct.pack('<QI', size, 0) + struct.pack('<I4s', 4, b'zstd')
             + struct.pack('<Q', len(packed)) + packed)
    data = [(kind, chunk if kind == mcap.CHUNK else body) for kind, body in data]
    file = path / 'a.mcap'
    file.write_bytes(mcap.build(data, []))
    return file


@pytest.mark.parametrize(('size', 'cause'), [
    (256 << 24, 'at most 67108864 are unpacked'), (1000, 'unpacks to 1001 or more')])
def test_chunk_of_gigabytes(tmp_path: Path, size: int, cause: str) -> None:
    """A chunk that says or hides what it unpacks to is refused at once."""
    with pytest.raises(BagError, match=cause):
        describe(chunk_bomb(tmp_path, size))


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('mode', ['FILE', 'MESSAGE'])
def test_file_and_message_of_gigabytes(tmp_path: Path, storage: str, mode: str) -> None:
    """The same for files and messages that rosbag2 has compressed."""
    plugin = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}[storage]
    series, store = joint_states(), get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(tmp_path / 'b', version=9, storage_plugin=plugin)
    if mode == 'FILE':
        writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(series.topic, series.msgtype, typestore=store)
        writer.write(connection, 1, FRAME * 256 if mode == 'MESSAGE' else b'')
    metadata = tmp_path / 'b' / 'metadata.yaml'
    if mode == 'FILE':
        file, = (tmp_path / 'b').glob('*.zstd')
        file.write_bytes(FRAME * 256)
    else:
        content = yaml.safe_load(metadata.read_text())
        content['rosbag2_bagfile_information'] |= {
            'compression_mode': 'MESSAGE', 'compression_format': 'zstd'}
        metadata.write_text(yaml.safe_dump(content))
    with pytest.raises(BagError, match='unpacks to more than 64 times'):
        describe(tmp_path / 'b')


def database(path: Path, *statements: str) -> Path:
    """Write a storage file in the old schema, which is the shortest."""
    file = path / 'a.db3'
    connection = sqlite3.connect(file)
    for statement in (
            'CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)',
            "INSERT INTO topics VALUES (1, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr')",
            *statements):
        connection.execute(statement)
    connection.commit()
    connection.close()
    return file


PLAIN = 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)'


@pytest.mark.parametrize(('statements', 'cause'), [
    (['CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, '
      'data BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL)',
      'INSERT INTO messages VALUES (1, 1, 1)'], 'compute what they hold'),
    (['CREATE VIEW messages AS SELECT 1 id, 1 topic_id, 1 timestamp, zeroblob(900000000) data'],
     'no tables messages and topics'),
    (['CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)'],
     'compute what they hold'),
    ([PLAIN, "INSERT INTO messages VALUES (1, 1, 1, 'text')"], 'which are no bytes'),
    ([PLAIN, 'INSERT INTO messages VALUES (1, 1, 1, zeroblob(5000))'], 'a message of 5000 bytes'),
    ([PLAIN, "INSERT INTO messages VALUES (1, 1, 'now', x'00')"],
     'a str in place of a log time'),
    ([PLAIN, "INSERT INTO messages VALUES (1, 1, 1e-300, x'00')"],
     'a float in place of a log time'),
    ([], 'no tables messages and topics'),
])
def test_databases_that_are_no_bags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, statements: list[str], cause: str,
) -> None:
    """Only plain tables of bytes are read, of bounded length."""
    monkeypatch.setattr(sqlite, 'MAX_PIECE', 4000)
    with pytest.raises(BagError, match=cause):
        describe(database(tmp_path, *statements))


def test_names_without_end(tmp_path: Path) -> None:
    """A topic has the name that ROS allows, no novel."""
    file = database(tmp_path, PLAIN, f"UPDATE topics SET name = '/{'y' * 5000}'")
    with pytest.raises(BagError, match='type of a topic cannot be right') as caught:
        describe(file)
    assert len(str(caught.value)) < 600


def test_text_of_a_library_does_not_steer_the_terminal(tmp_path: Path) -> None:
    """What SQLite says of a damaged file goes into the message, without control characters."""
    file = database(tmp_path, PLAIN)
    file.write_bytes(file.read_bytes().replace(b'CREATE TABLE topics', b'CREATE TABLE \x1b[2J  '))
    with pytest.raises(BagError, match='SQLite: malformed') as caught:
        describe(file)
    assert str(caught.value).isprintable()


def test_file_that_is_listed_twice(tmp_path: Path) -> None:
    """It is read once, and told."""
    bag = make_bag(tmp_path / 'b')
    metadata = bag / 'metadata.yaml'
    content = yaml.safe_load(metadata.read_text())
    content['rosbag2_bagfile_information']['relative_file_paths'] *= 2
    metadata.write_text(yaml.safe_dump(content))
    found = describe(bag)
    assert found.odd == ['metadata.yaml lists a file twice, which is read once']
    assert found.topics[0].count == 300


def test_rows_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More work than a file of this size can need is given up."""
    monkeypatch.setattr(sqlite, 'FREE_STEPS', 10)
    monkeypatch.setattr(sqlite, 'STEPS_PER_BYTE', 0)
    monkeypatch.setattr(sqlite, '_SLICE', 10)
    with pytest.raises(BagError, match='its tables loop'):
        open_bag(make_bag(tmp_path / 'b', storage='sqlite3'))


def test_paths_that_sqlite_takes_for_something_else(tmp_path: Path) -> None:
    """Characters that mean something in a URI are part of a name."""
    bag = make_bag(tmp_path / 'b', storage='sqlite3').rename(tmp_path / 'b?mode=rw#1%20')
    assert len(read_recording(bag, plain_arm()).stamp) == 300


def replace_by_pipe(path: Path) -> None:
    """Put a pipe without a writer in the place of a file."""
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
@pytest.mark.parametrize('name', ['storage', 'metadata.yaml', 'bare'])
@pytest.mark.filterwarnings('ignore::tudor_dynamics.errors.TudorWarning')
def test_pipes(tmp_path: Path, storage: str, name: str) -> None:
    """A pipe in the place of a file is not opened."""
    bag = make_bag(tmp_path / 'b', storage=storage)
    file = next(bag.glob('b.*'))
    replace_by_pipe(bag / name if name == 'metadata.yaml' else file)
    if name == 'metadata.yaml':
        assert len(read_recording(bag, plain_arm()).stamp) == 300  # the data are there
        return
    with pytest.raises(BagError, match='is not a file|not a bag'):
        read_recording(file if name == 'bare' else bag, plain_arm())


@pytest.mark.parametrize('change', [
    lambda text: 'a0: &a0 [1]\n' + '\n'.join(
        f'a{i + 1}: &a{i + 1} [{", ".join([f"*a{i}"] * 9)}]' for i in range(9)) + '\n' + text,
    lambda text: 'a0: &a0 {x: 1}\n' + '\n'.join(
        f'a{i + 1}: &a{i + 1} {{<<: [{", ".join([f"*a{i}"] * 9)}]}}' for i in range(9)) + text,
    lambda text: text + '  x: ' + '[' * 100_000,
    lambda text: text.replace('version: 9', 'version: ' + '1:' * 500_000 + '1')])
def test_metadata_without_end(tmp_path: Path, change: Callable[[str], str]) -> None:
    """References to references, depth and numbers without end: the data are read all the same."""
    bag = make_bag(tmp_path / 'b')
    metadata = bag / 'metadata.yaml'
    metadata.write_text(change(metadata.read_text()))
    found = describe(bag)
    assert found.topics[0].count == 300
    assert any('metadata.yaml cannot be used (no valid YAML' in text for text in found.odd)


@pytest.mark.parametrize(('key', 'value'), [
    ('version', 10), ('version', 'x'), ('storage_identifier', 'none'),
    ('relative_file_paths', 5), ('relative_file_paths', [{}]), ('compression_mode', 'odd'),
    ('compression_mode', 'FILE')])
def test_metadata_that_make_no_sense(tmp_path: Path, key: str, value: Any) -> None:
    """Wrong types and unknown values are told, and the data are read."""
    bag = make_bag(tmp_path / 'b')
    metadata = bag / 'metadata.yaml'
    content = yaml.safe_load(metadata.read_text())
    content['rosbag2_bagfile_information'][key] = value
    metadata.write_text(yaml.safe_dump(content))
    assert any('metadata.yaml cannot be used' in text for text in describe(bag).odd)


@pytest.mark.parametrize('value', [
    None, [3], [{'message_count': 1}], [{'message_count': {}, 'topic_metadata': {'name': 'x'}}]])
def test_counts_that_are_none(tmp_path: Path, value: Any) -> None:
    """Numbers of messages that are none in the metadata cost nothing: the storage counts."""
    bag = make_bag(tmp_path / 'b')
    metadata = bag / 'metadata.yaml'
    content = yaml.safe_load(metadata.read_text())
    content['rosbag2_bagfile_information']['topics_with_message_count'] = value
    metadata.write_text(yaml.safe_dump(content))
    found = describe(bag)
    assert found.odd == [] and found.topics[0].count == 300


def test_more_messages_announced_than_found(tmp_path: Path) -> None:
    """Metadata that promise more than the file has are told."""
    bag = make_bag(tmp_path / 'b')
    metadata = bag / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('message_count: 300', 'message_count: 400'))
    odd = ' '.join(describe(bag).odd)
    assert 'the bag lists 400 messages on /joint_states, but has 300, which are used' in odd


def test_number_of_names() -> None:
    """A message of more names than any arm has is refused, without reading them all."""
    many = joint_states(names=[f'j{i}' for i in range(MAX_NAMES + 1)], position=None,
                        velocity=None, effort=None)
    with pytest.raises(CdrError, match=f'the limit is {MAX_NAMES}'):
        encode(many)
    buffer = bytearray(encode(joint_states()).data[0])
    buffer[20:24] = struct.pack('<I', MAX_NAMES + 1)
    with pytest.raises(CdrError, match='claims'):
        joint_state_layout(bytes(buffer))


def test_compression_that_nobody_knows() -> None:
    """An unknown name of a compression is said."""
    with pytest.raises(Damaged, match="compression 'rar' is unknown"):
        Unpacker(10).unpack(b'x', 'rar', 1)
    assert files.MAX_RATIO == 64  # as the documents say
