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

"""``tudor payload``: what the arm carries, from a bag and a model."""

from __future__ import annotations

import argparse
from pathlib import Path

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.cli.console import (
    add_bags_and_model, new_table, print_json, print_table, say, say_verdict, steps)
from tudor_dynamics.identification.dataset import BagData, load, parse_choice, parse_payloads
from tudor_dynamics.identification.loads import payload_of, telling
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.load.offline import PayloadEstimate, Presence
from tudor_dynamics.models.bundle import load_bundle

EXAMPLES = """\
examples:
  tudor payload run5 --model model
  tudor payload run5 run6@20s-60s --model model --json
  tudor payload run5 --model model --payload-of run5=0.3

Each bag has one estimate: mass, centre and, where the motion shows it, inertia, each with its
standard deviation. Kilograms come from a model of two known payloads (tudor fit --payload-of),
from torques or torque constants, from the gains of gauges (sensors of the description) or from
the masses of the URDF; without any of them the load is a part of the arm's own moment. With
--payload-of the estimates are compared with what is known. `tudor watch` follows a load over time.
exit codes: 0 each bag shows whether there is a load; 1 a bag has no information, or the truth is
more than three standard deviations away; 2 wrong input.
"""
FAR = 3.0  # standard deviations from which on an estimate is wrong


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor payload``."""
    add_bags_and_model(parser)
    parser.add_argument('--kind', choices=('analytical', 'elastic'),
                        help='kind of model that gives the load (analytical, where there is one)')
    parser.add_argument('--payload-of', nargs='+', default=[], metavar='BAG=KG',
                        help='true mass in a bag, to compare with')


def run(args: argparse.Namespace) -> int:
    """Read, estimate, print."""
    bundle = load_bundle(args.model, arm=load_arm(args.arm) if args.arm else None)
    telling(bundle, args.kind)  # says so if there is none
    choices = [parse_choice(text) for text in args.bags]
    truths = parse_payloads(args.payload_of, choices)
    bags: list[BagData] = []
    with steps(len(choices)) as step:
        for choice in choices:
            step(f'read {choice}')
            bags.append(load(choice, bundle.arm, bundle.preprocessing))
    found = [payload_of(bundle, [bag], args.kind) for bag in bags]
    known = [truths.get(str(Path(bag.choice.path).resolve())) for bag in bags]
    if args.json:
        print_json({'model': args.model, 'bags': {
            str(bag.choice): {**item.as_dict(), **({} if mass is None else {'true_mass': mass})}
            for bag, item, mass in zip(bags, found, known, strict=True)}})
    else:
        for bag, item, mass in zip(bags, found, known, strict=True):
            say_verdict(Grade.DO_NOT_USE if _doubtful(item, mass) else Grade.GOOD, item.sentence,
                        of=f'{bag.choice}: ')
            if item.known:
                say(f'  {item.known:g} kg of it are in the model')
            if mass is not None:
                say(f'  known: {mass:g} kg, error {item.mass - mass:+.4g} kg')
        table = new_table('residual without the load and with it', names=('bag', 'output'),
                          figures=('without %', 'with %'))
        for bag, item in zip(bags, found, strict=True):
            for one in item.outputs:
                table.add_row(str(bag.choice), one.output, f'{100 * one.before:.1f}',
                              f'{100 * one.after:.1f}')
        print_table(table)
    return int(any(map(_doubtful, found, known)))


def _doubtful(item: PayloadEstimate, mass: float | None) -> bool:
    """Say whether a bag has no information, or the truth is elsewhere."""
    return item.verdict is Presence.UNKNOWN or (
        mass is not None and not abs(item.mass - mass) <= FAR * item.mass_std)
