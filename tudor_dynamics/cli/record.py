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

"""``tudor record``: let the simulated arm move, and record what it measures."""

from __future__ import annotations

import argparse
from pathlib import Path
import shutil
import time

from tudor_dynamics.arm.description import Arm, load_arm, refuse_interfaces
from tudor_dynamics.bags.storage import METADATA
from tudor_dynamics.cli.console import (
    add_out, add_running, bar, check_running, new_table, print_json, print_table, say)
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target, write_whole
from tudor_dynamics.identification.excitation_plan import read_motion
from tudor_dynamics.mechanics.campaign import (
    played_motion, random_loads, record_stimuli, stimulus_seeds,
    StimulusResult, StimulusSpec)
from tudor_dynamics.mechanics.closed_loop import ClosedLoop, steps_per_message
from tudor_dynamics.mechanics.hardware import Imperfections, with_payload
from tudor_dynamics.parallel import on_cluster
import yaml

EXAMPLES = """\
examples:
  tudor record --arm config/tudor.yaml --payload 0.2 --out recordings/200g
        ten stimuli of 80 s with 200 g at the tip, the links damped
  tudor record --arm config/tudor.yaml --no-damping --pushes 5 --out pushed
        without the damper, with five pushes a stimulus on links, their truth in /applied_wrench
  tudor record --arm config/tudor.yaml --trajectory plan --out planned
        the motion that `tudor excite config/tudor.yaml --floor 0 --out plan` found
  tudor record --arm config/tudor.yaml --ideal friction backlash --out smooth
        drives without friction and backlash

OUT/campaign.yaml says what was recorded. The same seed gives the same bags, byte by byte.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor record``."""
    parser.add_argument('--arm', required=True, metavar='YAML',
                        help='arm description with links, motors and damper')
    add_out(parser, 'DIR', 'directory for the bags, stimulus_01 and so on')
    parser.add_argument('--payload', type=float, default=0.0, metavar='KG',
                        help='mass at the tip (default: 0)')
    parser.add_argument('--stimuli', type=int, default=10, metavar='N',
                        help='number of bags (default: 10)')
    parser.add_argument('--seconds', type=float, default=80.0, metavar='S',
                        help='length of each (default: 80)')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ',
                        help='of the messages (default: 100)')
    parser.add_argument('--no-damping', action='store_true', help='leave the damper out')
    parser.add_argument('--pushes', type=int, default=0, metavar='N',
                        help='pushes on links in each stimulus (default: 0)')
    parser.add_argument('--held', action='store_true',
                        help='let every second push last for seconds')
    parser.add_argument('--loads', type=int, default=0, metavar='N',
                        help='loads of 100 to 400 g that are picked up and put down in each '
                             'stimulus; what is carried is in /applied_payload (default: 0)')
    parser.add_argument('--trajectory', metavar='PLAN',
                        help='motion to be played in each stimulus, with noise of its own: folder '
                             'of tudor excite, or CSV; in place of --seconds')
    parser.add_argument('--ideal', nargs='+', default=[], metavar='WHAT',
                        choices=(*Imperfections.names(), 'all'),
                        help=f'leave imperfections out: {", ".join(Imperfections.names())} '
                             'or all')
    parser.add_argument('--seed', type=int, default=0, metavar='N',
                        help='of motions, noise and pushes (default: 0)')
    add_running(parser)


def _specs(args: argparse.Namespace, arm: Arm, dt: float) -> list[StimulusSpec]:
    trajectory = None
    ideal = Imperfections.names() if 'all' in args.ideal else args.ideal
    if args.trajectory is not None:
        trajectory = read_motion(Path(args.trajectory))
        args.seconds = round(len(played_motion(arm, trajectory, dt).q) * dt, 6)
    seeds = (stimulus_seeds(args.seed, number) for number in range(args.stimuli))
    return [StimulusSpec(
        args.payload, args.seconds, args.rate, 0.0 if args.no_damping else 1.0,
        motion, noise, push, args.pushes, Imperfections(**dict.fromkeys(ideal, False)),
        random_loads(args.loads, args.seconds, args.payload, push), args.held, trajectory)
        for motion, noise, push in seeds]


def run(args: argparse.Namespace) -> int:
    """Simulate and record."""
    begun = time.perf_counter()
    check_running(args)
    if not 1 <= args.stimuli <= 100_000:
        raise UsageError(f'--stimuli {args.stimuli}: give 1 to 100000')
    if min(args.pushes, args.loads, args.seed) < 0:
        raise UsageError(f'--pushes {args.pushes} --loads {args.loads} --seed {args.seed}: none '
                         'can be negative')
    if not 2.0 < args.seconds <= 3600.0:
        raise UsageError(f'--seconds {args.seconds}: give more than 2 and at most 3600 s')
    arm = load_arm(args.arm)
    refuse_interfaces(arm, 'a bag that is written here')
    out = Path(args.out)
    paths = [out / f'stimulus_{number + 1:02d}' for number in range(args.stimuli)]
    check_target(out / 'campaign.yaml', overwrite=args.overwrite)
    others = {*out.glob('stimulus_[0-9]*')} - {*paths}  # more than now, of another campaign
    for path in (*paths, *others):
        check_target(path, overwrite=args.overwrite, mark=METADATA)
    # Whatever is wrong with arm or options shows here, and compiled code is ready for all.
    loop = ClosedLoop(with_payload(arm, args.payload), damping=0.0 if args.no_damping else 1.0)
    steps_per_message(loop.dt, args.rate)
    loop.step([0.0] * len(arm.active_joints), [0.0] * len(arm.active_joints))
    specs = _specs(args, arm, loop.dt)
    total = args.stimuli * int(round(args.seconds / loop.dt))
    with bar(total, 'simulate') as advance, on_cluster(args.cluster):
        results = record_stimuli(args.arm, specs, paths, args.jobs,
                                 lambda done: advance(completed=done),
                                 overwrite=args.overwrite)
    for path in others:
        shutil.rmtree(path, ignore_errors=True)
    _write_campaign(out / 'campaign.yaml', args, arm, specs, results)
    seconds = time.perf_counter() - begun
    if args.json:
        print_json({'out': str(out), 'seconds': round(seconds, 2),
                    'bags': [item.content() for item in results]})
    else:
        _print(results, out, seconds)
    return 0


def _write_campaign(
    path: Path, args: argparse.Namespace, arm: Arm, specs: list[StimulusSpec],
    results: list[StimulusResult],
) -> None:
    """Write what was recorded, without times or paths: the same seed, the same file."""
    content = {
        'arm': arm.name, 'digest': arm.digest, 'payload': args.payload, 'seed': args.seed,
        'seconds': args.seconds, 'rate': args.rate, 'damping': not args.no_damping,
        'excitation': 'aprbs' if args.trajectory is None else 'trajectory',
        'ideal': sorted(args.ideal),
        'stimuli': [{**result.content(), 'bag': Path(result.bag).name,
                     'motion_seed': spec.motion_seed}
                    for spec, result in zip(specs, results, strict=True)]}
    write_whole(path, yaml.safe_dump(content, sort_keys=False).encode())


def _print(results: list[StimulusResult], out: Path, seconds: float) -> None:
    table = new_table(f'recorded into {out} in {seconds:.1f} s', names=('bag',),
                      figures=('samples', 'pushes'))
    for result in results:
        table.add_row(Path(result.bag).name, str(result.samples), str(len(result.pushes)))
    print_table(table)
    for result in results:
        for note in result.notes:
            say(f'{Path(result.bag).name}: {note}')
