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

"""The clock of ROS stops with a simulator; what tells and watches goes on."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from ros_world import Hand, joint_message, JOINTS, World
from std_srvs.srv import Trigger
from tudor_dynamics.nodes.common import base
from tudor_dynamics.nodes.common.base import Meter, SimulatedClock
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.monitor import MonitorNode


@pytest.mark.parametrize('kind', ['events', 'single'])
def test_diagnostics_go_on_while_ros_time_stands_still(kind: str) -> None:
    """With use_sim_time and no /clock at all: OK, then STALE by the steady clock."""
    world = World(kind)
    try:
        hand = Hand()
        node = world.add(JointStateFilterNode, use_sim_time=True)
        node.steady = hand
        world.meet('joint_states')
        assert world.status('joint_state_filter').level == DiagnosticStatus.STALE
        world.output('joint_states').publish(
            joint_message(10**9, JOINTS, position=np.zeros(2)))
        assert world.spin(lambda: node.meter.count == 1)
        assert world.status('joint_state_filter').level == DiagnosticStatus.OK
        hand.now += 0.6
        assert world.status('joint_state_filter').level == DiagnosticStatus.STALE
        assert node.get_clock().now().nanoseconds == 0
    finally:
        world.close()


def test_reload_while_ros_time_stands_still(world: World, model: Path) -> None:
    """A model that was reloaded is taken into use without any /clock."""
    node = world.add(MonitorNode, model=str(model), use_sim_time=True)
    before = node.monitor
    assert world.call(Trigger, 'monitor/reload').success
    assert world.spin(lambda: node.monitor is not before, 20.0)


def test_rate_by_the_steady_clock() -> None:
    """Rates and ages are those of the clock that was given."""
    hand = Hand()
    meter = Meter(hand)
    for _ in range(50):
        meter.end(meter.begin())
    hand.now += 0.5
    assert meter.report()['rate [Hz]'] == '100.0'
    assert meter.stale(0.4) and not meter.stale(0.6)


def test_a_slow_simulator_ages_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its time counts; the wall's where it has stood for a second, was set back, or never came."""
    wall, stamp = 100.0, 0
    monkeypatch.setattr(base.time, 'monotonic', lambda: wall)
    clock = SimulatedClock(lambda: stamp)
    begun = clock()
    wall += 0.3
    assert clock() - begun == pytest.approx(0.3)  # there is no simulator yet
    stamp = 5 * 10**9
    begun = clock()
    for _ in range(4):
        wall, stamp = wall + 0.9, stamp + 2 * 10**6
        assert clock() - begun == pytest.approx((stamp - 5 * 10**9) * 1e-9)
    before = clock()
    wall += 0.9
    assert clock() == before
    wall += 0.9
    assert clock() - before == pytest.approx(0.8)  # it has stood for a second
    before, stamp = clock(), 10**9
    assert clock() == before  # set back
    stamp += 10**8
    assert clock() - before == pytest.approx(0.1)
