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

"""Node bag_recorder: a full disk, and a process that is killed."""

from __future__ import annotations

from collections.abc import Callable
import errno
import os
from pathlib import Path
import resource
import sqlite3

from diagnostic_msgs.msg import DiagnosticStatus
from node_processes import launch
import numpy as np
import pytest
from ros_world import joint_message, node_class, World
from sensor_msgs.msg import JointState
from tudor_dynamics.bags.info import describe
from tudor_dynamics.bags.storage import abandoned, read_track
from tudor_dynamics.bags.writer import WholeFile
from tudor_dynamics.cli.main import main
from tudor_dynamics.errors import BagError

STORAGES = ('mcap', 'sqlite3')

pytestmark = pytest.mark.filterwarnings('ignore::tudor_dynamics.errors.TudorWarning')


def state(number: int, count: int = 2) -> JointState:
    """Give a message that can be told from others, of any size."""
    return joint_message(10**18 + number, [f'j{k}' for k in range(count)],
                         position=np.full(count, number))


def stamps(path: Path) -> list[int]:
    """Read back which messages are in a bag."""
    return [int.from_bytes(data[4:8], 'little') * 10**9 + int.from_bytes(data[8:12], 'little')
            - 10**18 for data in read_track(path).data]


def run_of(found: list[int]) -> list[int]:
    """
    Give the numbers without a hole that begin where these do.

    What was sent before a process knew of the writer does not reach it.
    """
    return list(range(found[0], found[0] + len(found)))


def publisher(world: World) -> Callable[..., None]:
    """Give what publishes messages that count on, once the recorder hears."""
    output = world.output('joint_states')
    assert world.spin(lambda: output.get_subscription_count() > 0)
    world.rest(0.2)
    sent = [0]

    def publish(count: int = 2) -> None:
        output.publish(state(sent[0], count))
        sent[0] += 1
        world.rest(0.005)
    return publish


@pytest.mark.parametrize('storage', STORAGES)
def test_a_full_disk_is_an_error(
    storage: str, world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The node ends the bag with what was saved, says so, and asks for an exit code."""
    node = world.add(node_class('bag_recorder'), bag=str(tmp_path / 'b'), storage=storage,
                     topics=['joint_states'])
    publish = publisher(world)
    for _ in range(50):
        publish()
    assert world.spin(lambda: node.meter.count == 50)
    node._save()
    scratch, plain = node.writer._scratch, WholeFile._some

    def some(self: WholeFile, data: memoryview) -> int:
        if (scratch / 'reserve').exists():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return plain(self, data)
    if storage == 'mcap':
        monkeypatch.setattr(WholeFile, '_some', some)
    else:
        connection = node.writer._writer.storage.conn
        pages, = connection.execute('PRAGMA page_count').fetchone()
        connection.execute(f'PRAGMA max_page_count = {pages + 2}')
    assert node.exit_code is None

    def ended() -> bool:
        publish(500)
        return node.exit_code is not None
    assert world.spin(ended)
    # one from before may still be on its way
    status = world.status('bag_recorder', lambda s: s.level != DiagnosticStatus.OK)
    assert status.level == DiagnosticStatus.ERROR and node.exit_code == 1
    assert 'recording has ended' in status.message and status.message == node.fault
    found = stamps(tmp_path / 'b')
    assert found == list(range(len(found))) and len(found) >= 50
    assert f'the {len(found)} messages' in status.message
    assert (tmp_path / 'b' / 'metadata.yaml').is_file()
    publish()
    world.end(node)


@pytest.mark.parametrize('storage', STORAGES)
def test_its_process_ends_with_an_exit_code(storage: str, world: World, tmp_path: Path) -> None:
    """Files that may not grow further: exit code 1, one line, and a bag with the beginning."""
    limit = 3 << 19  # beyond what is kept for the end

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    process = launch('bag_recorder', '-p', f'bag:={tmp_path / "b"}', '-p', f'storage:={storage}',
                     '-p', 'topics:=[joint_states]', preexec_fn=bound)
    try:
        publish = publisher(world)

        def ended() -> bool:
            publish(1000)  # as many names as are read: 20 kB
            return process.poll() is not None

        def saved() -> bool:
            publish()
            return in_scratch(tmp_path / 'b', 20)
        assert world.spin(saved)
        assert world.spin(ended)
        out, _ = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 1, out
    assert 'cannot be written any more' in out and 'Traceback' not in out
    found = stamps(tmp_path / 'b')
    assert found == run_of(found) and len(found) >= 20
    assert f'the {len(found)} messages' in out
    assert not any('metadata' in text for text in describe(tmp_path / 'b').odd)


def in_scratch(bag: Path, count: int) -> bool:
    """Say whether so many messages are on disk already."""
    try:
        return any(len(stamps(place)) >= count for place in abandoned(bag))
    except BagError:
        return False


@pytest.mark.parametrize('storage', STORAGES)
def test_killed(storage: str, world: World, tmp_path: Path, capsys) -> None:
    """SIGKILL: what came a second before is in what is left, and `tudor info` reads it."""
    process = launch('bag_recorder', '-p', f'bag:={tmp_path / "b"}', '-p', f'storage:={storage}',
                     '-p', 'topics:=[joint_states]')
    try:
        publish = publisher(world)

        def saved() -> bool:
            publish()
            return in_scratch(tmp_path / 'b', 100)
        assert world.spin(saved)
        for _ in range(30):
            publish()
    finally:
        process.kill()
        process.communicate()
    left, = abandoned(tmp_path / 'b')
    if main(['info', str(left)]):
        # killed in a commit, which takes as long as the disk does: what it says must help
        assert storage == 'sqlite3' and 'pragma quick_check' in capsys.readouterr().err
        with sqlite3.connect(left / 'b.db3') as connection:
            connection.execute('pragma quick_check').fetchall()
    found = stamps(left)
    assert found == run_of(found) and len(found) >= 100
    assert main(['info', str(left)]) == 0
    assert main(['info', str(tmp_path / 'b')]) == 2
    assert str(left) in capsys.readouterr().err
