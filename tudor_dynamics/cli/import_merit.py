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
``tudor import-merit``: a public recording of the TUDOR arm (MERIt dataset, TU Dortmund) as a bag.

eps21 and eps31 are the gauges near the hubs of links 2 and 3, eps22 and eps32 the second pair.
Accelerations are not imported: JointState has none, and they are recomputed from the positions
anyway.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.mechanics.study import read_table
from tudor_dynamics.typing import FloatArray

EXAMPLES = """\
example:
  tudor import-merit exp1.csv --out bags/merit_exp1

The file has no header and 17 columns: t [s], q1..q3 [rad], dq1..dq3 [rad/s], I1..I3 [A],
eps21, eps22, eps31, eps32 [um/m], ddq1..ddq3 [rad/s^2]. The bag has /joint_states (joint1..3),
/motor_currents (effort) and /link_strains (link2_hub, link2_mid, link3_hub, link3_mid).
"""


COLUMNS = ('t', 'q1', 'q2', 'q3', 'dq1', 'dq2', 'dq3', 'I1', 'I2', 'I3',
           'eps21', 'eps22', 'eps31', 'eps32', 'ddq1', 'ddq2', 'ddq3')
JOINTS = ('joint1', 'joint2', 'joint3')
GAUGES = ('link2_hub', 'link2_mid', 'link3_hub', 'link3_mid')
START = 1_000_000_000
"""Stamp of t = 0 [ns]: a stamp of zero would mean "not set" in ROS."""
TWO_TURNS = 4 * np.pi


def read_merit(path: str | Path) -> FloatArray:
    """Read and check a MERIt file; returns (samples, 17)."""
    t, columns = read_table(Path(path), COLUMNS[1:])
    if len(columns) < len(COLUMNS) - 1:
        raise BagError(f'found the columns t, {", ".join(columns)}; expected {list(COLUMNS)}',
                       place=path)
    table = np.column_stack([t, *(columns[name] for name in COLUMNS[1:])])
    largest = np.abs(table[:, 1:4]).max()
    if largest > TWO_TURNS:
        raise BagError(f'positions go to {largest:.4g}; columns 2 to 7 must be in rad and rad/s, '
                       'this looks like degrees', place=path)
    return table


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor import-merit``."""
    parser.add_argument('file', metavar='FILE.csv', help='recording of the MERIt dataset')
    parser.add_argument('--out', metavar='BAG', required=True,
                        help='directory to make; must not exist')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap',
                        help='storage format (default: mcap)')


def run(args: argparse.Namespace) -> int:
    """Convert the file."""
    table = read_merit(args.file)
    stamp = START + np.round(table[:, 0] * 1e9).astype(np.int64)
    write_bag(args.out, [
        joint_signals('/joint_states', stamp, JOINTS, table[:, 1:4], table[:, 4:7]),
        joint_signals('/motor_currents', stamp, JOINTS, effort=table[:, 7:10]),
        joint_signals('/link_strains', stamp, GAUGES, table[:, 10:14]),
    ], storage=args.storage)
    print(f'{args.out}: {len(table)} samples of /joint_states, /motor_currents and /link_strains')
    return 0
