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

"""Node bag_player: its ends."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from node_processes import launch
from patience import PATIENCE
import pytest
from rclpy.serialization import deserialize_message
from ros_world import node_class, World
from sensor_msgs.msg import JointState
from tudor_dynamics.bags.storage import read_track

BAG = 'bags/two_blade_test'


@pytest.mark.parametrize('executor', ['events', 'single'])
def test_it_ends_with_the_bag(executor: str, world: World, root: Path) -> None:
    """Exit code 0, no error, and the last message was delivered."""
    heard = world.listen('joint_states')
    process = launch('bag_player', '-p', f'bag:={root / BAG}', '-p', 'topics:=[joint_states]',
                     '-p', 'start_offset:=22.0', '-p', 'rate:=10.0', '-p', 'exit_at_end:=true',
                     '-p', 'wait_for_subscribers:=1', executor=executor)
    try:
        assert world.spin(lambda: process.poll() is not None)
        out, _ = process.communicate()
    finally:
        process.kill()
    assert process.returncode == 0
    assert not any(word in out for word in ('Traceback', '[ERROR]', '[FATAL]')), out
    last = read_track(root / BAG, ['joint_states']).data[-1]
    assert world.spin(lambda: bool(heard))
    world.rest(0.1)
    assert heard[-1] == deserialize_message(last, JointState)


def test_a_bag_that_cannot_be_played(tmp_path: Path, world: World, root: Path) -> None:
    """With exit_at_end it is exit code 2 and the cause; without, a node that says so."""
    process = launch('bag_player', '-p', f'bag:={tmp_path / "none"}', '-p', 'exit_at_end:=true')
    out, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2 and 'no such file' in out and 'Traceback' not in out
    player = world.add(node_class('bag_player'), bag=str(root / BAG), start_offset=1e4, loop=True)
    assert player.exit_code is None and 'the bag lasts 2' in player.fault


def test_waiting_is_no_missing_input(world: World, root: Path) -> None:
    """A player that waits for subscribers says so; it has no input that could be stale."""
    player = world.add(node_class('bag_player'), bag=str(root / BAG), wait_for_subscribers=1,
                       topics=['joint_states'])
    level, message, _ = player.status()
    assert (level, message) == (DiagnosticStatus.OK, 'waits for subscribers')
