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

"""``tudor excite``: plan the motion to record, and say what it will show."""

from __future__ import annotations

import argparse
from dataclasses import replace
import math
from pathlib import Path
import time

import numpy as np

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.limits import RADIUS, SelfCollision, walls_of
from tudor_dynamics.cli.console import (
    add_out, bar, new_table, print_json, print_table, say)
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target, whole
from tudor_dynamics.identification.excitation import CLEARANCE, ExpectedError, mean_error
from tudor_dynamics.identification.excitation_plan import (
    default_highest, HEAD, make_moves, make_plan, MOVE, Order, PICTURE, Plan, plan_head,
    random_series, REST, STAGES, Target, target_of_arm, target_of_model, UNKNOWN, write_plan)
from tudor_dynamics.identification.next_steps import Comparison, Promise
from tudor_dynamics.identification.tool import check_efforts
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.signals.motion_profile import joint_range, motion_limits
from tudor_dynamics.typing import FloatArray


# -- What a plan promised and what a fit reached, as a table

def print_comparison(comparison: Comparison) -> None:
    """Print standard errors expected and reached."""
    table = new_table(
        f'standard errors, expected by the plan and reached ({comparison.runs:.2g} runs of it)',
        names=('parameter', 'unit'),
        figures=('expected', 'by the noise\nthat was found', 'reached', 'reached /\nexpected'))
    for item in comparison.promises:
        table.add_row(_shown(item), item.unit, *(
            f'{value:.2g}' if math.isfinite(value) else '-' for value in (
                item.expected, item.by_noise, item.reached, item.reached / item.expected)))
    print_table(table)
    ratios = comparison.ratios()
    if not ratios:
        return
    for key, words in (('expected', 'the plan'), ('by_noise', 'the plan with the noise found')):
        if key == 'expected' and not comparison.stated:
            say('no noise was stated in the plan: its own column is for a noise of 1')
            continue
        say(f'reached over {words}: median {ratios[f"median_over_{key}"]:.2f}, '
            f'{100 * ratios[f"within_30_percent_of_{key}"]:.0f} % of the parameters within 30 %')


# -- ``tudor excite``: plan the motion to record, and say what it will show

EXAMPLES = """\
examples:
  tudor excite my_arm.yaml --floor 0 --out plan
        one minute of motion above the table that the arm stands on; standard errors are for a
        noise of 1 in each channel
  tudor excite my_arm.yaml --floor 0 --out plan --noise 0.4
        the same for efforts whose samples have a noise of 0.4
  tudor excite arm.yaml --floor 0 --out plan --noise 0.4 --noise-of wrist=0.1
        other noise for single joints and gauges, in their units
  tudor excite my_arm.yaml --floor 0 --out plan --model MODEL
        noise, friction and filters of an earlier fit, and efforts by its model
  tudor excite my_arm.yaml --floor 0 --out plan --for vibration
        moves with rests, of which tudor fit RUN --models analytical vibration learns how a tool
        rings; with --model, at the frequency of the tool that it has
  tudor excite arm.yaml --box -0.9 0.9 -0.9 0.9 0 1.5 --out plan --srdf a.srdf \\
      --meshes my_workspace/src

PLAN has the motion as a bag (trajectory_msgs/JointTrajectory), as CSV and as a picture, and what
it will show in plan.json. Then move the robot and record: tudor fit RUN --plan PLAN says what was
reached. `tudor record --trajectory PLAN` plays it in simulation.
"""

