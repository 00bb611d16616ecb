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
Cost of watching many arms: all in one process (`monitors`), or a process each (`monitor`).

This process is all the robots and the listener: joint states and strains of each arm at a fixed
rate, the arms one after the other within a period, as those that know nothing of each other.
Latency runs from just before the joint states of a sample are published to the arrival of its
residual. Memory is the proportional set size (Pss): pages that several processes share count
in parts, so that figures may be added up. The samples match no model; bags of their events are
not written.

What other processes took meanwhile stands beside the figures. Real-time priority, which suits
`bench/node_rates.py`, does not suit this one: so many processes wait for each other at the start
that a machine of two cores comes to a halt.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
import signal
from statistics import median
import subprocess
import sys
from threading import Thread
import time

from live_nodes import usage
from node_rates import busy, STAMP, start
import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from tables import show

from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.nodes.common.messages import JointStateEncoder
from tudor_dynamics.nodes.common.runner import new_executor, spin_for

LAYOUTS = ('one process', 'one each')
WARM = 2.0
"""Time before anything is counted: filters settle, caches fill [s]."""


@dataclass(frozen=True)
class Cost:
    """What a number of arms took."""

    # Samples, and those without an answer.
    sent: int
    lost: int
    # From sample to residual [s].
    p50: float
    p99: float
    cpu: float  # CPU time a sample, all processes together [s]
    memory: float  # proportional set size of all processes [MB]
    others: float  # what other processes of the machine took meanwhile [cores]


class Hall:
    """Publishes the samples of all arms, and takes the time of the answers."""

    def __init__(self, model: str, count: int) -> None:
        arm = load_bundle(model).arm
        joints, gauges = arm.active_joints, arm.gauge_names
        self._encoders = (JointStateEncoder(joints, ('position',)),
                          JointStateEncoder(gauges, ('position',)))
        self._sizes = (len(joints), len(gauges))
        self.node = rclpy.create_node('hall')
        deep = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        self.publishers = [[
            self.node.create_publisher(JointState, f'/arm{k}/{topic}', deep)
            for topic in (arm.spec.joint_topic, arm.gauges[0].topic)] for k in range(count)]
        self._sent: list[dict[int, float]] = [{} for _ in range(count)]
        self.latency: list[dict[int, float]] = [{} for _ in range(count)]
        for k in range(count):
            self.node.create_subscription(
                JointState, f'/arm{k}/strain_residuals',
                lambda data, k=k: self._answer(k, data), QoSProfile(depth=100), raw=True)
        self.executor = new_executor('events')
        self.executor.add_node(self.node)

    def met(self) -> bool:
        """Say whether somebody listens to every arm."""
        return all(publisher.get_subscription_count() for of in self.publishers
                   for publisher in of)

    def _answer(self, k: int, data: bytes) -> None:
        now = time.perf_counter()
        seconds, rest = STAMP.unpack_from(data, 4)
        begun = self._sent[k].get(seconds * 10**9 + rest)
        if begun is not None:
            self.latency[k][seconds * 10**9 + rest] = now - begun

    def run(self, rate: float, seconds: float, pids: Sequence[int]) -> Cost:
        """Send for a while, and look at what was answered and what it took."""
        sender = Thread(target=self._send, args=(rate, seconds), daemon=True)
        sender.start()
        end = time.monotonic() + WARM
        while time.monotonic() < end:
            spin_for(self.executor, 0.05)
        before, own = [usage(pid)[0] for pid in pids], usage('self')[0]
        machine, begun = busy(), time.monotonic()
        while sender.is_alive():
            spin_for(self.executor, 0.05)
        took = time.monotonic() - begun
        cpu = sum(usage(pid)[0] - at for pid, at in zip(pids, before, strict=True))
        others = (busy() - machine - cpu - (usage('self')[0] - own)) / took
        spin_for(self.executor, 0.5)
        answers = sorted(value for of in self.latency for value in of.values())
        sent = sum(len(of) for of in self._sent)
        nan = float('nan')
        p50, p99 = (answers[int(share * len(answers))] if answers else nan
                    for share in (0.5, 0.99))
        return Cost(sent, sent - len(answers), p50, p99, cpu / (took * rate * len(self._sent)),
                    sum(shared_memory(pid) for pid in pids), max(0.0, others))

    def _send(self, rate: float, seconds: float) -> None:
        count, period = len(self.publishers), 1.0 / rate
        n, gauges = self._sizes
        begin, warm = time.perf_counter(), round(WARM * rate)
        for row in range(warm + round(seconds * rate)):
            stamp = 10**18 + round(row * period * 1e9)
            q = 0.8 + 0.5 * np.sin(row * period * np.arange(1, 1 + n))
            strain = 100.0 * q[np.arange(gauges) % n]
            for k in range(count):
                messages = [encoder.encode(stamp, values) for encoder, values in zip(
                    self._encoders, (q, strain), strict=True)]
                wait = begin + (row + k / count) * period - time.perf_counter()
                if wait > 0:
                    time.sleep(wait)
                if row >= warm:
                    self._sent[k][stamp] = time.perf_counter()
                for publisher, message in zip(self.publishers[k], messages, strict=True):
                    publisher.publish(message)


