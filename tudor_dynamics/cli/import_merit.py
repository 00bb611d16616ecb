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
import csv
import io
import os
from pathlib import Path

import numpy as np

from tudor_dynamics.bags.messages import joint_signals
from tudor_dynamics.bags.writer import write_bag
from tudor_dynamics.errors import BagError
from tudor_dynamics.files import open_regular
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
MAX_BYTES = 100_000_000
MAX_TIME = 1e8
TWO_TURNS = 4 * np.pi


def read_merit(path: str | Path) -> FloatArray:
    """Read and check a MERIt file; returns (samples, 17)."""
    path = Path(path)
    try:
        with io.TextIOWrapper(open_regular(path), encoding='utf-8-sig', newline='') as stream:
            if os.fstat(stream.fileno()).st_size > MAX_BYTES:
                msg = f'{path}: larger than {MAX_BYTES} bytes, this is no MERIt recording'
                raise BagError(msg)
            rows = [_numbers(path, line, cells)
                    for line, cells in enumerate(csv.reader(stream), start=1)
                    if any(cell.strip() for cell in cells) and not (  # columns' names
                        line == 1 and len(cells) > 1 and not any(map(_is_number, cells)))]
    except OSError as err:
        msg = f'{path}: cannot be read ({err.strerror or err}); check path and permissions'
        raise BagError(msg) from None
    except (UnicodeDecodeError, csv.Error) as err:
        raise BagError(f'{path}: no CSV text ({err}); give a file of the MERIt dataset') from None
    if len(rows) < 2:
        msg = f'{path}: has {len(rows)} rows of numbers; give a file of the MERIt dataset'
        raise BagError(msg)
    table = np.array(rows)
    _check(path, table)
    return table


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _numbers(path: Path, line: int, cells: list[str]) -> list[float]:
    if len(cells) != len(COLUMNS):
        raise BagError(f'{path}: line {line} has {len(cells)} columns, expected {len(COLUMNS)} '
                       f'separated by commas ({", ".join(COLUMNS)})')
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        place = next(i for i, cell in enumerate(cells) if not _is_number(cell))
        raise BagError(f'{path}: line {line}, column {COLUMNS[place]}: {cells[place][:40]!r} is '
                       'not a number; correct or remove the line') from None
    for name, value in zip(COLUMNS, values, strict=True):
        if not np.isfinite(value):
            msg = f'{path}: line {line}, column {name}: {value} is not finite; remove the line'
            raise BagError(msg)
    return values


def _check(path: Path, table: FloatArray) -> None:
    t, q = table[:, 0], table[:, 1:4]
    steps = np.diff(t)
    if np.any(steps <= 0):
        row = int(np.argmax(steps <= 0)) + 1
        raise BagError(f'{path}: the time in row {row + 1} ({t[row]:g} s) does not follow '
                       f'{t[row - 1]:g} s; the first column must increase, in seconds')
    if t[0] < 0 or t[-1] > MAX_TIME or np.any(np.diff(np.round(t * 1e9)) <= 0):
        raise BagError(f'{path}: the first column runs from {t[0]:g} to {t[-1]:g}; expected '
                       'seconds that do not begin before 0')
    if np.abs(q).max() > TWO_TURNS:
        raise BagError(f'{path}: positions go to {np.abs(q).max():.4g}; columns 2 to 7 must be in '
                       'rad and rad/s, this looks like degrees')


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
