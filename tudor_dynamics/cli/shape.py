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

from tudor_dynamics.bags.trajectory import Sent, Trajectory, write_trajectories
from tudor_dynamics.cli.console import (
    add_trajectories, changed_trajectories, check_trajectories, new_table, print_table, say)
from tudor_dynamics.errors import UsageError
from tudor_dynamics.models.bundle import load_bundle, ModelBundle, tool_of
from tudor_dynamics.models.still_timing import shaped_for, TIMING
from tudor_dynamics.signals.shaping import convolved, impulses, KINDS, remains

EXAMPLES = """\
examples:
  tudor shape path.csv --frequency 2.9 --damping 0.02 --out still.csv
  tudor shape plan --frequency 2.9 --by zvd --out plan_still
  tudor shape plan --model MODEL --by timing --out plan_still

`tudor info BAG --arm YAML` says at which frequency a tool rings, and how it is damped. TRAJECTORY
is a CSV file or a bag, as for `tudor feedforward`, from rest to rest. zv and zvd keep the speeds
and accelerations of the given motion, and cut corners. timing keeps the path too, and needs the
tool that `tudor fit BAGS --models analytical vibration` learns.
"""
OFF = (-0.05, 0.0, 0.05)  # relative errors of the frequency for which it is said what remains
DAMPING = 0.02  # damping ratio of a tool of which it is unknown


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor shape``."""
    add_trajectories(parser)
    known = parser.add_mutually_exclusive_group(required=True)
    known.add_argument('--frequency', type=float, metavar='HZ',
                       help='at which the tool rings where the arm stops')
    known.add_argument('--model', metavar='MODEL', help='directory of tudor fit with such a tool')
    parser.add_argument('--damping', type=float, metavar='RATIO',
                        help=f'its damping ratio ({DAMPING}, or that of the model)')
    parser.add_argument('--by', choices=(*KINDS, TIMING), default='zv',
                        help='two impulses, half a period longer; three, a period longer, for '
                             'a frequency less well known; or another timing of the same path, '
                             'half a period longer, by the model (%(default)s)')


def run(args: argparse.Namespace) -> int:
    """Read, shape, say what it brings, write."""
    check_trajectories(args)
    if args.model is not None:
        if args.damping is not None:
            raise UsageError('--damping cannot be given with --model, which has its own damping '
                             'ratio', remedy='leave --damping out')
        done = _by_model(args, load_bundle(args.model))
    else:
        done = _by_frequency(args)
    write_trajectories(Path(args.out), done, overwrite=args.overwrite)
    say(f'{sum(len(item.trajectory.t) for item in done)} points: {args.out}')
    return 0


def _by_frequency(args: argparse.Namespace) -> list[Sent]:
    if args.by == TIMING:
        raise UsageError(f'--by {TIMING} needs a model of a tool that vibrates', remedy='give '
                         'as --model what `tudor fit BAGS --models analytical vibration` wrote')
    damping = DAMPING if args.damping is None else args.damping
    shaper = impulses(args.by, args.frequency, damping)
    done = changed_trajectories(args, lambda wanted: convolved(wanted, shaper))
    table = new_table(f'{args.by}, {shaper.time[-1]:.3f} s longer', names=('the tool rings at',),
                      figures=('remains [%]',))
    for off in OFF:
        frequency = (1.0 + off) * args.frequency
        table.add_row(f'{frequency:.3g} Hz', f'{100.0 * remains(shaper, frequency, damping):.1f}')
    print_table(table)
    return done


def _by_model(args: argparse.Namespace, bundle: ModelBundle) -> list[Sent]:
    arm, tool = bundle.arm, tool_of(bundle)
    table = new_table(f'{args.by}: the ring after each trajectory, with 95 % intervals',
                      names=('joint', 'as given', 'shaped'), figures=('longer [s]',))

    def shaped(wanted: Trajectory) -> Trajectory:
        found = shaped_for(bundle, wanted, args.by)
        before, after = (tool.ring_after(arm, item) for item in (wanted, found))
        name = arm.active_joints[before.loudest]
        unit = 'N' if arm.is_prismatic(name) else 'N m'
        table.add_row(name, f'{before.torque} {unit}', f'{after.torque} {unit}',
                      f'{found.t[-1] - wanted.t[-1]:.3f}')
        return found
    done = changed_trajectories(args, shaped)
    print_table(table)
    return done
