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

"""A bag on its way out: what is on disk stays, whatever becomes of disk and process."""

from __future__ import annotations

from collections.abc import Iterator
import errno
import os
from pathlib import Path
import shutil
import sqlite3
import subprocess
import sys

from hypothesis import given, HealthCheck, settings, strategies as st
import pytest
from rosbags.rosbag2 import Reader

from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.storage import abandoned, HOT_JOURNAL, open_bag, read_track
from tudor_dynamics.bags.writer import LiveWriter, WholeFile
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import BagError, TudorWarning

STORAGES = ('mcap', 'sqlite3')
WRENCH = 'geometry_msgs/msg/Wrench'
TOPIC, LATE = '/wrench', '/late'
SIZE = 52

pytestmark = pytest.mark.filterwarnings('ignore::tudor_dynamics.errors.TudorWarning')


def message(number: int) -> bytes:
    """Give a message that can be told from others."""
    return b'\0\1\0\0' + number.to_bytes(8, 'little') * 6


def write(bag: LiveWriter, first: int, count: int, topic: str = TOPIC) -> None:
    """Write messages that count on."""
    bag.add(topic, WRENCH)
    for k in range(first, first + count):
        bag.write(topic, 10**18 + k, message(k))


def numbers(path: Path, topic: str = TOPIC) -> list[int]:
    """Read them back."""
    track = read_track(path, [topic])
    assert all(len(data) == SIZE for data in track.data)
    return [int.from_bytes(data[4:12], 'little') for data in track.data]


