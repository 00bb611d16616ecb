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

"""What ``tudor doctor`` hears of live topics."""

from __future__ import annotations

import json
import subprocess
import sys
import threading

import pytest
from ros_world import World
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from tudor_dynamics.nodes.common.messages import time_message


def test_a_process_hears_joint_states(world: World) -> None:
    """Rate and age of the joint states of a driver, no other type, nothing of a monitor."""
    output, other = world.output('joint_states'), world.output('text', String)
    for topic in ('ringing', 'left/strain_ratios', 'payload_estimator/effort_residuals'):
        world.output(topic)
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.02):
            message = JointState()
            message.header.stamp = time_message(
                world.probe.get_clock().now().nanoseconds - 2 * 10**9)
            output.publish(message)
            other.publish(String())

    sender = threading.Thread(target=publish)
    sender.start()
    try:
        said = subprocess.run([sys.executable, '-m', 'tudor_dynamics.nodes', 'live_topics'],
                              capture_output=True, text=True, timeout=60.0, check=True).stdout
    finally:
        ended.set()
        sender.join()
    heard = json.loads(said)
    assert list(heard) == ['/joint_states']
    assert heard['/joint_states']['publishers'] == 1
    assert 5.0 < heard['/joint_states']['rate'] < 50.5
    assert heard['/joint_states']['age'] == pytest.approx(2.0, abs=0.5)
