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

"""
Wait until a message has come on each topic; exit code 1 if one is silent for a minute.

    python tools/wait_for_topics.py strain_residuals velocity_commands
"""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.qos import qos_profile_sensor_data

from tudor_dynamics.nodes.bag_player import message_class

PATIENCE = 60.0
"""[s]"""


def main() -> int:
    """Wait."""
    rclpy.init()
    node = rclpy.create_node('wait_for_topics')
    silent = {node.resolve_topic_name(name) for name in sys.argv[1:]}
    heard: set[str] = set()
    end = time.monotonic() + PATIENCE
    while silent and time.monotonic() < end:
        for topic, types in node.get_topic_names_and_types():
            if topic in silent - heard:
                heard.add(topic)
                node.create_subscription(
                    message_class(types[0]), topic,
                    lambda _, topic=topic: silent.discard(topic), qos_profile_sensor_data)
        rclpy.spin_once(node, timeout_sec=0.2)
    node.destroy_node()
    rclpy.shutdown()
    if silent:
        print(f'nothing on {", ".join(sorted(silent))} in {PATIENCE:g} s', file=sys.stderr)
    return 1 if silent else 0


if __name__ == '__main__':
    sys.exit(main())
