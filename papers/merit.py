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
``python -m papers import-merit``: a recording of the TUDOR arm (MERIt, TU Dortmund) as a bag.

eps21 and eps31 are the gauges near the hubs of links 2 and 3, eps22 and eps32 the second pair.
Accelerations are not imported: JointState has none, and they are recomputed from the positions
anyway.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import warnings

import numpy as np
from numpy.typing import NDArray
import tudor_dynamics as td

EXAMPLES = """\
example:
  python -m papers import-merit exp1.csv --out bags/merit_exp1

The file has 17 columns, with or without a line of names: t [s], q1..q3 [rad], dq1..dq3 [rad/s],
I1..I3 [A], eps21, eps22, eps31, eps32 [um/m], ddq1..ddq3 [rad/s^2]. The bag has /joint_states
(joint1..3), /motor_currents (effort) and /link_strains (link2_hub, link2_mid, link3_hub,
link3_mid).
"""
COLUMNS = ('t', 'q1', 'q2', 'q3', 'dq1', 'dq2', 'dq3', 'I1', 'I2', 'I3',
           'eps21', 'eps22', 'eps31', 'eps32', 'ddq1', 'ddq2', 'ddq3')
JOINTS = ('joint1', 'joint2', 'joint3')
GAUGES = ('link2_hub', 'link2_mid', 'link3_hub', 'link3_mid')
START = 1_000_000_000
"""Stamp of t = 0 [ns]: a stamp of zero would mean "not set" in ROS."""
TWO_TURNS = 4 * np.pi


def read_merit(path: str | Path) -> NDArray[np.float64]:
    """Read and check a MERIt file; returns (samples, 17)."""
    with open(path, encoding='utf-8') as file:
        named = file.readline().lstrip('# ').startswith('t,')
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # of an empty file, which is refused below
        table = np.loadtxt(path, delimiter=',', ndmin=2, skiprows=int(named))
    if table.shape[0] < 2 or table.shape[1] != len(COLUMNS):
        raise ValueError(f'found {table.shape[0]} rows of {table.shape[1]} columns; expected two '
                         f'rows or more of {", ".join(COLUMNS)}')
    for wrong, what in ((~np.isfinite(table).all(axis=1), 'a value is not finite'),
                        (np.diff(table[:, 0], prepend=-np.inf) <= 0.0, 'time does not increase')):
        if wrong.any():
            raise ValueError(f'{what} in data row {int(np.flatnonzero(wrong)[0]) + 1}')
    largest = np.abs(table[:, 1:4]).max()
    if largest > TWO_TURNS:
        raise ValueError(f'positions go to {largest:.4g}; columns 2 to 7 must be in rad and '
                         'rad/s, this looks like degrees')
    return table


def main(argv: Sequence[str]) -> int:
    """Convert a file; gives the exit code."""
    parser = argparse.ArgumentParser(
        prog='python -m papers import-merit', epilog=EXAMPLES, description='Make a bag of a CSV '
        'file of the public TUDOR recordings (MERIt).',
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('file', metavar='FILE.csv', help='recording of the MERIt dataset')
    parser.add_argument('--out', metavar='BAG', required=True,
                        help='directory to make; must not exist')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                        help='storage format (default: mcap)')
    args = parser.parse_args(argv)
    try:
        table = read_merit(args.file)
    except ValueError as err:
        raise td.TudorError(f'{args.file}: {err}') from None
    stamp = START + np.round(table[:, 0] * 1e9).astype(np.int64)
    td.write_bag(args.out, [
        td.joint_signals('/joint_states', stamp, JOINTS, table[:, 1:4], table[:, 4:7]),
        td.joint_signals('/motor_currents', stamp, JOINTS, effort=table[:, 7:10]),
        td.joint_signals('/link_strains', stamp, GAUGES, table[:, 10:14]),
    ], storage=args.storage)
    print(f'{args.out}: {len(table)} samples of /joint_states, /motor_currents and /link_strains')
    return 0
