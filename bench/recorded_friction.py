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
Friction and ripple of the arm in a recording of the MERIt dataset, for ``config/tudor.yaml``.

Least squares of each joint's current over the samples in motion: acceleration, gravity, friction
that is viscous, Coulomb's and a share of the load (static strain at the hub, scaled by gravity),
and a cosine of the motor's angle. Deviations by leaving out one of ten parts at a time.
"""

from __future__ import annotations

import argparse
from pathlib import Path
import sys

import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.typing import FloatArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from papers.merit import COLUMNS, read_merit  # noqa: E402, I100

MOVING = 0.05
"""Speed from which a sample counts [rad/s]."""
PARTS = 10
NAMES = ('viscous [A s/rad]', 'Coulomb up [A]', 'Coulomb down [A]', 'share of the load',
         'ripple, cosine [A]', 'ripple, sine [A]')


def columns(table: FloatArray, joint: int, gear: float) -> tuple[FloatArray, FloatArray]:
    """Give the columns of a joint's current, four of the links and NAMES, and that current."""
    def at(name: str) -> FloatArray:
        return table[:, COLUMNS.index(name)]

    q2, q23, dq = at('q2'), at('q2') + at('q3'), at(f'dq{joint}')
    motion = np.column_stack([at('ddq2'), at('ddq3'), np.cos(q2), np.cos(q23)])
    strain, current = at(f'eps{joint}1'), at(f'I{joint}')
    up = dq > 0.0
    angle = gear * at(f'q{joint}')
    own = 0 if joint == 2 else 1  # the gravity of the joint's own link
    scale = 0.0
    for _ in range(5):  # the load in A: by what the gravity of a first fit says of the strain
        result = np.column_stack([motion, dq, up, -1.0 * ~up,
                                  np.sign(dq) * np.abs(strain) * scale,
                                  np.cos(angle), -np.sin(angle)])
        moving = np.abs(dq) > MOVING
        fit = np.linalg.lstsq(result[moving], current[moving], rcond=None)[0]
        bending = np.linalg.lstsq(np.column_stack([np.cos(q2), np.cos(q23)]), strain,
                                  rcond=None)[0]
        scale = fit[2 + own] / bending[own]
    return result, current


def main() -> int:
    """Print the coefficients of joints 2 and 3, and what is left over."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('csv', metavar='MERIT.csv')
    parser.add_argument('--arm', default='config/tudor.yaml', metavar='YAML')
    args = parser.parse_args()
    motors = {motor.joint: motor for motor in load_arm(args.arm).spec.motors}
    table = read_merit(args.csv)
    for joint in (2, 3):
        x, y = columns(table, joint, motors[f'joint{joint}'].gear_ratio)
        moving = np.abs(table[:, COLUMNS.index(f'dq{joint}')]) > MOVING
        part = np.arange(len(y)) * PARTS // len(y)

        def fit(chosen: NDArray[np.bool_], x: FloatArray = x, y: FloatArray = y) -> FloatArray:
            return np.asarray(np.linalg.lstsq(x[chosen], y[chosen], rcond=None)[0])

        found = fit(moving)
        without = np.array([fit(moving & (part != k)) for k in range(PARTS)])
        deviation = np.sqrt((PARTS - 1) / PARTS * ((without - without.mean(0)) ** 2).sum(0))
        print(f'joint {joint}, {moving.sum()} samples')
        for name, value, spread in zip(NAMES, found[4:], deviation[4:], strict=True):
            print(f'  {name:20s} {value:7.3f}  +- {spread:.3f}')
        print(f'  ripple {np.hypot(*found[-2:]):.3f} A at {np.arctan2(*found[:-3:-1]):.2f} rad')
        for keep, text in ((7, 'viscous and Coulomb alone'), (8, 'and the load'),
                           (10, 'and the ripple')):
            left = y[moving] - x[moving, :keep] @ np.linalg.lstsq(
                x[moving, :keep], y[moving], rcond=None)[0]
            print(f'  left over, {text}: {np.sqrt((left**2).mean()):.3f} A')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
