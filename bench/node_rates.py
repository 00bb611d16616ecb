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

Each chain runs in processes of its own; this one is the robot and the listener. A sample is three
messages: joint states, efforts, strains. Latency runs from just before the first of them is
published to the arrival of the residual, or of the relayed strains. The relay is the least that
rclpy can do: bytes in, the same bytes out, on the executor of the nodes. `Inside` is the largest
99th percentile that a node itself tells: from a message's arrival in Python to its last result.

What other processes of the machine took meanwhile stands beside the figures: with much of it they
say nothing, unless the bench runs before all others (``nice -n -19 python bench/node_rates.py``),
as a robot's nodes should. A machine that halts for longer than queues are deep loses samples; see
``--depth``. The samples match no model, so that each run has an event: one row has its bag written
meanwhile, the others write none.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
import os
from pathlib import Path
import signal
from statistics import median
import struct
import subprocess
import sys
from tempfile import TemporaryDirectory
from threading import Thread
import time

from diagnostic_msgs.msg import DiagnosticArray
from live_nodes import usage
import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from tables import show

from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.common.messages import JointStateEncoder
from tudor_dynamics.nodes.common.runner import new_executor, spin_for
from tudor_dynamics.nodes.settings import DEEP

RELAY = """
import gc, sys, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from tudor_dynamics.nodes.common.runner import new_executor, spin_for
rclpy.init()
node = rclpy.create_node('relay_' + sys.argv[1])
depth = int(sys.argv[2])
out = node.create_publisher(JointState, 'relay_' + str(int(sys.argv[1]) + 1), depth)
node.create_subscription(JointState, 'relay_' + sys.argv[1], out.publish,
                         QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT),
                         raw=True)
executor = new_executor('events')
executor.add_node(node)
gc.collect()
gc.freeze()
while rclpy.ok():
    spin_for(executor, 0.2)
"""
STAMP = struct.Struct('<iI')
COLUMNS = ('answered', 'p50', 'p99', 'inside', 'cpu', 'memory', 'others')


def start(words: Sequence[str]) -> subprocess.Popen:
    """Start a process."""
    return subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL, env=os.environ)


def busy() -> float:
    """CPU time of the whole machine [s]."""
    words = Path('/proc/stat').read_text().split('\n', 1)[0].split()[1:]
    return sum(int(words[i]) for i in (0, 1, 2, 5, 6, 7)) / os.sysconf('SC_CLK_TCK')


