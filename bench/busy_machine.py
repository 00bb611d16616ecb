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
Goals over topics while both cores are busy: does the arm keep to its limits, and is lateness told.

Simulator, reference and damper are processes of their own at normal priority, and beside them a
process for each core spins. A random goal is sent again and again; what could not be reached in
time is sent nevertheless. Judged is what the simulator's encoders read: never more
than 1 deg beyond a limit, never faster than the limit by 5 %. Nothing lies here, so that a fault
of the damper is a false one. What its diagnostics said is counted.
"""

from __future__ import annotations

import argparse
from collections import Counter
import json
import os
import subprocess
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from live_nodes import Listener, PAYLOAD, Processes
import numpy as np
import rclpy

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.limits import hard_limits

BEYOND, FASTER = np.radians(1.0), 1.05
EVERY = 4.0  # time between goals, by the clock of this machine [s]
WINDOW = 5  # samples over which a speed is taken


def drive(args: argparse.Namespace, user: Listener) -> dict[str, Any]:
    """Send goals for a while; give what became of the arm."""
    limits, random = hard_limits(user.arm), np.random.default_rng(args.seed)
    track = user.track('joint_states', user.arm.active_joints)
    end, goals = time.monotonic() + args.seconds, 0
    while time.monotonic() < end:
        user.go(limits.lower + random.random(len(limits.lower)) * (limits.upper - limits.lower))
        goals += 1
        user.spin(EVERY)
    order = np.argsort(track.stamp, kind='stable')
    t, q = 1e-9 * track.stamp[order], track.values[order]
    speed = np.abs(q[WINDOW:] - q[:-WINDOW]) / np.maximum(t[WINDOW:] - t[:-WINDOW], 1e-6)[:, None]
    beyond = np.maximum(limits.lower - q, q - limits.upper)
    statuses = [status for _, status in user.diagnoses('oscillation_damper')]
    said = Counter(status.message for status in statuses)
    return {
        'goals': goals, 'samples': len(q), 'seconds': float(t[-1] - t[0]),
        'largest_gap_s': float(np.diff(np.sort(track.arrival)).max()),
        'beyond_deg': float(np.degrees(beyond.max())),
        'share_of_speed_limit': float((speed / limits.velocity).max()),
        'moved_deg': float(np.degrees(np.abs(np.diff(q, axis=0)).sum())),
        'kept': bool((beyond < BEYOND).all() and (speed < FASTER * limits.velocity).all()),
        'false_faults': sum(status.level == DiagnosticStatus.ERROR for status in statuses),
        'said': dict(said.most_common(12))}


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Start everything, and give the figures."""
    rclpy.init()
    processes, user = Processes(), Listener(load_arm(args.arm))
    spinning = []
    try:
        processes.start('arm_simulator', arm=args.arm, rate=args.rate, payload=PAYLOAD, seed=1)
        processes.start('oscillation_damper', arm=args.arm)
        processes.start('reference_generator', arm=args.arm, rate=args.rate, reaction='hold')
        user.hear('joint_states')
        user.wait(lambda: bool(user.raw['joint_states']), 'the simulator', 600.0)
        user.hear()
        user.status('oscillation_damper')
        spinning = [subprocess.Popen([sys.executable, '-c', 'while True: pass'])
                    for _ in range(args.spinning)]
        found = drive(args, user)
    finally:
        for process in spinning:
            process.kill()
            process.wait()
        codes = processes.end()
        user.node.destroy_node()
        rclpy.shutdown()
    return {**found, 'exit_codes': codes}


def main() -> int:
    """Print the figures; 1 where the arm left its limits, had a fault, or did not move."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ')
    parser.add_argument('--seconds', type=float, default=600.0, metavar='S')
    parser.add_argument('--spinning', type=int, default=os.cpu_count() or 2, metavar='N',
                        help='processes that do nothing but take time')
    parser.add_argument('--seed', type=int, default=0, metavar='N')
    args = parser.parse_args()
    found = run(args)
    print(json.dumps(found, indent=2))
    return 0 if found['kept'] and not found['false_faults'] and found['moved_deg'] > 90.0 else 1


if __name__ == '__main__':
    sys.exit(main())
