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

"""The live view of topics: what a monitor publishes stands in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from ros_world import feed, World
from std_msgs.msg import String
from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.bags.reader import read_recording
from tudor_dynamics.nodes.common.base import latched
from tudor_dynamics.nodes.monitor import MonitorNode
from tudor_dynamics.nodes.watch import WatchNode


def test_a_monitor_is_watched(
    world: World, model: Path, root: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ratios, level, event and state; a record that is none is counted."""
    pushes = read_recording(root / 'bags/two_blade_pushes',
                            load_arm(root / 'config/two_blade_arm.yaml'))
    node = world.add(MonitorNode, model=str(model), event_bags='off')
    view = world.add(WatchNode).view
    world.meet('joint_states', 'motor_currents', 'link_strains')
    feed(world, pushes, lambda: node.meter.count // 3 + 1, first=1200, last=1800)
    assert world.spin(lambda: bool(view.events))
    assert world.spin(lambda: view.state.startswith('monitor: '))
    assert set(view.traces) == set(node.watch.stages)
    assert max(peak for trace in view.traces.values() for _, peak in trace.peaks) > 1.0
    assert world.spin(lambda: view.level == node.watch.level.name.lower())
    assert 'times its threshold' in view.events[0]


@pytest.mark.parametrize('text', ['', '[]', '{"onset": 1}', '{"onset": "x", "ratio": 3}'])
def test_foreign_records(world: World, text: str) -> None:
    """They change nothing but a counter."""
    node = world.add(WatchNode)
    sender = world.probe.create_publisher(String, 'collision_record', latched())
    sender.publish(String(data=text))
    assert world.spin(lambda: node.drops['unknown_record'] == 1)
    assert not node.view.events
