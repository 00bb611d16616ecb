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
Memory of the nodes over a million messages: it must not grow.

A robot sends samples, two messages each to the chain under test, at a fixed rate. Behind every
100 000 messages the resident memory of each process is printed. The first round counts as the
beginning: caches fill, the queues of the middleware take their size.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import time

from live_nodes import usage
from node_rates import chains, Robot, start
import rclpy

from tudor_dynamics.nodes.common.runner import spin_for

ROUND = 100_000
PER_SAMPLE = 2
"""Messages that a chain with the method strain takes of each sample: joint states and strains."""
CHAINS = {'monitor': 'monitor', 'separate': 'filter, predictor, detector'}


def main() -> int:
    """Run until all messages are through; 1 if memory has grown."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--model', required=True, help='bundle of tudor fit, with strain')
    parser.add_argument('--chain', choices=CHAINS, default='monitor')
    parser.add_argument('--messages', type=int, default=1_000_000)
    parser.add_argument('--rate', type=float, default=1000.0, help='samples per second')
    parser.add_argument('--limit', type=float, default=2.0, help='growth that is allowed [MB]')
    args = parser.parse_args()
    sys.setswitchinterval(1e-4)
    rclpy.init()
    processes = [start(words) for words in chains(args.model)[CHAINS[args.chain]]]
    robot = Robot(args.model)
    history: list[list[float]] = []
    try:
        robot.hear('strain_residuals')
        end = time.monotonic() + 60.0
        while not robot.publishers[2].get_subscription_count() and time.monotonic() < end:
            spin_for(robot.executor, 0.1)
        time.sleep(1.5)
        print(f'{"messages":>9s} {"answered":>9s}  resident memory [MB]')
        for done in range(ROUND, args.messages + 1, ROUND):
            # Robot.run sends 1.5 s of samples before those that it counts
            share, _ = robot.run(args.rate, ROUND / PER_SAMPLE / args.rate - 1.5, False)
            history.append([usage(process.pid)[1] for process in processes])
            print(f'{done:9d} {100 * share:8.2f}%  ',
                  ' '.join(f'{memory:8.2f}' for memory in history[-1]), flush=True)
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
    growth = max(last - first for first, last in zip(history[0], history[-1], strict=True))
    print(f'growth behind the first {ROUND}: {growth:.2f} MB, {args.limit:g} MB are allowed')
    return 0 if growth <= args.limit else 1


if __name__ == '__main__':
    sys.exit(main())
