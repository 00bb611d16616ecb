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

"""``tudor shape``: shape trajectories so that a tool or load does not keep vibrating."""

from __future__ import annotations

import argparse
from pathlib import Path

from tudor_dynamics.bags.trajectory import write_trajectories
from tudor_dynamics.cli.console import (
    add_trajectories, changed_trajectories, check_trajectories, new_table, print_table, say)
from tudor_dynamics.signals.shaping import convolved, impulses, KINDS, remains

EXAMPLES = """\
examples:
  tudor shape path.csv --frequency 2.9 --damping 0.02 --out still.csv
  tudor shape plan --frequency 2.9 --by zvd --out plan_still

`tudor info BAG --arm YAML` says at which frequency a tool rings, and how it is
damped. TRAJECTORY is a CSV file or a bag, as for `tudor feedforward`, from rest to
rest. Speeds and accelerations stay within those given; corners are cut.
"""
OFF = (-0.05, 0.0, 0.05)  # relative errors of the frequency for which it is said what remains


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor shape``."""
    add_trajectories(parser)
    parser.add_argument('--frequency', type=float, metavar='HZ', required=True,
                        help='at which the tool rings where the arm stops')
    parser.add_argument('--damping', type=float, default=0.02, metavar='RATIO',
                        help='its damping ratio (%(default)s)')
    parser.add_argument('--by', choices=KINDS, default='zv',
                        help='two impulses, half a period longer; or three, a period longer, for '
                             'a frequency less well known (%(default)s)')


def run(args: argparse.Namespace) -> int:
    """Read, shape, say what it brings, write."""
    check_trajectories(args)
    shaper = impulses(args.by, args.frequency, args.damping)
    done = changed_trajectories(args, lambda wanted: convolved(wanted, shaper))
    table = new_table(f'{args.by}, {shaper.time[-1]:.3f} s longer', names=('the tool rings at',),
                      figures=('remains [%]',))
    for off in OFF:
        frequency = (1.0 + off) * args.frequency
        table.add_row(f'{frequency:.3g} Hz',
                      f'{100.0 * remains(shaper, frequency, args.damping):.1f}')
    print_table(table)
    write_trajectories(Path(args.out), done)
    say(f'{sum(len(item.trajectory.t) for item in done)} points: {args.out}')
    return 0
