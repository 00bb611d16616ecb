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

"""``tudor tune``: gains of damper and position loop by payload and pose, from an elastic model."""

from __future__ import annotations

import argparse

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.cli.console import add_out, bar, new_table, print_json, print_table, say
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target
from tudor_dynamics.models.bundle import elastic_of, load_bundle
from tudor_dynamics.models.tuning import design, fixed_ratios, TunedArm, Wish
from tudor_dynamics.show.pictures import draw_schedule, SUFFIXES, write_picture

EXAMPLES = """\
examples:
  tudor tune config/tudor.yaml --payloads 0 0.2 0.4 --out schedule.yaml
  tudor tune my_arm.yaml --model model --damping-ratio 0.5 --out schedule.yaml
  ros2 run tudor_dynamics oscillation_damper --ros-args -p arm:=my_arm.yaml \\
      -p gain_schedule:=schedule.yaml

The schedule has, over payload and pose, the gains with which the first mode has the damping ratio
that is asked for at the delay of the loop, the strain that load and accelerations make, and the
modes, which reference_generator shapes its moves by. Beside it goes a picture, schedule.png.
Without --model links, gears and gauges are those of the description. A model of several payloads
says which ones there are (five of its range); --payloads says others.

exit codes: 0 done; 1 the ratio is missed by more than 20 % somewhere, because the delay or the
position loop allows no more (the schedule is written, with what can be had there); 2 wrong input
"""

MISSED = 0.2  # part of the damping ratio by which it may be missed
GRID = 5  # payloads between the ends of a model's range, both included


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor tune``."""
    parser.add_argument('arm', metavar='ARM.yaml', help='arm description with links and damper')
    parser.add_argument('--model', metavar='MODEL',
                        help='directory of tudor fit with an elastic model of the strain')
    parser.add_argument('--damping-ratio', type=float, default=Wish.damping_ratio, metavar='Z',
                        help=f'of the first mode ({Wish.damping_ratio:g})')
    parser.add_argument('--delay', type=float, default=Wish.delay, metavar='S',
                        help='of the loop, from readings to commands in effect [s] '
                             f'({Wish.delay:g})')
    parser.add_argument('--payloads', type=float, nargs='+', metavar='KG',
                        help='masses at the tip, ascending')
    add_out(parser, 'FILE.yaml', 'schedule to write')
    parser.add_argument('--picture', metavar='FILE',
                        help='picture of it (.png, .svg or .pdf; beside the schedule)')


def run(args: argparse.Namespace) -> int:
    """Compute, write and draw a schedule."""
    out = check_target(args.out, overwrite=args.overwrite, endings=('.yaml', '.yml'))
    picture = check_target(args.picture or out.with_suffix('.png'), overwrite=args.overwrite,
                           name='picture', endings=SUFFIXES)
    arm = load_arm(args.arm)
    model = None
    own = arm.spec.payload.mass if arm.spec.payload is not None else 0.0
    payloads = (own,)
    if args.model:
        bundle = load_bundle(args.model, arm=arm)
        model = elastic_of(bundle, 'strain')
        if model is None:
            raise UsageError(f'{args.model}: the folder has no elastic model that predicts '
                             'strain; fit one with tudor fit --models elastic')
        if bundle.payload_range is not None:
            payloads = tuple(np.linspace(*bundle.payload_range, GRID).round(6).tolist())
        elif bundle.payload is not None:
            payloads = (bundle.payload,)
    wish = Wish(args.damping_ratio, args.delay, tuple(args.payloads or payloads))
    tuned = TunedArm(arm, model)
    with bar(None, 'tuning') as advance:
        schedule = design(tuned, wish, lambda done, total: advance(completed=done, total=total))
        fixed = fixed_ratios(tuned, wish.delay, schedule)
    out.parent.mkdir(parents=True, exist_ok=True)
    schedule.save(out)
    write_picture(picture, draw_schedule, schedule, fixed)
    reached = schedule.column('reached')
    missed = reached < (1.0 - MISSED) * wish.damping_ratio
    rows = [(payload, schedule.column('frequency(1)')[i], schedule.column('position_gain')[i],
             reached[i], fixed[i], schedule.column('full_delay')[i])
            for i, payload in enumerate(schedule.payload.tolist())]
    if args.json:
        names = ('frequency', 'position_gain', 'damping_ratio', 'damping_ratio_fixed_gains',
                 'full_delay')
        print_json({'schedule': str(out), 'picture': str(picture), 'asked': wish.damping_ratio,
                    'nodes': int(reached.size), 'missed': int(missed.sum()),
                    'payloads': [{'payload': row[0], **{
                        name: [float(values.min()), float(values.max())]
                        for name, values in zip(names, row[1:], strict=True)}} for row in rows]})
        return int(missed.any())
    table = new_table(f'{arm.name}: damping ratio {wish.damping_ratio:g} at a delay of '
                      f'{1e3 * wish.delay:g} ms, least and most over {missed[0].size} poses',
                      figures=('payload\n[g]', 'first mode\n[Hz]', 'position gain\n[1/s]',
                               'damping\nratio', 'with fixed\ngains', 'holds up to\n[ms]'))
    for payload, *values in rows:
        values[-1] = 1e3 * values[-1]
        table.add_row(f'{1e3 * payload:g}', *(
            f'{part.min():.2f} .. {part.max():.2f}' for part in values))
    print_table(table)
    say(f'{out}: schedule; {picture}: drawn')
    if missed.any():
        say(f'the damping ratio is missed by more than {100 * MISSED:g} % in {missed.sum()} of '
            f'{missed.size} nodes, where {reached[missed].min():.2f} is the least that can be '
            'had: ask for less, or shorten the delay of the loop')
    return int(missed.any())
