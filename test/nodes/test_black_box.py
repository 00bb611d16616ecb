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

"""The black box: a bag at an event, from whose messages the very same event comes again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from ros_world import feed, World
from std_msgs.msg import String
from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.messages import load_topics
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.bags.recording import Recording
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.online.black_box import EVENTS
from tudor_dynamics.online.detector import CollisionEvent
from tudor_dynamics.online.monitor import Monitor, MonitorSettings

BEGIN, END = 1200, 1800
"""Samples of the bag of pushes that are played: one push, from 15.06 s on."""
LOST = range(1350, 1353)
"""Readings of strain that never come."""
TOPICS = ('/joint_states', '/motor_currents', '/link_strains')


@pytest.fixture(scope='module')
def pushes(root: Path) -> Recording:
    """Read the bag in which the arm is pushed."""
    return read_recording(root / 'bags/two_blade_pushes',
                          load_arm(root / 'config/two_blade_arm.yaml'))


def played(world: World, model: Path, pushes: Recording, folder: Path) -> list[dict]:
    """Play a part to a monitor that is ended after it; gives the records on its topic."""
    node = world.add(MonitorNode, model=str(model), event_bags=str(folder))
    records = world.listen('collision_record', String, latched())
    world.meet('joint_states', 'motor_currents', 'link_strains')
    feed(world, pushes, lambda: node.meter.count // 3 + 1, first=BEGIN, last=END,
         change=lambda k, sent: sent.pop('link_strains') if k in LOST else None)
    assert world.spin(lambda: bool(records))
    world.end(node)
    return [json.loads(message.data) for message in records]


def replayed(bag: Path, arm: Arm, model: Path) -> list[CollisionEvent]:
    """Give the messages of a bag to the same object, in the order in which they arrived."""
    monitor = Monitor(load_bundle(model), MonitorSettings(methods=()))
    topics = load_topics(open_bag(bag), TOPICS)
    order = sorted((time, name, row) for name, topic in topics.items()
                   for row, time in enumerate(topic.log_time.tolist()))
    fields = {'/joint_states': (arm.active_joints, 'position'),
              '/motor_currents': (arm.active_joints, 'effort'),
              '/link_strains': (arm.gauge_names, 'position')}
    values = {name: topics[name].select(*of, str(bag))[1] for name, of in fields.items()}
    speeds = topics['/joint_states'].select(arm.active_joints, 'velocity', str(bag))[1]
    events = []
    for _, name, row in order:
        stamp, now = int(topics[name].stamp[row]), values[name][row]
        speed = speeds[row] if len(speeds) else None
        found = (monitor.add_joints(stamp, now, speed) if name == '/joint_states' else
                 monitor.add_measured('effort' if name == '/motor_currents' else 'strain', stamp,
                                      now))
        events += found.events
    return events


def test_replayed_to_the_last_bit(
    world: World, model: Path, pushes: Recording, tmp_path: Path, root: Path,
) -> None:
    """Lost readings included, the event comes again: onset, method, link and all ratios."""
    records = played(world, model, pushes, tmp_path)
    (bag,) = tmp_path.iterdir()
    kept = json.loads(open_bag(bag).custom[EVENTS])
    assert [{key: item[key] for key in records[0]} for item in kept] == records
    assert kept[0]['settings']['model'] == str(model) and kept[0]['state']['arm']
    events = replayed(bag, load_arm(root / 'config/two_blade_arm.yaml'), model)
    assert [(event.onset, event.stamp, event.method, event.link, event.ratios)
            for event in events] == [tuple(record[key] for key in (
                'onset', 'stamp', 'method', 'link', 'ratio')) for record in records]


def test_a_folder_that_takes_nothing(
    world: World, model: Path, pushes: Recording, tmp_path: Path,
) -> None:
    """The monitor goes on, and says why there is no bag."""
    (tmp_path / 'file').touch()
    node_log = world.listen('/rosout', __import__('rcl_interfaces.msg').msg.Log)
    assert played(world, model, pushes, tmp_path / 'file' / 'below')
    assert world.spin(lambda: any('cannot be written' in item.msg for item in node_log))


def test_off(world: World, model: Path, pushes: Recording, tmp_path: Path,
             monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is written, and the record comes all the same."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    assert played(world, model, pushes, Path('off'))
    assert not list(tmp_path.iterdir())