def is_finished(path: Path) -> None:
    """Index and metadata are there, for any reader."""
    with Reader(path) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages())
        times = [time for _, time, _ in reader.messages()]
        assert (reader.start_time, reader.end_time) == (times[0], times[-1] + 1)
    assert [item.name for item in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize('storage', STORAGES)
def test_saved_or_not_it_is_the_same_bag(storage: str, tmp_path: Path) -> None:
    """A bag that was saved now and then has every message once, also of topics that came late."""
    bag = LiveWriter(tmp_path / 'b', storage)
    for k in range(10):
        write(bag, 100 * k, 100)
        bag.save()
        bag.save()
    write(bag, 0, 7, LATE)
    bag.close()
    bag.close()
    assert numbers(tmp_path / 'b') == list(range(1000))
    assert numbers(tmp_path / 'b', LATE) == list(range(7))
    is_finished(tmp_path / 'b')


def fill_mcap(bag: LiveWriter, monkeypatch: pytest.MonkeyPatch, room: int, kept: bool) -> None:
    """Let the disk take so many bytes more; what is kept for the end may help."""
    left, plain = [room], WholeFile._some

    def some(self: WholeFile, data: memoryview) -> int:
        if kept and not (bag._scratch / 'reserve').exists():
            return plain(self, data)
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = plain(self, data[:left[0]])
        left[0] -= count
        return count
    monkeypatch.setattr(WholeFile, '_some', some)


def fill_sqlite3(bag: LiveWriter, _: pytest.MonkeyPatch, room: int, kept: bool) -> None:
    """Let the file grow by so much, by SQLite's own bound."""
    connection = bag._writer.storage.conn
    pages, = connection.execute('PRAGMA page_count').fetchone()
    more = max(room // 4096, 4) if kept else 0
    connection.execute(f'PRAGMA max_page_count = {pages + more}')


FILL = {'mcap': fill_mcap, 'sqlite3': fill_sqlite3}
SAID = {'mcap': 'No space left', 'sqlite3': 'disk is full'}


@pytest.mark.parametrize('room', [0, 1, 500, 9000, 70_000])
@pytest.mark.parametrize('storage', STORAGES)
def test_a_full_disk_ends_it_with_what_it_has(
    storage: str, room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The error says how many messages there are, and they are those that were saved."""
    bag = LiveWriter(tmp_path / 'b', storage)
    write(bag, 0, 1000)
    bag.save()
    FILL[storage](bag, monkeypatch, room, True)
    with pytest.raises(BagError, match=f'{SAID[storage]}.* the 1000 messages'):
        for k in range(100):  # a second each: longer than any room
            write(bag, 1000 + 2000 * k, 2000, LATE)
            monkeypatch.setattr(bag, '_mark', lambda: pytest.fail('saved'))
            bag.save()
    bag.close()
    assert numbers(tmp_path / 'b') == list(range(1000))
    is_finished(tmp_path / 'b')
    assert main(['info', str(tmp_path / 'b')]) == 0


@pytest.mark.parametrize('storage', STORAGES)
def test_without_room_for_the_index(
    storage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys,
) -> None:
    """The messages are kept under the bag's name, and can be read; the reader says what is odd."""
    bag = LiveWriter(tmp_path / 'b', storage)
    write(bag, 0, 5000)
    bag.save()
    FILL[storage](bag, monkeypatch, 0, False)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    monkeypatch.setattr(Path, 'write_text', full)  # of metadata.yaml
    with pytest.raises(BagError, match=f'{SAID[storage]}.* the 5000 messages'):
        write(bag, 5000, 30_000)
    assert numbers(tmp_path / 'b') == list(range(5000))
    assert main(['info', str(tmp_path / 'b')]) == 0
    assert 'metadata.yaml is missing' in capsys.readouterr().out
    assert [item.name for item in tmp_path.iterdir()] == ['b']


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of 3 MiB."""
    place = tmp_path / 'disk'
    place.mkdir()
    mount = shutil.which('mount')
    if not mount or subprocess.run([mount, '-t', 'tmpfs', '-o', 'size=3m', 'tmpfs', place],
                                   capture_output=True).returncode:
        pytest.skip('no right to mount a tmpfs here')
    yield place
    subprocess.run(['umount', place], check=True)


@pytest.mark.parametrize('storage', STORAGES)
def test_a_disk_that_is_really_full(storage: str, small_disk: Path) -> None:
    """Whatever it does when it is full: the bag is finished and has what was saved."""
    bag = LiveWriter(small_disk / 'b', storage)
    saved = 0
    with pytest.raises(BagError, match=f'{SAID[storage]}.* the [0-9]+ messages') as caught:
        for k in range(1000):
            write(bag, 500 * k, 500)
            bag.save()
            saved = 500 * (k + 1)
    assert saved > 5000 and f'the {saved} messages' in str(caught.value)
    assert numbers(small_disk / 'b') == list(range(saved))
    is_finished(small_disk / 'b')
    with pytest.raises(OSError, match='No space left'):
        (small_disk / 'rest').write_bytes(bytes(3 << 20))
    with pytest.raises(BagError, match='No space left.*free some space'):
        LiveWriter(small_disk / 'c', storage)
    assert sorted(os.listdir(small_disk)) == ['b', 'rest']


def test_a_disk_that_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where not even the name can be given, nothing is removed and the place is told."""
    bag = LiveWriter(tmp_path / 'b')
    write(bag, 0, 10)
    bag.save()

    def broken(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))
    monkeypatch.setattr(Path, 'rename', broken)
    with pytest.raises(BagError, match='keeps the messages .*Input/output error'):
        bag.close()
    left, = abandoned(tmp_path / 'b')
    assert numbers(left) == list(range(10))


KILLED = """
import sys
from tudor_dynamics.bags.writer import LiveWriter
bag = LiveWriter(sys.argv[1], sys.argv[2])
bag.add('/wrench', 'geometry_msgs/msg/Wrench')
for k in range(20000):
    bag.write('/wrench', 10**18 + k, b'\\0\\1\\0\\0' + k.to_bytes(8, 'little') * 6)
    if k % 3000 == 2999:
        bag.save()
print('ready', flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize('storage', STORAGES)
def test_killed(storage: str, tmp_path: Path, root: Path, capsys) -> None:
    """A real SIGKILL: whoever names the bag is told where it lies, and what was saved is there."""
    process = subprocess.Popen([sys.executable, '-c', KILLED, str(tmp_path / 'b'), storage],
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root)
    assert process.stdout is not None and process.stdout.readline() == b'ready\n'
    process.kill()
    process.communicate()
    left, = abandoned(tmp_path / 'b')
    assert main(['info', str(tmp_path / 'b')]) == 2
    assert str(left) in capsys.readouterr().err
    found = numbers(left)
    assert found == list(range(len(found))) and 18_000 <= len(found) <= 20_000
    assert main(['info', str(left)]) == 0
    assert str(len(found)) in capsys.readouterr().out
    report = describe(left)
    assert any('breaks off' in text for text in report.odd) == (storage == 'mcap')


HALF_WRITTEN = """
import os, signal, sys
from tudor_dynamics.bags.writer import LiveWriter
bag = LiveWriter(sys.argv[1], 'sqlite3')
connection = bag._writer.storage.conn
bag.add('/wrench', 'geometry_msgs/msg/Wrench')
for k in range(30000):
    if k == 1000:
        bag.save()
        connection.execute('PRAGMA cache_size = 10')
        connection.execute(f'PRAGMA cache_spill = {sys.argv[2]}')
    bag.write('/wrench', 10**18 + k, b'\\0\\1\\0\\0' + k.to_bytes(8, 'little') * 6)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize('spill', ['ON', 'OFF'])
def test_killed_while_sqlite_changed_the_file(
    spill: str, tmp_path: Path, root: Path, capsys,
) -> None:
    """
    Pages of two times are never read: it is refused with what to do, and that works.

    The writer lets SQLite change the file in `save` alone, so that this is rare: with as small a
    cache there is nothing to take back.
    """
    subprocess.run([sys.executable, '-c', HALF_WRITTEN, str(tmp_path / 'b'), spill], cwd=root)
    left, = abandoned(tmp_path / 'b')
    if spill == 'ON':
        assert (left / 'b.db3-journal').read_bytes().startswith(HOT_JOURNAL)
        assert main(['info', str(left)]) == 2
        assert 'sqlite3 b.db3 "pragma quick_check"' in capsys.readouterr().err
        with sqlite3.connect(left / 'b.db3') as connection:
            assert connection.execute('pragma quick_check').fetchone() == ('ok',)
    assert numbers(left) == list(range(1000))
    assert main(['info', str(left)]) == 0


@pytest.fixture(scope='module')
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """Give the bytes of a file of three chunks without end, and a place to write others."""
    folder = tmp_path_factory.mktemp('unfinished')
    bag = LiveWriter(folder / 'b')
    for k in range(3):
        write(bag, 20 * k, 20)
        bag.save()
    content = (bag._scratch / 'b' / 'b.mcap').read_bytes()
    bag.close()
    return folder, content


@settings(max_examples=200, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.integers(0, 10_000), tail=st.binary(max_size=30))
def test_any_cut_gives_whole_chunks(
    unfinished: tuple[Path, bytes], cut: int, tail: bytes,
) -> None:
    """Wherever a file breaks off, and whatever follows: a beginning of it, or one clear line."""
    folder, content = unfinished
    file = folder / 'cut.mcap'
    file.write_bytes(content[:cut] + (tail if cut < len(content) else b''))
    try:
        found = numbers(file)
    except BagError as err:
        assert 'cut.mcap' in str(err) and '\n' not in str(err)
    else:
        assert found == list(range(len(found))) and len(found) % 20 == 0


def test_a_bad_copy_of_a_finished_bag_is_no_unfinished_one(tmp_path: Path) -> None:
    """With its metadata it was finished once: it is to be copied again, not read in part."""
    bag = LiveWriter(tmp_path / 'b')
    for k in range(3):
        write(bag, 20 * k, 20)
        bag.save()
    bag.close()
    file = tmp_path / 'b' / 'b.mcap'
    file.write_bytes(file.read_bytes()[:-200])
    for path in (file, tmp_path / 'b'):
        with pytest.raises(BagError, match='cut short, or never closed.*copy the file again'):
            open_bag(path)
    (tmp_path / 'b' / 'metadata.yaml').unlink()
    with pytest.warns(TudorWarning, match='breaks off'):
        assert numbers(tmp_path / 'b') == list(range(60))
