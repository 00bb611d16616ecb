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

"""``tudor compare``: what two models, or a model and a description, say of the same arm."""

from __future__ import annotations

import argparse

import numpy as np

from tudor_dynamics.cli.console import new_table, print_json, print_table, say, say_verdict
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import load, parse_choice
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.models.comparison import compare_bodies, errors_on, Side, side_of
from tudor_dynamics.typing import FloatArray

EXAMPLES = """\
examples:
  tudor compare my_arm.yaml MODEL            numbers of the URDF, and identified
  tudor compare my_arm.yaml MODEL run4       ... and how each explains a bag
  tudor compare MODEL_BEFORE MODEL_AFTER run4

A and B are models of tudor fit, or arm descriptions whose URDF has masses. A description has no
friction and no torque constants: it is given those that suit its bodies best on the recordings of
the model beside it. A BAG is explained better by a side whose relative error is more than 5 %
smaller. It needs efforts of one payload; for strains alone see tudor fit --compare.
"""
ALIKE = 1.05  # ratio of errors below which neither side explains a bag better


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor compare``."""
    parser.add_argument('one', metavar='ARM_OR_MODEL_A', help='fitted model, or arm description')
    parser.add_argument('other', metavar='ARM_OR_MODEL_B', help='fitted model, or arm description')
    parser.add_argument('bag', metavar='BAG', nargs='?',
                        help='recording with efforts to judge both by')


def run(args: argparse.Namespace) -> int:
    """Compare bodies, and predictions where there is a bag."""
    one, other = side_of(args.one), side_of(args.other)
    rows = compare_bodies(one, other)
    errors = None if args.bag is None else _errors(one, other, args.bag)
    if args.json:
        print_json({
            'one': one.name, 'other': other.name, 'bodies': [
                {'joint': row.joint, 'mass': row.mass, 'centres_apart': row.apart,
                 'inertia': row.inertia} for row in rows],
            **({} if errors is None else {'relative_error': {
                'one': errors[0].tolist(), 'other': errors[1].tolist()}})})
        return 0
    if errors is None:
        most, joint = max((abs(row.mass[1] - row.mass[0]), row.joint) for row in rows)
        say_verdict(None, f'masses differ by up to {most:.3g} kg ({joint})',
                    ': a BAG shows which of them explain it better')
    else:
        a, b = (100.0 * float(np.sqrt(np.nanmean(side**2))) for side in errors)
        which = 'alike' if max(a, b) < ALIKE * min(a, b) else f'better by {"AB"[b < a]}'
        say_verdict(Grade.GOOD, f'{args.bag} is explained {which}',
                    f': relative error of efforts {a:.3g} % by A, {b:.3g} % by B')
    say(f'A: {one.name}', f'B: {other.name}')
    table = new_table('bodies', names=('joint',), figures=(
        'mass A [kg]', 'B', 'centres apart [mm]', 'inertia A [kg m^2]', 'B'))
    for row in rows:
        table.add_row(row.joint, *(f'{value:.4g}' for value in row.mass),
                      f'{1e3 * row.apart:.1f}', *(f'{value:.4g}' for value in row.inertia))
    print_table(table)
    if errors is not None:
        table = new_table(f'relative error on {args.bag} [%]', names=('joint',),
                          figures=('A', 'B'))
        for joint, before, after in zip(one.arm.active_joints, *errors, strict=True):
            table.add_row(joint, f'{100 * before:.2f}', f'{100 * after:.2f}')
        print_table(table)
    return 0


def _errors(one: Side, other: Side, bag: str) -> tuple[FloatArray, FloatArray]:
    """Judge both, each by its own filters, a description by those of the other side."""
    found = []
    for side, beside in ((one, other), (other, one)):
        measure = side if side.full is not None else beside
        if measure.bundle is None:
            raise UsageError('BAG is compared with a model, but A and B are arm descriptions',
                             remedy='give a model as A or B, or leave BAG out')
        data = load(parse_choice(bag), measure.arm, measure.bundle.preprocessing, learn=True)
        if not data.has('effort'):
            raise UsageError(f'{bag}: has no efforts of the joints of arm {measure.arm.name!r}',
                             remedy='give a BAG with their efforts, or leave BAG out')
        found.append(np.asarray(errors_on(side, measure, data.stretches)))
    return found[0], found[1]
