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
from collections.abc import Sequence
import io
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm import load_arm, PreprocessingSpec
from tudor_dynamics.cli.collisions.options import configure_collisions
from tudor_dynamics.cli.console import (
    finite, new_table, print_findings, print_json, print_table, score_table, steps)
from tudor_dynamics.doctor.evaluation import Evaluated, examine_evaluation
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import write_whole
from tudor_dynamics.identification.bag_choice import parse_choice
from tudor_dynamics.identification.dataset import load
from tudor_dynamics.identification.metrics import rounded
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.identification.worth.comparison import Change, changes
from tudor_dynamics.library.prediction import predict_bags, warn_of_training
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.storage.bundle_io import load_bundle
from tudor_dynamics.models.units import output_units

EXAMPLES = """\
examples:
  tudor evaluate --model model run4
  tudor evaluate --model model run4 run5 --json
  tudor evaluate --model model run1@60-100%
  tudor evaluate --model model run4 --rate full --save run4.npz
  tudor evaluate --model model pushes free --collisions --roc roc.svg

The filters and the rate are those that the model was fitted with. --collisions replays the bags
through the collision detector; pushes are read from /applied_wrench, a topic or a table.

The figures are compared with those of the validation. A channel is no longer what it was where
its error has grown by 30 % and its relative error by 15 %, and the error by more than three of its
standard errors (of mean squares over 5 s, then and now). exit codes: 0 as it was, or nothing
to compare with (another --rate, an older model); 1 no longer what it was; 2 wrong input. An ELM
beside other models does not count.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor evaluate``."""
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bag directory or file, or a part of it: BAG@60-100%%')
    parser.add_argument('--model', required=True, metavar='MODEL', help='bundle of tudor fit')
    parser.add_argument('--arm', metavar='YAML',
                        help='refuse the model if it is not of this arm (it carries its own)')
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip, for a model of all payloads; by default what each '
                             "bag's metadata say")
    parser.add_argument('--rate', metavar='HZ',
                        help='another rate than that of the fit; "full" for every sample')
    parser.add_argument('--causal', action='store_true',
                        help='judge the models as they run beside the robot: with causal filters, '
                             'standstill at the ends included')
    parser.add_argument('--save', metavar='FILE.npz',
                        help='write stamps, measured, predicted and residual values')
    parser.add_argument('--report', metavar='FILE.html',
                        help='write a page: figures, findings, and a load that is found')
    parser.add_argument('--json', action='store_true', help='print the figures as JSON')
    configure_collisions(parser.add_argument_group('collisions'))


def run(args: argparse.Namespace) -> int:
    """Read, predict, compare."""
    arm = load_arm(args.arm) if args.arm else None
    bundle = load_bundle(args.model, arm=arm)
    if args.causal:
        bundle = bundle.beside_robot()
    if args.payload is not None:
        bundle.at(args.payload)  # says so if it is no use
    choices = [parse_choice(text) for text in args.bags]
    if args.collisions:
        from tudor_dynamics.cli.collisions.judging import run_collisions  # slow to import
        return run_collisions(args)
    spec = chosen_rate(bundle.preprocessing, args.rate)
    with steps(len(choices) + 1) as step:
        data = []
        for choice in choices:
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, spec, payload=args.payload, whole=args.causal))
        step('compare')
        found = predict_bags(bundle, data).outputs
    seen = warn_of_training(bundle, data)
    evaluated = examine_evaluation(bundle, data)
    findings = evaluated.findings
    compared = () if args.rate else changes(bundle.facts, found)
    worse = [change for change in compared if change.changed and _counts(change, compared)]
    if args.save:
        save_traces(Path(args.save), found)
    if args.report:
        from tudor_dynamics.report.evaluation import evaluation_page  # slow to import
        write(args.report, '--report', evaluation_page(
            bundle, [str(c) for c in choices], found, evaluated, worse).encode())
    if args.json:
        content: dict[str, Any] = {'model': args.model, 'bags': [str(c) for c in choices],
                                   'samples': sum(bag.samples for bag in data),
                                   **({'trained_on': seen} if seen else {}),
                                   'findings': [item.as_dict() for item in findings],
                                   'loads': {bag: told.as_dict()
                                             for bag, told in evaluated.loads.items()}}
        for output, kinds in found.items():
            content[output] = {kind: _figures(item) for kind, item in kinds.items()}
        comparison: dict[str, Any] = {}
        for change in compared:
            comparison.setdefault(change.output, {}).setdefault(change.kind, {})[
                change.channel] = change.as_dict()
        print_json(finite({**content, 'as_it_was': None if not compared else not worse,
                           'comparison': comparison}))
        return 1 if worse else 0
    rows = [(output, kind, item.score, output_units(bundle.arm, output))
            for output, kinds in found.items() for kind, item in kinds.items()]
    print_table(score_table(f'{args.model} on {", ".join(map(str, choices))}', rows))
    for change in worse:
        print(change)
    if compared and not worse:
        print('the model is what it was in its validation: no channel is worse by more than '
              'chance')
    print_findings(findings)
    _print_loads(evaluated, bundle)
    if worse and not findings:
        print('the doctor finds no cause in these bags: temperature and wear of the drives change '
              'friction; fit again with these bags')
    return 1 if worse else 0


