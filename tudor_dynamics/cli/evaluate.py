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

"""``tudor evaluate``: compare a saved model with bags."""

from __future__ import annotations

import argparse
from typing import Any

from tudor_dynamics.arm import load_arm
from tudor_dynamics.cli.console import finite, print_json, print_table, score_table, steps
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.bundling import rounded
from tudor_dynamics.identification.dataset import common_outputs, load, parse_choice
from tudor_dynamics.identification.validation import validate, Validation
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.models.units import output_units

EXAMPLES = """\
examples:
  tudor evaluate --model model run4
  tudor evaluate --model model run4 run5 --json
  tudor evaluate --model model run1@60-100%

The filters and the rate are those that the model was fitted with.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor evaluate``."""
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bag directory or file, or a part of it: BAG@60-100%%')
    parser.add_argument('--model', required=True, metavar='MODEL', help='bundle of tudor fit')
    parser.add_argument('--arm', metavar='YAML',
                        help='refuse the model if it is not of this arm (it carries its own)')
    parser.add_argument('--json', action='store_true', help='print the figures as JSON')


def run(args: argparse.Namespace) -> int:
    """Read, predict, compare."""
    arm = load_arm(args.arm) if args.arm else None
    bundle = load_bundle(args.model, arm=arm)
    choices = [parse_choice(text) for text in args.bags]
    with steps(len(choices) + 1) as step:
        data = []
        for choice in choices:
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, bundle.preprocessing))
        step('compare')
        outputs = [output for output in common_outputs(data) if output in bundle.models]
        if not outputs:
            msg = (f'the model predicts {" and ".join(bundle.models)}, which not all of '
                   f'{", ".join(args.bags)} have: evaluate them apart, or use other bags')
            raise UsageError(msg)
        found: dict[str, dict[str, Validation]] = {
            output: {kind: validate(model, data, output, ', '.join(map(str, choices)))
                     for kind, model in bundle.models[output].items()}
            for output in outputs}
    if args.json:
        content: dict[str, Any] = {'model': args.model, 'bags': [str(c) for c in choices],
                                   'samples': sum(bag.samples for bag in data)}
        for output, kinds in found.items():
            content[output] = {kind: _figures(item) for kind, item in kinds.items()}
        print_json(finite(content))
        return 0
    rows = [(output, kind, item.score, output_units(bundle.arm, output))
            for output, kinds in found.items() for kind, item in kinds.items()]
    print_table(score_table(f'{args.model} on {", ".join(map(str, choices))}', rows))
    return 0


def _figures(item: Validation) -> dict[str, Any]:
    content = rounded(item.score, digits=9)
    del content['samples']
    return content
