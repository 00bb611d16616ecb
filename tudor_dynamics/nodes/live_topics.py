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

"""How joint states and gauges arrive on this computer, as JSON: ``tudor doctor`` runs it."""

from __future__ import annotations

from functools import partial
import json
import time

import numpy as np
import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import JointState

from tudor_dynamics.nodes.common.interfaces import OUTPUTS
from tudor_dynamics.nodes.settings import LISTEN


def _note(times: list[tuple[float, float]], message: JointState) -> None:
    """Keep when a message arrived, and the age of its stamp then [s]."""
    now, stamp = time.time(), message.header.stamp
    times.append((now, now - stamp.sec - 1e-9 * stamp.nanosec))


def _figures(times: list[tuple[float, float]]) -> dict[str, float]:
    """Give rate [Hz], longest gap and median age [s] of what arrived; none of nothing."""
    if len(times) < 2:
        return {}
    arrived, age = np.transpose(times)
    return {'rate': (len(arrived) - 1) / (arrived[-1] - arrived[0]),
            'gap': float(np.diff(arrived).max()), 'age': float(np.median(age))}


def main() -> None:
    """Listen to joint states of drivers, and print publishers, rate, longest gap and age."""
    rclpy.init()
    node = rclpy.create_node('tudor_doctor')
    heard: dict[str, list[tuple[float, float]]] = {}
    end = time.monotonic() + LISTEN
    while time.monotonic() < end:
        for topic, types in node.get_topic_names_and_types():
            if ('sensor_msgs/msg/JointState' in types and topic not in heard
                    and topic.rpartition('/')[2] not in OUTPUTS):
                heard[topic] = []
                node.create_subscription(JointState, topic, partial(_note, heard[topic]),
                                         qos_profile_sensor_data)
        rclpy.spin_once(node, timeout_sec=0.05)
    print(json.dumps({topic: {'publishers': node.count_publishers(topic), **_figures(times)}
                      for topic, times in sorted(heard.items())}))
    rclpy.shutdown()