RANDOM = 3  # random motions that the planned one is compared with


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor excite``."""
    parser.add_argument('arm', metavar='ARM', help='arm description with limits')
    add_out(parser, 'FOLDER', 'folder to be made')
    parser.add_argument('--for', choices=('rigid', 'vibration'), default='rigid', dest='purpose',
                        help='show masses and friction by a Fourier series, or a flexible tool by '
                             'moves with rests (default: rigid)')
    parser.add_argument('--seconds', type=float, default=60.0, metavar='S',
                        help='length, with a second of rest at both ends (default: 60)')
    parser.add_argument('--rate', type=float, default=100.0, metavar='HZ',
                        help='of the points, and of the recording to be (default: 100)')
    parser.add_argument('--highest', type=float, metavar='HZ',
                        help='largest frequency of the Fourier series (default: 2, and at most a '
                             'third of the first eigenfrequency of links that bend)')
    noise = parser.add_argument_group('noise')
    noise.add_argument('--noise', type=float, metavar='SIZE',
                       help='standard deviation of the samples of efforts, in their unit')
    noise.add_argument('--noise-of', nargs='+', default=[], metavar='NAME=SIZE', action='extend',
                       help='the same of single joints or gauges')
    noise.add_argument('--model', metavar='MODEL',
                       help='model of this arm, whose residuals say it; also what friction is '
                            'fitted after which filters, and how large efforts will be')
    links = parser.add_argument_group('what the arm keeps away from (--floor or --box is needed)')
    links.add_argument('--floor', type=float, metavar='Z',
                       help='height of the floor or table above the base [m]: 0 where the arm '
                            'stands on it')
    links.add_argument('--box', type=float, nargs=6, metavar='M',
                       help='walls: x x y y z z in the base frame [m], the smaller one first')
    links.add_argument('--radius', type=float, default=RADIUS, metavar='M',
                       help=f'of links whose shapes are not known ({RADIUS:g})')
    links.add_argument('--srdf', metavar='FILE', help='pairs of links that need no look')
    links.add_argument('--meshes', nargs='+', default=[], metavar='DIR', action='extend',
                       help='where packages with meshes are')
    search = parser.add_argument_group('search')
    search.add_argument('--steps', type=int, default=60, metavar='N',
                        help='steps of each of three stages, or draws of each move (60)')
    search.add_argument('--budget', type=float, metavar='S',
                        help='end the search after this time, with the best so far')
    search.add_argument('--seed', type=int, default=0, metavar='N',
                        help='of where the search begins (default: 0)')


def _check(args: argparse.Namespace) -> None:
    for name, least, most, unit in (
            ('seconds', 10.0, 3600.0, ' s'), ('rate', 10.0, 10_000.0, ' Hz'),
            ('highest', 1e-3, 50.0, ' Hz'), ('steps', 1, 10**6, ''), ('seed', 0, 2**63, ''),
            ('noise', 1e-12, 1e12, ', in the unit of the effort'), ('budget', 0.0, 1e6, ' s'),
            ('radius', 1e-3, 1.0, ' m'), ('floor', -1e3, 1e3, ' m')):
        value = getattr(args, name)
        if value is not None and not least <= value <= most:
            raise UsageError(f'--{name} {value:g}: give {least:g} to {most:g}{unit}')
    if args.model and (args.noise is not None or args.noise_of):
        raise UsageError('the noise comes from --model', remedy='leave out --noise and --noise-of')
    if args.floor is None and args.box is None:
        raise UsageError('no option says where the arm may move',
                         remedy='give --floor Z, the height of the floor above the base [m], or '
                                '--box XMIN XMAX YMIN YMAX ZMIN ZMAX [m]')
    box = args.box or [-1.0, 1.0] * 3
    if not all(-1e3 <= low < high <= 1e3 for low, high in zip(box[::2], box[1::2], strict=True)):
        raise UsageError(f'--box {" ".join(f"{value:g}" for value in box)}: give XMIN XMAX YMIN '
                         'YMAX ZMIN ZMAX, each MIN below its MAX, from -1000 to 1000 m')
    check_target(args.out, overwrite=args.overwrite, mark=HEAD)


def _noise(args: argparse.Namespace, arm: Arm) -> dict[str, FloatArray]:
    """Take the noise of each channel from the command line; 1 where nothing is said."""
    size = {'effort': np.full(len(arm.joints), args.noise or 1.0),
            'strain': np.ones(len(arm.gauges))}
    names = {**{name: ('effort', i) for i, name in enumerate(arm.active_joints)},
             **{name: ('strain', i) for i, name in enumerate(arm.gauge_names)}}
    for text in args.noise_of:
        name, _, value = text.rpartition('=')
        try:
            number = float(value)
        except ValueError:
            number = 0.0
        if name not in names:
            raise UsageError(f'--noise-of {text}: there is no joint or gauge {name!r}; give '
                             f'NAME=SIZE with a NAME of {", ".join(names)}')
        if not 0.0 < number < 1e12:
            raise UsageError(f'--noise-of {text}: give NAME=SIZE, where SIZE is the standard '
                             'deviation of the noise, a number above 0')
        output, place = names[name]
        size[output][place] = number
    return size if arm.gauges else {'effort': size['effort']}


def run(args: argparse.Namespace) -> int:
    """Search, say what is to be expected, write."""
    _check(args)
    arm = load_arm(args.arm)
    rigid, bundle = args.purpose == 'rigid', args.model and load_bundle(args.model, arm=arm)
    if not rigid:
        check_efforts(arm, 'give --for rigid')
    target = target_of_model(bundle, arm) if bundle else target_of_arm(arm, _noise(args, arm))
    frequencies = bundle.tool.frequencies[:1] if bundle and bundle.tool else UNKNOWN
    motion_limits(arm)  # missing ones are named before shapes are read
    links = SelfCollision(arm, tuple(map(Path, args.meshes)),
                          None if args.srdf is None else Path(args.srdf),
                          walls_of(arm, args.floor, args.box), args.radius)
    order = Order(args.seconds, args.highest or default_highest(arm), 1.0 / args.rate, args.steps,
                  args.seed)
    begun, cut = time.perf_counter(), False
    with bar(order.steps * len(STAGES) if rigid else int(args.seconds / (MOVE + REST)),
             'search, ' + ('mean error {task.description}' if rigid else 'move by move')
             ) as advance:
        def over(cost: float) -> bool:
            nonlocal cut
            advance(advance=1, description=f'{np.exp(min(cost, 700.0)):.3g}')
            cut = args.budget is not None and time.perf_counter() - begun >= args.budget
            return cut

        plan = (make_plan(target, order, links=links, report=over) if rigid else
                make_moves(target, order, frequencies, links=links, report=over))
    seconds = time.perf_counter() - begun
    gain = _gain(target, plan, order) if rigid else math.nan
    stated = bool(args.model or args.noise or args.noise_of)
    head = plan_head(plan, arm, {
        'kind': 'fourier' if rigid else 'moves', 'seconds': args.seconds, 'rate': args.rate,
        'highest': order.highest, 'seed': args.seed, 'steps': order.steps, 'complete': not cut,
        'self_collision_pairs': links.pairs, 'hidden': list(plan.hidden),
        'gain_over_random': round(gain, 3) if rigid else None}, stated=stated)
    with whole(Path(args.out), replace=args.overwrite) as folder:
        folder.mkdir()
        write_plan(folder, plan, head)
        from tudor_dynamics.show.pictures import draw_motion, write_picture  # slow to import

        write_picture(
            folder / PICTURE, draw_motion, plan.trajectory, joint_range(arm), motion_limits(arm),
            arm.position_units)
    if args.json:
        print_json({'out': args.out, 'search_seconds': round(seconds, 2), **head})
        return 0
    _print_limits(target, plan, links)
    if cut:
        say(f'the search was ended after {seconds:.0f} s; a longer --budget may find better')
    if rigid:
        _print_errors(target, plan, stated=stated)
        say(f'standard errors are {gain:.2g} times smaller than those of random Fourier series '
            'within the same limits (geometric mean)')
    else:
        say(f'moves: {len(plan.trajectory.t) * order.dt / (MOVE + REST):.0f}, each with a rest of '
            f'{REST:g} s', *(f'not all directions of {name} are pushed' for name in plan.hidden))
    say(f'plan: {args.out} (search: {seconds:.1f} s)')
    return 0


def _gain(target: Target, plan: Plan, order: Order) -> float:
    """Compare with random motions: mean ratio of standard errors to those of the median one."""
    costs = [target.information.value(random_series(
        joint_range(target.arm), motion_limits(target.arm), replace(order, seed=order.seed + k),
    ).motion, mean_error) for k in range(1, RANDOM + 1)]
    return float(np.exp(np.median(costs) - plan.cost))


def _print_limits(target: Target, plan: Plan, links: SelfCollision) -> None:
    table = new_table(f'{target.arm.name}: the motion, in parts of its limits', names=('joint',),
                      figures=('position', 'speed', 'acceleration', 'effort'))
    beyond = plan.beyond
    for j, name in enumerate(target.arm.active_joints):
        table.add_row(name, *(f'{100 * part[j]:.0f} %' for part in (
            beyond.position, beyond.velocity, beyond.acceleration)),
            f'{100 * beyond.effort[j]:.0f} %' if beyond.effort[j] > 0.0 else '-')
    print_table(table)
    if not beyond.effort.any():
        say('efforts are not looked at: no limit of them, or nothing of the bodies, is known')
    say(links.note if not links.pairs else
        f'{links.note}; none comes nearer than {1e3 * min(beyond.clearance, CLEARANCE):.0f} mm')


def _print_errors(target: Target, plan: Plan, *, stated: bool) -> None:
    table = new_table('what one recording of it will show', names=('parameter', 'unit'),
                      figures=('standard error',))
    for item in plan.expected:
        table.add_row(_shown(item), item.unit,
                      f'{item.value:.2g}' if np.isfinite(item.value) else 'not shown')
    print_table(table)
    kind = 'residuals' if plan.noise.residual else 'samples'
    for output, size in plan.noise.size.items():
        units = output_units(target.arm, output)
        say(f'{output}, noise of {kind}: ' + ', '.join(
            f'{name} {value:.3g} {unit}' for (name, unit), value in zip(
              units.items(), size, strict=True)))
    if not stated:
        say('no noise was stated: all standard errors grow with it (--noise, or --model)')


def _shown(item: ExpectedError | Promise) -> str:
    return item.name if item.output == 'effort' else f'{item.channels[0]}: {item.name}'