class Robot:
    """Publishes samples of a smooth motion, and takes the time of the answers."""

    def __init__(self, model: str, depth: int = 0) -> None:
        arm = load_bundle(model).arm
        joints, gauges = arm.active_joints, arm.gauge_names
        self.encoders = [JointStateEncoder(joints, ('position',)),
                         JointStateEncoder(joints, ('effort',)),
                         JointStateEncoder(gauges, ('position',))]
        self.sizes = (len(joints), len(gauges))
        self.node = rclpy.create_node('robot')
        reliable = QoSProfile(depth=depth or DEEP, reliability=ReliabilityPolicy.RELIABLE)
        topics = (arm.spec.joint_topic, arm.joints[0].effort.topic, arm.gauges[0].topic, 'relay_0')
        self.publishers = [
            self.node.create_publisher(JointState, topic, reliable) for topic in topics]
        self.executor = new_executor('events')
        self.executor.add_node(self.node)
        self.sent: dict[int, float] = {}
        self.latency: dict[int, float] = {}
        self.stamp = 10**18

        self.inside: dict[str, float] = {}
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._told, 10)

    def _told(self, message: DiagnosticArray) -> None:
        for status in message.status:
            for item in status.values:
                if item.key == 'latency p99 [ms]':
                    self.inside[status.name] = float(item.value)

    def hear(self, topic: str) -> None:
        """Listen to the answers."""
        self.node.create_subscription(JointState, topic, self._answer, QoSProfile(depth=100),
                                      raw=True)

    def _answer(self, data: bytes) -> None:
        now = time.perf_counter()
        seconds, rest = STAMP.unpack_from(data, 4)
        begun = self.sent.get(seconds * 10**9 + rest)
        if begun is not None:
            self.latency[seconds * 10**9 + rest] = now - begun

    def run(self, rate: float, seconds: float, relay: bool) -> tuple[float, list[float]]:
        """Send for a while; share of samples answered, and latencies."""
        self.sent.clear()
        self.latency.clear()
        warm = round(1.5 * rate)
        count = warm + round(rate * seconds)
        t = np.arange(count) / rate
        n, gauges = self.sizes
        q = 0.8 + 0.5 * np.sin(t[:, None] * np.arange(1, 1 + n))
        strain = 100.0 * q[:, np.arange(gauges) % n]
        self.stamp += (count // int(rate) + 10) * 10**9
        sender = Thread(target=self._send, args=(t, q, strain, warm, relay), daemon=True)
        sender.start()
        while sender.is_alive():
            spin_for(self.executor, 0.05)
        spin_for(self.executor, 0.5)
        return len(self.latency) / len(self.sent), sorted(self.latency.values())

    def _send(
        self, t: np.ndarray, q: np.ndarray, strain: np.ndarray, warm: int, relay: bool,
    ) -> None:
        targets = [*self.publishers[:2], self.publishers[3 if relay else 2]]
        begin = time.perf_counter()
        for k in range(len(t)):
            stamp = self.stamp + round(t[k] * 1e9)
            messages = [encoder.encode(stamp, values) for encoder, values in zip(
                self.encoders, (q[k], q[k], strain[k]), strict=True)]
            wait = begin + t[k] - time.perf_counter()
            if wait > 0:
                time.sleep(wait)
            if k >= warm:  # filters settle, caches fill
                self.sent[stamp] = time.perf_counter()
            for publisher, message in zip(targets, messages, strict=True):
                publisher.publish(message)


def queues(topics: Iterable[str], kind: str, depth: int) -> list[str]:
    """Words that make the queues of topics deeper."""
    return [word for topic in topics
            for word in ('-p', f'qos_overrides./{topic}.{kind}.depth:={depth}')]


def chains(model: str, depth: int = 0, events: str = 'none') -> dict[str, list[list[str]]]:
    """Words of the processes of each chain; bags of events go into a folder."""
    arm = load_bundle(model).arm
    sensors = (arm.spec.joint_topic, arm.gauges[0].topic)
    within = ('joint_motion', 'predicted_strains')
    deeper = [] if not depth else [
        *queues((*sensors, *within), 'subscription', depth),
        *queues((*within, 'strain_residuals'), 'publisher', depth)]

    def node(name: str, *more: str) -> list[str]:
        return ['-m', 'tudor_dynamics.nodes', name, '--ros-args', '-p', f'model:={model}', *more,
                *deeper]
    methods = ('-p', "methods:=['strain']")
    return {
        'relay 3 hops': [['-c', RELAY, str(k), str(depth or DEEP)] for k in range(3)],
        'filter, predictor, detector': [node('joint_state_filter'), node('dynamics_predictor'),
                                        node('collision_detector', *methods)],
        'relay 1 hop': [['-c', RELAY, '0', str(depth or DEEP)]],
        'monitor': [node('monitor', *methods, '-p', 'event_bags:=none')],
        'monitor, keeps messages': [  # the bag itself cannot be begun there
            node('monitor', *methods, '-p', 'event_bags:=/dev/null/events')],
        'monitor, writes the bag of an event': [
            node('monitor', *methods, '-p', f'event_bags:={events}')]}


def measure(
    name: str, words: list[list[str]], rate: float, seconds: float, model: str, depth: int = 0,
) -> dict[str, float]:
    """One run: the figures of ``COLUMNS``, in %, ms, us, MB and % of one core."""
    relay = name.startswith('relay')
    rclpy.init()
    processes = [start(item) for item in words]
    robot = Robot(model, depth)
    try:
        robot.hear(f'relay_{len(words)}' if relay else 'strain_residuals')
        end = time.monotonic() + 60.0
        publisher = robot.publishers[3 if relay else 2]
        while not publisher.get_subscription_count() and time.monotonic() < end:
            spin_for(robot.executor, 0.1)
        time.sleep(1.5)
        robot.run(rate, 1.0, relay)
        before = [usage(p.pid) for p in processes]
        own, all_of_it, begin = usage('self')[0], busy(), time.monotonic()
        share, latency = robot.run(rate, seconds, relay)
        after = [usage(p.pid) for p in processes]
        cpu = sum(b[0] - a[0] for a, b in zip(before, after, strict=True))
        others = (busy() - all_of_it - cpu - (usage('self')[0] - own)) / (time.monotonic() - begin)
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
    nan = float('nan')
    p50, p99 = ((1e3 * latency[int(share * len(latency))] if latency else nan)
                for share in (0.5, 0.99))
    return dict(zip(COLUMNS, (
        100.0 * share, p50, p99, max(robot.inside.values(), default=nan),
        1e6 * cpu / (rate * (seconds + 1.5)), memory, max(0.0, 100.0 * others)), strict=True))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit, with strain')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('--each', action='store_true', help='print every run too')
    parser.add_argument('--calm', type=float, default=float('inf'), metavar='PERCENT',
                        help='repeat a run, up to ten times, in which others took more of a core')
    parser.add_argument('--depth', type=int, default=0, help='of all queues; 0: as shipped')
    parser.add_argument('--only', default='', help='relay or chain whose name holds this')
    args = parser.parse_args()
    sys.setswitchinterval(1e-4)  # the listener must not wait for the sender
    plan = [('relay 3 hops', 500.0), ('filter, predictor, detector', 500.0),
            ('monitor', 500.0), ('monitor, keeps messages', 500.0),
            ('relay 1 hop', 1000.0), ('monitor', 1000.0),
            ('monitor, writes the bag of an event', 1000.0),
            ('relay 1 hop', 2000.0), ('monitor', 2000.0)]
    plan = [item for item in plan if args.only in f'{item[0]} {item[1]:.0f}']
    folder = TemporaryDirectory()
    words = chains(args.model, args.depth, folder.name)
    found: dict[tuple[str, float], list[dict[str, float]]] = {key: [] for key in plan}
    for _ in range(args.runs):
        for name, rate in plan:
            for _ in range(10):
                one = measure(name, words[name], rate, args.seconds, args.model,
                              args.depth)
                if one['others'] <= args.calm:
                    break
            found[name, rate].append(one)
            if args.each:
                print(f'{name:30s} {rate:5.0f}', *(f'{one[key]:8.3f}' for key in COLUMNS),
                      flush=True)
    print(f'medians of {args.runs} runs of {args.seconds:g} s')
    rows = []
    relay = float('nan')
    for (name, rate), runs in found.items():
        row = {key: median(run[key] for run in runs) for key in COLUMNS}
        if name.startswith('relay'):
            relay = row['p99']
        rows.append((name, f'{rate:g} Hz', f'{row["answered"]:.2f} %', f'{row["p50"]:.2f} ms',
                     f'{row["p99"]:.2f} ms', f'{row["p99"] / relay:.2f}',
                     f'{row["cpu"]:.0f} µs', f'{row["others"]:.0f} %'))
    show(('chain', 'rate', 'answered', 'p50', 'p99', 'p99 over that of the relay',
          'CPU a sample', 'other load, of a core'), rows)


if __name__ == '__main__':
    main()
