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

"""Opening bags of every kind, and refusing what is none."""

import hashlib
import re
import shutil
import warnings
import zlib

from bag_making import currents, joint_states, make_bag, plain_arm, times
from hypothesis import given, HealthCheck, settings, strategies as st
import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.mcap import McapFile
from tudor_dynamics.bags.messages import JOINT_STATE
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.bags.writer import encode
from tudor_dynamics.errors import BagError, TudorWarning
from tudor_dynamics.files import Damaged

STORAGES = ('mcap', 'sqlite3')
SUFFIX = {'mcap': '.mcap', 'sqlite3': '.db3'}


def storage_file(bag):
    """Give the only storage file of a bag."""
    file, = (item for item in bag.iterdir() if item.suffix in SUFFIX.values())
    return file


def rosbags_messages(path, topic):
    """Read a topic with rosbags alone."""
    with Reader(path) as reader:
        chosen = [item for item in reader.connections if item.topic == topic]
        return [(time, bytes(data)) for _, time, data in reader.messages(chosen)]


def write_packed(path, plugin, mode, series):
    """Write a compressed bag with rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection(series.topic, JOINT_STATE, typestore=store)
        for stamp, data in zip(series.stamp.tolist(), encode(series).data, strict=True):
            writer.write(connection, stamp, data)


@pytest.mark.parametrize('storage', STORAGES)
def test_raw_messages_are_those_of_rosbags(tmp_path, storage):
    """Times and bytes of each of two topics are the same, in the same order."""
    bag = make_bag(tmp_path / 'b', joint_states(), currents(times(90, 0.03)), storage=storage)
    found = open_bag(bag).read(['/joint_states', '/motor_currents'])
    for topic, raw in found.items():
        pairs = list(zip(raw.log_time.tolist(), raw.data, strict=True))
        assert pairs == rosbags_messages(bag, topic)
    times_only = open_bag(bag).read(['/motor_currents'], with_data=False)['/motor_currents']
    assert len(times_only.log_time) == 90 and times_only.data == []


def test_scan_orders_messages_that_were_written_late(tmp_path):
    """Messages whose log times go back in the file come out in the order of rosbags."""
    store = get_typestore(Stores.ROS2_JAZZY)
    series = joint_states()
    with Writer(tmp_path / 'b', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/joint_states', JOINT_STATE, typestore=store)
        order = np.random.default_rng(0).permutation(300)
        data = encode(series).data
        for index in order.tolist():
            writer.write(connection, int(series.stamp[index]), data[index])
    raw = open_bag(tmp_path / 'b').read(['/joint_states'])['/joint_states']
    assert list(zip(raw.log_time.tolist(), raw.data, strict=True)) == rosbags_messages(
        tmp_path / 'b', '/joint_states')


@pytest.mark.parametrize(('plugin', 'mode'), [
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
    (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (StoragePlugin.SQLITE3, CompressionMode.FILE)])
def test_compressed_bags_are_read(tmp_path, plugin, mode):
    """Compression by chunk, message or file makes no difference to the arrays."""
    write_packed(tmp_path / 'b', plugin, mode, joint_states())
    recording = read_recording(tmp_path / 'b', plain_arm())
    np.testing.assert_array_equal(recording.q, joint_states().values['position'])


@pytest.mark.parametrize('plugin', StoragePlugin)
def test_compressed_messages_without_metadata(tmp_path, plugin):
    """Without metadata, or with damaged ones, compressed messages are known by their begin."""
    write_packed(tmp_path / 'b', plugin, CompressionMode.MESSAGE, joint_states())
    alone = read_recording(storage_file(tmp_path / 'b'), plain_arm())
    np.testing.assert_array_equal(alone.q, joint_states().values['position'])
    metadata = tmp_path / 'b' / 'metadata.yaml'
    metadata.write_text(re.sub('version: [0-9]+', 'version: 5.5', metadata.read_text()))
    with pytest.warns(TudorWarning, match='version 5.5'):
        damaged = read_recording(tmp_path / 'b', plain_arm())
    np.testing.assert_array_equal(damaged.q, joint_states().values['position'])


def test_zstd_chunks_are_scanned(tmp_path):
    """The scan unpacks chunks itself."""
    write_packed(tmp_path / 'b', StoragePlugin.MCAP, CompressionMode.STORAGE, joint_states())
    file = McapFile(storage_file(tmp_path / 'b'))
    data = file.read(['/joint_states'], with_data=True)['/joint_states'].data
    assert data == encode(joint_states()).data


def test_checksums_of_chunks_are_checked(tmp_path):
    """A chunk with the right CRC is read, one with a wrong CRC refused."""
    file = storage_file(make_bag(tmp_path / 'b'))
    content = bytearray(file.read_bytes())
    chunk = 8 + 9 + int.from_bytes(content[9:17], 'little')  # magic, header record
    assert content[chunk] == 0x06
    records = chunk + 9 + 28 + 4 + 8
    size = int.from_bytes(content[records - 8:records], 'little')
    for error, crc in enumerate([zlib.crc32(content[records:records + size]), 12345]):
        content[chunk + 9 + 24:chunk + 9 + 28] = crc.to_bytes(4, 'little')
        file.write_bytes(content)
        if error:
            with pytest.raises(Damaged, match='checksum'):
                McapFile(file).read(['/joint_states'], with_data=True)
            with pytest.raises(BagError, match='checksum'):
                read_recording(file, plain_arm())
        else:
            data = McapFile(file).read(['/joint_states'], with_data=True)['/joint_states'].data
            assert len(data) == 300


@pytest.mark.parametrize('storage', STORAGES)
def test_bare_file_is_read(tmp_path, storage):
    """A storage file alone is a bag."""
    file = storage_file(make_bag(tmp_path / 'b', storage=storage))
    np.testing.assert_array_equal(read_recording(file, plain_arm()).stamp, times())


@pytest.mark.parametrize(
    'content', [None, 'rosbag2_bagfile_information: [unclosed', '', '\x00\xff'])
def test_files_are_read_without_usable_metadata(tmp_path, content):
    """Missing and garbled metadata give the data and a warning."""
    bag = make_bag(tmp_path / 'b')
    (bag / 'metadata.yaml').unlink()
    if content is not None:
        (bag / 'metadata.yaml').write_text(content, encoding='latin-1')
    with pytest.warns(TudorWarning, match='metadata.yaml'):
        recording = read_recording(bag, plain_arm())
    assert len(recording.stamp) == 300 and recording.warnings


def test_metadata_that_names_another_file_is_not_trusted(tmp_path):
    """A renamed storage file is read, with a warning."""
    bag = make_bag(tmp_path / 'b')
    storage_file(bag).rename(bag / 'other.mcap')
    with pytest.warns(TudorWarning, match='cannot be used'):
        assert len(read_recording(bag, plain_arm()).stamp) == 300


@pytest.mark.parametrize('storage', STORAGES)
def test_split_bags_are_joined_in_natural_order(tmp_path, storage):
    """Parts 2, 9 and 10 come in this order, not in that of the alphabet."""
    split = tmp_path / 'split'
    split.mkdir()
    for part, number in enumerate((2, 9, 10)):
        bag = make_bag(tmp_path / f'p{number}', joint_states(times()[part * 100:part * 100 + 100]),
                       storage=storage)
        shutil.copy(storage_file(bag), split / f'part_{number}{SUFFIX[storage]}')
    with pytest.warns(TudorWarning, match='part_2.*part_9.*part_10'):
        recording = read_recording(split, plain_arm())
    np.testing.assert_array_equal(recording.stamp, times())
    assert recording.segments == (slice(0, 300),)


def test_unmerged_log_of_sqlite_is_warned_of(tmp_path):
    """A write-ahead log beside the file means that messages may be missing."""
    file = storage_file(make_bag(tmp_path / 'b', storage='sqlite3'))
    file.with_name(file.name + '-wal').write_bytes(b'x')
    with pytest.warns(TudorWarning, match='never merged'):
        read_recording(file, plain_arm())


def test_checksum_is_that_of_the_file(tmp_path):
    """The checksum can be had from sha256sum."""
    bag = make_bag(tmp_path / 'b')
    expected = hashlib.sha256(storage_file(bag).read_bytes()).hexdigest()
    assert read_recording(bag, plain_arm()).checksum == expected


def nothing(path):
    """Leave the path alone."""


@pytest.mark.parametrize(('name', 'make', 'match'), [
    ('gone', nothing, 'no such file'),
    ('a\0b', nothing, 'cannot be read|no such file'),
    ('empty', lambda p: p.mkdir(), 'no bag in this directory'),
    ('x.bag', lambda p: p.write_bytes(b'#ROSBAG V2.0'), 'rosbags-convert'),
    ('x.mcap.zstd', lambda p: p.write_bytes(b''), 'zstd -d'),
    ('x.txt', lambda p: p.write_bytes(b''), 'not a bag'),
    ('x.mcap', lambda p: p.write_bytes(b''), 'mcap recover'),
    ('x.db3', lambda p: p.write_bytes(b''), 'sqlite3 FILE .recover'),
    ('x.db3', lambda p: p.write_bytes(b'SQLite format 3\0' + b'\xff' * 500), 'recover'),
])
def test_what_is_no_bag_is_refused(tmp_path, name, make, match):
    """One line names the path, the cause and what to do."""
    make(tmp_path / name)
    with pytest.raises(BagError, match=match) as caught:
        open_bag(tmp_path / name)
    assert name.partition('.')[0].replace('\0', '?') in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize('storage', STORAGES)
def test_truncated_storage_is_refused(tmp_path, storage):
    """Half a file is no bag, with its metadata or without."""
    bag = make_bag(tmp_path / 'b', storage=storage)
    file = storage_file(bag)
    file.write_bytes(file.read_bytes()[:file.stat().st_size * 2 // 3])
    for path in (bag, file):
        with pytest.raises(BagError, match='damaged'):
            read_recording(path, plain_arm())


@pytest.fixture(scope='module')
def small_files(tmp_path_factory):
    """Give the bytes of one small bag in each storage, and a place to write others."""
    folder = tmp_path_factory.mktemp('fuzz')
    made = {storage: storage_file(make_bag(folder / storage, joint_states(times(60, 0.02)),
                                           storage=storage)).read_bytes()
            for storage in STORAGES}
    return folder, made


@settings(max_examples=250, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(storage=st.sampled_from(STORAGES), data=st.data())
def test_any_damage_gives_a_recording_or_a_bag_error(small_files, storage, data):
    """Cuts and flipped bytes never end in another exception, in reading and in describing."""
    folder, made = small_files
    content = bytearray(made[storage])
    if data.draw(st.booleans()):
        content = content[:data.draw(st.integers(0, len(content)))]
    if content:
        for _ in range(data.draw(st.integers(0, 5))):
            place = data.draw(st.integers(0, len(content) - 1))
            content[place] = data.draw(st.integers(0, 255))
    file = folder / f'damaged{SUFFIX[storage]}'
    file.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        warnings.simplefilter('error', RuntimeWarning)
        for use in (lambda: read_recording(file, plain_arm()), lambda: describe(file)):
            try:
                use()
            except BagError as err:
                assert str(file.name) in str(err)


def test_topic_that_would_steer_a_terminal_is_refused(tmp_path):
    """Topic names come from the bag and go into messages: control characters are no names."""
    file = storage_file(make_bag(tmp_path / 'b', joint_states(topic='/joint_statEs')))
    file.write_bytes(file.read_bytes().replace(b'/joint_statEs', b'/joint_stat\x1bs'))
    with pytest.raises(BagError, match='type of a topic cannot be right'):
        open_bag(file)