def shared_memory(pid: int) -> float:
    """Give the proportional set size of a process [MB]."""
    lines = Path(f'/proc/{pid}/smaps_rollup').read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith('Pss:')) / 1e3


def commands(layout: str, count: int, model: str) -> list[list[str]]:
    """Words of the processes of a layout."""
    common = ['-p', f'model:={model}', '-p', "methods:=['strain']", '-p', 'event_bags:=none']
    if layout == 'one process':
        names = ', '.join(f"'arm{k}'" for k in range(count))
        return [['-m', 'tudor_dynamics.nodes', 'monitors', '--ros-args', *common,
                 '-p', f'namespaces:=[{names}]']]
    return [['-m', 'tudor_dynamics.nodes', 'monitor', '--ros-args', *common,
             '-r', f'__ns:=/arm{k}'] for k in range(count)]


def measure(layout: str, count: int, model: str, rate: float, seconds: float) -> Cost:
    """Watch a number of arms for a while: rate [Hz], seconds [s]."""
    rclpy.init()
    processes = [start(words) for words in commands(layout, count, model)]
    hall = Hall(model, count)
    try:
        end = time.monotonic() + 120.0
        while not hall.met():
            spin_for(hall.executor, 0.1)
            if time.monotonic() > end:
                msg = f'{layout}, {count} arms: not all of them are heard after 120 s'
                raise TimeoutError(msg)
        spin_for(hall.executor, 1.5)
        return hall.run(rate, seconds, [process.pid for process in processes])
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
        hall.node.destroy_node()
        rclpy.shutdown()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit, with strain')
    parser.add_argument('--arms', type=int, nargs='+', default=[1, 4, 16])
    parser.add_argument('--rate', type=float, default=100.0, help='of each arm [Hz]')
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('--layout', choices=LAYOUTS, help='only this one')
    args = parser.parse_args()
    sys.setswitchinterval(1e-4)  # the listener must not wait for the sender
    layouts = (args.layout,) if args.layout else LAYOUTS
    print(f'medians of {args.runs} runs of {args.seconds:g} s at {args.rate:g} Hz; lost: of all '
          'runs; other load in % of one core')
    print(f'{"arms":>4s} {"layout":12s} {"lost":>5s} {"of":>7s} {"p50 ms":>7s} {"p99 ms":>7s} '
          f'{"CPU us/sample":>14s} {"CPU %/arm":>10s} {"memory MB":>10s} {"MB/arm":>7s} '
          f'{"other load":>11s}')
    rows = []
    for count in args.arms:
        for layout in layouts:
            runs = [measure(layout, count, args.model, args.rate, args.seconds)
                    for _ in range(args.runs)]
            cpu, memory = median(run.cpu for run in runs), median(run.memory for run in runs)
            print(f'{count:4d} {layout:12s} {sum(run.lost for run in runs):5d} '
                  f'{sum(run.sent for run in runs):7d} {1e3 * median(r.p50 for r in runs):7.3f} '
                  f'{1e3 * median(run.p99 for run in runs):7.3f} {1e6 * cpu:14.0f} '
                  f'{100.0 * cpu * args.rate:10.1f} {memory:10.1f} {memory / count:7.1f} '
                  f'{100.0 * median(run.others for run in runs):10.0f}%', flush=True)
            rows.append((
                count, layout, f'{sum(run.lost for run in runs)} of '
                f'{sum(run.sent for run in runs)}', f'{1e3 * median(r.p50 for r in runs):.1f} ms',
                f'{1e3 * median(run.p99 for run in runs):.1f} ms', f'{1e6 * cpu:.0f} µs',
                f'{100.0 * cpu * args.rate:.1f} % of a core', f'{memory:.0f} MB',
                f'{memory / count:.0f} MB',
                f'{100.0 * median(run.others for run in runs):.0f} %'))
    show(('arms', 'processes', 'samples lost', 'p50', 'p99', 'CPU a sample', 'CPU an arm',
          'memory (Pss)', 'an arm', 'other load, of a core'), rows)


if __name__ == '__main__':
    main()
