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

"""``tudor feedforward``: the efforts that a wanted motion needs, beside it."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tudor_dynamics.bags.trajectory import write_trajectories
from tudor_dynamics.cli.console import (
    add_trajectories, changed_trajectories, check_trajectories, new_table, print_table, say)
from tudor_dynamics.models.bundle import KINDS, load_bundle
from tudor_dynamics.online.feedforward import AT_REST, Feedforward, POSITIONS, UNITS
from tudor_dynamics.signals.motion_profile import denser

EXAMPLES = """\
examples:
  tudor feedforward path.csv --model MODEL --out path_with_effort.csv
  tudor feedforward plan --model MODEL --payload 0.5 --out plan_with_effort
  tudor feedforward path.csv --model MODEL --positions motor --rate 100 \\
      --out led.csv

TRAJECTORY is a CSV file with the columns t, JOINT, ... [s, rad or m] and, where known,
JOINT_velocity and JOINT_acceleration; or a bag of trajectory_msgs/JointTrajectory. What is not
given is made as joint_trajectory_controller makes it: straight lines between positions, cubics
with velocities, quintics with accelerations too. The result is of the same kind, with efforts. See
docs/explanation/feedforward.md.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor feedforward``."""
    add_trajectories(parser)
    parser.add_argument('--model', metavar='MODEL', required=True, help='directory of tudor fit')
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip (that of the training bags)')
    parser.add_argument('--kind', choices=KINDS, default='analytical',
                        help='kind of model (%(default)s)')
    parser.add_argument('--unit', choices=UNITS, default='model',
                        help='efforts as the model has them, as currents [A], or as torques at '
                             'the joints [N m] (%(default)s)')
    parser.add_argument('--positions', choices=POSITIONS, default='wanted',
                        help='positions stay as wanted; or, of elastic arms, become those of the '
                             'motors that put the links there (%(default)s)')
    parser.add_argument('--friction-at-rest', choices=AT_REST, default='none',
                        help='none, or kept: that of the last motion (%(default)s)')
    parser.add_argument('--rate', type=float, metavar='HZ',
                        help='put points onto the splines, so many a second')


def run(args: argparse.Namespace) -> int:
    """Read, compute, write."""
    check_trajectories(args)
    ahead = Feedforward(load_bundle(args.model), kind=args.kind, unit=args.unit,
                        positions=args.positions, friction_at_rest=args.friction_at_rest,
                        payload=args.payload)
    done = changed_trajectories(args, lambda wanted: ahead.along(
        wanted if args.rate is None else denser(wanted, args.rate)))
    write_trajectories(Path(args.out), done, overwrite=args.overwrite)
    # what is asked of each joint at most, and at the end, where the controller holds
    table = new_table('efforts ahead of the motion', names=('joint', 'unit'), figures=(
        'largest', 'at [s]', 'held at\nthe end'))
    for name, unit in zip(ahead.joints, ahead.units, strict=True):
        columns = [(item.trajectory, item.trajectory.joints.index(name)) for item in done]
        best, at, last = 0.0, 0.0, 0.0
        for trajectory, column in columns:
            assert trajectory.effort is not None
            effort = trajectory.effort[:, column]
            k = int(np.abs(effort).argmax())
            last = float(effort[-1])
            if abs(effort[k]) >= abs(best):
                best, at = float(effort[k]), float(trajectory.t[k])
        table.add_row(name, unit, f'{best:.4g}', f'{at:.3f}', f'{last:.4g}')
    print_table(table)
    say(f'{sum(len(item.trajectory.t) for item in done)} points, load {ahead.payload:g} kg: '
        f'{args.out}')
    return 0
