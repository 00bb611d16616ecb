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
CPU time of one sample in the controller of `oscillation_damper`, at 1 kHz on the reference arm.

    python bench/controller_cost.py
    python bench/controller_cost.py --against ../before

A move is simulated once; then its samples are given to a new controller again and again. With
another checkout both run by turns, each in a process of its own; the ratio is now / before.
"""

from __future__ import annotations

import argparse
import inspect
import os
from pathlib import Path
import subprocess
import sys
import time

import numpy as np

ROOT = Path(__file__).resolve().parents[1]


def sample_cost(seconds: float) -> float:
    """Give the median over blocks of the time of a sample [us]."""
    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.control.motion_controller import MotionController
    from tudor_dynamics.mechanics.closed_loop import ArmProcess

    arm = load_arm(ROOT / 'config' / 'tudor.yaml')
    process = ArmProcess(arm, rate=1000.0, payload=0.2)
    samples = []
    for k in range(round(1000.0 * seconds)):
        speed = np.array([0.5, -0.4]) * np.sin(0.002 * k)
        process.command(speed)
        samples.append((process.step(), speed))
    controller = MotionController(arm)
    more = 'effort' in inspect.signature(controller.step).parameters
    fresh = np.ones(len(samples[0][0].strain), dtype=bool)
    taken = []
    for k, (sample, speed) in enumerate(samples):
        now = 0.001 * k
        controller.reference.add(now, sample.q, 0.0 * speed)
        extra = {'age': 0.0, 'dq': sample.dq, 'effort': sample.current} if more else {}
        begun = time.process_time_ns()
        controller.step(now, 0.001 * min(k, 1), sample.q, sample.strain, fresh, **extra)
        taken.append(time.process_time_ns() - begun)
    blocks = np.array(taken[1000:]).reshape(-1, 500)
    return 1e-3 * float(np.median(np.median(blocks, axis=1)))


def main() -> int:
    """Print the figure, and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--against', metavar='TREE', type=Path, help='checkout to compare with')
    parser.add_argument('--runs', type=int, default=5)
    parser.add_argument('--seconds', type=float, default=6.0, help='of the move')
    args = parser.parse_args()
    if args.against is None:
        print(f'{sample_cost(args.seconds):.1f}')
        return 0
    taken: dict[Path, list[float]] = {args.against.resolve(): [], ROOT: []}
    for _ in range(1 + args.runs):
        for tree, found in taken.items():
            done = subprocess.run(
                [sys.executable, __file__, '--seconds', str(args.seconds)], check=True, text=True,
                stdout=subprocess.PIPE, env={**os.environ, 'PYTHONPATH': str(tree)})
            found.append(float(done.stdout))
    before, now = (np.array(found[1:]) for found in taken.values())
    print(f'before {np.median(before):.1f} us a sample, now {np.median(now):.1f} us; now / before '
          f'{np.median(now / before):.2f}, from {(now / before).min():.2f} to '
          f'{(now / before).max():.2f}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
