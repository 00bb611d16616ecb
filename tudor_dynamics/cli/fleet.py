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

"""``tudor fleet``: fit many arms of one kind, and compare them."""

from __future__ import annotations

import argparse
from pathlib import Path
import time

from tudor_dynamics.cli.console import (
    add_out, add_running, as_json, check_running, new_table, print_json, print_table, say, steps)
from tudor_dynamics.errors import FitError, UsageError
from tudor_dynamics.files import check_target, write_whole
from tudor_dynamics.fleet.comparison import page_of, WORDS
from tudor_dynamics.fleet.study import load_plan, study, StudySettings
from tudor_dynamics.parallel import on_cluster

EXAMPLES = """\
examples:
  tudor fleet plan.yaml --out fleet
        fit and compare the arms of a plan
  tudor fleet plan.yaml --out fleet --no-models --json
        numbers alone

a plan, whose names are relative to it:
  arm: my_arm.yaml
  arms:
    - name: cell_1
      bags: {2026-01-10: bags/cell_1/january, 2026-02-12: [bags/cell_1/feb_*]}
    - name: cell_2
      bags: {2026-01-11: bags/cell_2/january}

DIR/fleet.html shows friction, weight and ring-downs of each arm over time; fleet.json has the
numbers, models/ a bundle of each arm's last date. A killed command goes on where it was.

exit codes: 0 all arms are alike, 1 one differs from the others, drifts, or its model has aged; 2
wrong input.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor fleet``."""
    parser.add_argument('plan', metavar='PLAN.yaml', help='arms, and their bags by date')
    add_out(parser, 'DIR', 'folder for all results; one of tudor fleet is continued')
    parser.add_argument('--no-models', action='store_true',
                        help='compare alone, without a model of each arm')
    parser.add_argument('--elastic', action='store_true',
                        help='compare stiffnesses of gears and links as well: half a minute for '
                             'the first date of an arm, ten seconds for each other one')
    parser.add_argument('--strict', action='store_true',
                        help='refuse bags that cannot be used, in place of leaving them out')
    add_running(parser)


def run(args: argparse.Namespace) -> int:
    """Read the plan, go through the bags, compare, write."""
    check_running(args)
    path, out = Path(args.plan), Path(args.out)
    plan = load_plan(path)
    if out.exists() and not out.is_dir():
        raise UsageError('this is a file, not a folder', place=out, remedy='give another --out')
    page, numbers = out / 'fleet.html', out / 'fleet.json'
    check_target(page if page.exists() else numbers, overwrite=args.overwrite)  # page comes first
    begun = time.perf_counter()
    known = None if args.elastic else 4 * sum(len(arm.bags) for arm in plan.arms) + 3
    with steps(known) as step, on_cluster(args.cluster):
        fleet = study(plan, StudySettings(path.parent, out, args.jobs, models=not args.no_models,
                                          elastic=args.elastic), step)
    if args.strict and fleet.unused:
        raise FitError(f'a bag cannot be used, but --strict needs all; bag {fleet.unused[0]}',
                       remedy=f'or take this bag out of {path}, or leave out --strict')
    content = fleet.as_dict()
    write_whole(page, page_of(fleet).encode())
    write_whole(numbers, as_json(content).encode())
    if args.json:
        print_json({**content, 'seconds': round(time.perf_counter() - begun, 3)})
        return 1 if fleet.named else 0
    table = new_table(f'{fleet.name}: {len(fleet.arms)} arms', names=('arm', 'why', 'what'),
                      figures=('value', 'expected', 'standard errors'))
    for item in fleet.named:
        table.add_row(item.arm, WORDS[item.kind], item.what, f'{item.value:.3g} {item.unit}',
                      f'{item.expected:.3g} {item.unit}', f'{item.sigmas:+.1f}')
    if fleet.named:
        print_table(table)
    else:
        say(f'{fleet.name}: {len(fleet.arms)} arms, alike and unchanged as far as these bags show')
    say(*(f'chosen for all: {choice}' for choice in fleet.choices),
        *(f'left out: {bag}' for bag in fleet.unused), f'page: {out / "fleet.html"}')
    return 1 if fleet.named else 0
