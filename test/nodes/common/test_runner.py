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

"""The loop of a node: it turns, it ends when it is told to, also with more to do than it can."""

from __future__ import annotations

import math
from pathlib import Path
import signal
import subprocess
import sys
import time

from patience import PATIENCE
import pytest
from ros_world import World
from tudor_dynamics.nodes.common.messages import ListenedPublisher
from tudor_dynamics.nodes.common.runner import Halt, spin_for
from tudor_dynamics.nodes.settings import SUBSCRIPTIONS_LOOK

BUSY = """
import sys, time
from tudor_dynamics.nodes.joint_state_filter import JointStateFilterNode
from tudor_dynamics.nodes.common.runner import run

class Busy(JointStateFilterNode):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for _ in range(3):
            self.create_timer(0.0005, lambda: time.sleep(0.002))
        self.create_timer(0.3, lambda: print('running', flush=True))

sys.exit(run(Busy))
"""


def test_a_node_with_too_much_to_do_ends(root: Path) -> None:
    """SIGTERM ends a node whose timers never leave it a moment, with exit code 0."""
    process = subprocess.Popen([sys.executable, '-c', BUSY], stdout=subprocess.PIPE, text=True,
                               cwd=root)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == 'running\n'
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    assert process.returncode == 0


@pytest.mark.parametrize('kind', ['events', 'single'])
def test_the_loop_turns(kind: str) -> None:
    """Timers run, a halt that was asked for before or in a callback ends the events' loop."""
    world = World(kind)
    try:
        ticks: list[float] = []
        halt = Halt()
        world.probe.create_timer(0.01, lambda: ticks.append(time.monotonic()))
        begin = time.monotonic()
        while len(ticks) < 20 and time.monotonic() < begin + PATIENCE:
            spin_for(world.executor, 0.1, halt)
        assert 20 <= len(ticks) <= 100.0 * (time.monotonic() - begin) + 2.0
        if kind == 'single':
            return
        world.probe.create_timer(0.05, halt.ask)
        begin = time.monotonic()
        spin_for(world.executor, PATIENCE, halt)
        assert halt.asked and time.monotonic() - begin < 0.9 * PATIENCE
        spin_for(world.executor, 2.0 * PATIENCE, halt)
        assert time.monotonic() - begin < 1.8 * PATIENCE
    finally:
        world.close()


def test_listeners_are_noticed_within_a_look(world: World) -> None:
    """Nothing is wanted without listeners; one that comes is seen at the next look."""
    from sensor_msgs.msg import JointState
    publisher = world.probe.create_publisher(JointState, 'listened', 10)
    counted = ListenedPublisher(publisher)
    assert not counted.wanted
    world.listen('listened')
    assert world.spin(lambda: publisher.get_subscription_count() == 1)
    counted._looked = math.inf
    assert not counted.wanted  # not counted yet
    counted._looked = time.perf_counter() - SUBSCRIPTIONS_LOOK
    assert counted.wanted
