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
Rates, latencies and CPU of the nodes, against a bare rclpy relay of as many hops in the same run.

Each chain runs in processes of its own; this one is the robot and the listener. Latency runs from
the publication of a sample to the arrival of its residual, or of the relayed message.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import os
from pathlib import Path
import signal
from statistics import median
import subprocess
import sys
from threading import Thread
import time

import numpy as np
import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.messages import joint_state, nanoseconds, time_message

RELAY = """
import sys, rclpy
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node('relay_' + sys.argv[1])
out = node.create_publisher(JointState, 'relay_' + str(int(sys.argv[1]) + 1), 10)
node.create_subscription(JointState, 'relay_' + sys.argv[1], out.publish,
                         QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT))
executor = EventsExecutor()
executor.add_node(node)
while rclpy.ok():
    executor.spin_once(timeout_sec=0.5)
"""


def start(words: Sequence[str]) -> subprocess.Popen:
    """Start a process."""
    return subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL, env=os.environ)


def usage(pid: int) -> tuple[float, float]:
    """CPU time [s] and resident memory [MB] of a process."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return ((int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK'),
            pages * os.sysconf('SC_PAGE_SIZE') / 1e6)


class Robot:
    """Publishes samples of a smooth motion, and takes the time of the answers."""

    def __init__(self, model: str) -> None:
        arm = load_bundle(model).arm
        self.joints, self.gauges = list(arm.active_joints), list(arm.gauge_names)
        self.effort_topic = arm.joints[0].effort.topic
        self.strain_topic = arm.gauges[0].topic
        self.node = rclpy.create_node('robot')
        reliable = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self.publishers = [self.node.create_publisher(JointState, topic, reliable) for topic in
                           (arm.spec.joint_topic, self.effort_topic, self.strain_topic)]
        self.relay = self.node.create_publisher(JointState, 'relay_0', reliable)
        self.executor = EventsExecutor()
        self.executor.add_node(self.node)
        self.sent: dict[int, float] = {}
        self.latency: dict[int, float] = {}
        self.stamp = 10**18

    def hear(self, topic: str) -> None:
        """Listen to the answers."""
        self.node.create_subscription(JointState, topic, self._answer, QoSProfile(depth=100))

    def _answer(self, message: JointState) -> None:
        now = time.perf_counter()
        stamp = nanoseconds(message.header.stamp)
        if stamp in self.sent:
            self.latency[stamp] = now - self.sent[stamp]

    def run(self, rate: float, seconds: float, relay: bool) -> tuple[float, list[float]]:
        """Send for a while; share of samples answered, and latencies."""
        self.sent.clear()
        self.latency.clear()
        warm = round(1.5 * rate)
        count = warm + round(rate * seconds)
        t = np.arange(count) / rate
        q = 0.8 + 0.5 * np.sin(t[:, None] * np.arange(1, 1 + len(self.joints)))
        self.stamp += 10 * 10**9
        sender = Thread(target=self._send, args=(t, q, warm, relay), daemon=True)
        sender.start()
        while sender.is_alive():
            self.executor.spin_once(timeout_sec=0.1)
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.1)
        return len(self.latency) / len(self.sent), sorted(self.latency.values())

    def _send(self, t: np.ndarray, q: np.ndarray, warm: int, relay: bool) -> None:
        begin = time.perf_counter()
        for k in range(len(t)):
            wait = begin + t[k] - time.perf_counter()
            if wait > 0:
                time.sleep(wait)
            s = self.stamp + round(t[k] * 1e9)
            stamp = time_message(s)
            messages = [joint_state(stamp, self.joints, position=q[k])]
            if not relay:
                messages += [joint_state(stamp, self.joints, effort=q[k]),
                             joint_state(stamp, self.gauges,
                                         position=100.0 * np.resize(q[k], len(self.gauges)))]
            if k >= warm:  # filters settle, caches fill
                self.sent[s] = time.perf_counter()
            if relay:
                self.relay.publish(messages[0])
            else:
                for publisher, message in zip(self.publishers, messages, strict=True):
                    publisher.publish(message)


def chains(model: str) -> dict[str, list[list[str]]]:
    """Words of the processes of each chain."""
    def node(name: str, *more: str) -> list[str]:
        return ['-m', f'tudor_dynamics.nodes.{name}', '--ros-args', '-p', f'model:={model}', *more]
    methods = ('-p', "methods:=['strain']")
    return {
        'relay 3 hops': [['-c', RELAY, str(k)] for k in range(3)],
        'filter, predictor, detector': [node('joint_state_filter'), node('dynamics_predictor'),
                                        node('collision_detector', *methods)],
        'relay 1 hop': [['-c', RELAY, '0']],
        'monitor': [node('monitor', *methods)]}


def measure(
    name: str, words: list[list[str]], rate: float, seconds: float, model: str,
) -> tuple[float, float, float, float, float]:
    """One run: share answered, p50, p99 [ms], CPU per sample [us], growth of memory [MB]."""
    relay = name.startswith('relay')
    rclpy.init()
    processes = [start(item) for item in words]
    robot = Robot(model)
    try:
        robot.hear(f'relay_{len(words)}' if relay else 'strain_residuals')
        end = time.monotonic() + 30.0
        publisher = robot.relay if relay else robot.publishers[2]
        while not publisher.get_subscription_count() and time.monotonic() < end:
            robot.executor.spin_once(timeout_sec=0.1)
        time.sleep(1.5)
        robot.run(rate, 1.0, relay)
        before = [usage(p.pid) for p in processes]
        share, latency = robot.run(rate, seconds, relay)
        after = [usage(p.pid) for p in processes]
        cpu = sum(b[0] - a[0] for a, b in zip(before, after, strict=True))
        memory = sum(b[1] - a[1] for a, b in zip(before, after, strict=True))
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
        robot.node.destroy_node()
        rclpy.shutdown()
    if not latency:
        return share, float('nan'), float('nan'), 0.0, memory
    return (share, 1e3 * latency[len(latency) // 2], 1e3 * latency[int(0.99 * len(latency))],
            1e6 * cpu / (rate * (seconds + 1.5)), memory)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit, with strain')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--runs', type=int, default=3)
    args = parser.parse_args()
    plan = [('relay 3 hops', 500.0), ('filter, predictor, detector', 500.0),
            ('relay 1 hop', 1000.0), ('monitor', 1000.0), ('relay 1 hop', 2000.0), ('monitor', 2000.0)]  # noqa: E501
    words = chains(args.model)
    found: dict[tuple[str, float], list[tuple[float, ...]]] = {key: [] for key in plan}
    for _ in range(args.runs):
        for name, rate in plan:
            found[name, rate].append(measure(name, words[name], rate, args.seconds, args.model))
    print(f'medians of {args.runs} runs of {args.seconds:g} s')
    print(f'{"chain":30s} {"Hz":>5s} {"answered":>9s} {"p50 ms":>7s} {"p99 ms":>7s} '
          f'{"CPU us/sample":>14s} {"memory MB":>10s}')
    for (name, rate), runs in found.items():
        share, p50, p99, cpu, memory = (median(column) for column in zip(*runs, strict=True))
        print(f'{name:30s} {rate:5.0f} {100 * share:8.2f}% {p50:7.3f} {p99:7.3f} {cpu:14.0f} '
              f'{memory:10.2f}')


if __name__ == '__main__':
    main()