def _print_loads(evaluated: Evaluated, bundle: ModelBundle) -> None:
    if not evaluated.loads:
        return
    from tudor_dynamics.report.load import load_shares, load_values  # slow to import
    for bag, told in evaluated.loads.items():
        table = new_table(f'load in {bag}', ('what',), ('value', 'std. deviation'))
        for row in load_values(told):
            table.add_row(f'{row.name} [{row.unit}]', f'{row.value:.4g}', f'{row.std:.2g}')
        print_table(table)
        table = new_table('residual', ('channel',), ('without', 'with it', 'explained [%]'))
        for one in load_shares(bundle.arm, told):
            table.add_row(f'{one.channel} [{one.unit}]', f'{one.before:.3g}', f'{one.after:.3g}',
                          f'{one.share:.0f}')
        print_table(table)


def _counts(change: Change, compared: Sequence[Change]) -> bool:
    """Say whether a change decides: an ELM does where it is all that there is."""
    return change.kind != 'elm' or all(other.kind == 'elm' for other in compared)


def chosen_rate(spec: PreprocessingSpec, rate: str | None) -> PreprocessingSpec:
    """Give the preprocessing with another rate, where one is asked for."""
    if rate is None:
        return spec
    try:
        value = None if rate == 'full' else float(rate)
    except ValueError:
        value = -1.0
    if value is not None and not 0 < value < float('inf'):
        msg = f'--rate {rate}: expected a rate above 0 Hz, or "full"'
        raise UsageError(msg)
    return spec.model_copy(update={'rate': value})


def save_traces(path: Path, found: dict[str, dict[str, Validation]]) -> None:
    """Write every sample that was compared, whole or not at all."""
    arrays: dict[str, Any] = {}
    for output, kinds in found.items():
        for kind, item in kinds.items():
            def joined(name: str, traces: Any = item.traces) -> Any:
                return np.concatenate([getattr(trace, name) for trace in traces])
            measured, predicted = joined('measured'), joined('predicted')
            arrays[f'{output}_channels'] = np.array(item.channels)
            arrays[f'{output}_{kind}_bag'] = np.repeat(
                [trace.bag for trace in item.traces], [len(trace.t) for trace in item.traces])
            arrays[f'{output}_{kind}_stamp'] = joined('stamp')
            arrays[f'{output}_{kind}_measured'] = measured
            arrays[f'{output}_{kind}_predicted'] = predicted
            arrays[f'{output}_{kind}_residual'] = measured - predicted
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write(path, '--save', buffer.getvalue())


def write(path: str | Path, option: str, content: bytes) -> None:
    """Write a file that was asked for, whole or not at all."""
    try:
        write_whole(Path(path), content)
    except OSError as err:
        msg = f'{option} {path}: cannot be written ({err.strerror}); give another file'
        raise UsageError(msg) from None


def _figures(item: Validation) -> dict[str, Any]:
    content = rounded(item.score, digits=9)
    del content['samples']
    return content
