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

A move is simulated in closed loop; then its samples are given to a new controller, which is timed
in blocks: reading the clock costs as much as a sample. With another checkout both run by turns,
each in a process of its own; the ratio is now / before.
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
BLOCK = 500  # samples between two readings of the clock


def sample_cost(seconds: float) -> float:
    """Give the median over blocks of the time of a sample [us]."""
    from tudor_dynamics.arm.description import load_arm
    from tudor_dynamics.control.motion_controller import MotionController, State
    from tudor_dynamics.mechanics.closed_loop import ArmProcess, Sample

    arm = load_arm(ROOT / 'config' / 'tudor.yaml')
    process = ArmProcess(arm, rate=1000.0, payload=0.2)
    controller = MotionController(arm)
    more = 'effort' in inspect.signature(controller.step).parameters
    fresh = np.ones(len(arm.gauge_names), dtype=bool)
    sample, samples = process.step(), []
    rest, size = sample.q, np.array([0.25, -0.2])

    def step(controller: MotionController, k: int, sample: Sample) -> np.ndarray | None:
        now, phase = 0.001 * k, 2.0 * max(0.001 * k - 0.5, 0.0)
        controller.reference.add(
            now, rest + size * (1.0 - np.cos(phase)), 2.0 * size * np.sin(phase))
        extra = {'age': 0.0, 'dq': sample.dq, 'effort': sample.current} if more else {}
        return controller.step(now, 0.001 * min(k, 1), sample.q, sample.strain, fresh, **extra)

    for k in range(round(1000.0 * seconds)):
        command = step(controller, k, sample)
        samples.append(sample)
        process.command(np.zeros(len(rest)) if command is None else command)
        sample = process.step()
    assert controller.state is State.FOLLOWING, controller.cause
    taken, controller = [], MotionController(arm)
    for k, sample in enumerate(samples):  # the same samples make the same commands
        if k % BLOCK == 0:
            taken.append(time.process_time_ns())
        step(controller, k, sample)
    assert controller.state is State.FOLLOWING, controller.cause
    return 1e-3 * float(np.median(np.diff(taken)[2:])) / BLOCK


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
