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
import io
from pathlib import Path
from typing import Any

import numpy as np

from tudor_dynamics.arm import load_arm, PreprocessingSpec
from tudor_dynamics.bags.plan import plan_from_arm
from tudor_dynamics.cli.collision_figures import collision_values, print_collisions
from tudor_dynamics.cli.console import (
    finite, print_findings, print_json, print_table, score_table, steps)
from tudor_dynamics.doctor.evaluation import examine_evaluation
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import write_whole
from tudor_dynamics.identification.bundling import rounded
from tudor_dynamics.identification.collision_truth import (
    find_truth, FREE, table_of_pushes, Truth, truth_of_table)
from tudor_dynamics.identification.collisions import evaluate_collisions
from tudor_dynamics.identification.dataset import BagData, load, parse_choice
from tudor_dynamics.identification.validation import Validation
from tudor_dynamics.library.prediction import predict_bags, warn_of_training
from tudor_dynamics.models.bundle import load_bundle, ModelBundle
from tudor_dynamics.models.kinds import KINDS
from tudor_dynamics.models.units import output_units
from tudor_dynamics.monitoring.detector import DetectorSettings
from tudor_dynamics.monitoring.thresholds.excess import Rates
from tudor_dynamics.monitoring.watch import MonitorSettings
from tudor_dynamics.report.roc import picture_path, write_roc

EXAMPLES = """\
examples:
  tudor evaluate --model model run4
  tudor evaluate --model model run4 run5 --json
  tudor evaluate --model model run1@60-100%
  tudor evaluate --model model run4 --rate full --save run4.npz
  tudor evaluate --model model pushes free --collisions --roc roc.svg

The filters and the rate are those that the model was fitted with. --collisions replays the bags
through the collision detector; pushes are read from /applied_wrench.
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
    parser.add_argument('--json', action='store_true', help='print the figures as JSON')
    group = parser.add_argument_group('collisions')
    group.add_argument('--collisions', action='store_true',
                       help='judge the collision detector instead of the predictions')
    group.add_argument('--false-alarms', type=float, default=1.0, metavar='N',
                       help='false alarms per hour that are allowed (default: 1)')
    group.add_argument('--debounce', type=float, default=0.01, metavar='S',
                       help='time for which a threshold must be exceeded (default: 0.01 s)')
    group.add_argument('--kind', choices=tuple(KINDS), default='analytical',
                       help='model whose residuals are watched (default: analytical)')
    group.add_argument('--pushes', nargs='+', default=[], metavar='FILE.csv',
                       help='tables of begin,end in seconds since the beginning of the bag, one '
                            'for each bag')
    group.add_argument('--truth', metavar='TOPIC',
                       help='WrenchStamped or Bool that tells when the arm was touched (default: '
                            'applied_wrench, where there is one)')
    group.add_argument('--free', action='store_true',
                       help='nothing touched the arm: every event is a false alarm')
    group.add_argument('--roc', metavar='FILE',
                       help='plot detection rate over false alarms (.png, .svg, .pdf)')


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
        return _collisions(args)
    spec = chosen_rate(bundle.preprocessing, args.rate)
    with steps(len(choices) + 1) as step:
        data = []
        for choice in choices:
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, spec, payload=args.payload, whole=args.causal))
        step('compare')
        found = predict_bags(bundle, data).outputs
    seen = _seen(bundle, data)
    findings = examine_evaluation(bundle, data)
    if args.save:
        save_traces(Path(args.save), found)
    if args.json:
        content: dict[str, Any] = {'model': args.model, 'bags': [str(c) for c in choices],
                                   'samples': sum(bag.samples for bag in data), **seen,
                                   'findings': [item.as_dict() for item in findings]}
        for output, kinds in found.items():
            content[output] = {kind: _figures(item) for kind, item in kinds.items()}
        print_json(finite(content))
        return 0
    rows = [(output, kind, item.score, output_units(bundle.arm, output))
            for output, kinds in found.items() for kind, item in kinds.items()]
    print_table(score_table(f'{args.model} on {", ".join(map(str, choices))}', rows))
    print_findings(findings)
    return 0


def _seen(bundle: ModelBundle, data: list[BagData]) -> dict[str, list[str]]:
    """Warn of bags that the model was trained on, and give them for the JSON, if there are any."""
    seen = warn_of_training(bundle, data)
    return {'trained_on': seen} if seen else {}


def _collisions(args: argparse.Namespace) -> int:
    if not args.false_alarms > 0 or not args.debounce >= 0:
        msg = (f'--false-alarms {args.false_alarms:g} --debounce {args.debounce:g}: expected a '
               'rate above 0 per hour and a time of 0 s or more')
        raise UsageError(msg)
    if sum((bool(args.pushes), bool(args.truth), args.free)) > 1:
        msg = '--pushes, --truth and --free exclude each other; give one of them'
        raise UsageError(msg)
    if args.pushes and len(args.pushes) != len(args.bags):
        msg = (f'--pushes: {len(args.pushes)} tables for {len(args.bags)} bags; give one for '
               'each, in their order')
        raise UsageError(msg)
    plot = picture_path(args.roc) if args.roc else None
    bundle = at_payload(load_bundle(args.model), args.payload)
    kinds = sorted({kind for models in bundle.models.values() for kind in models})
    if args.kind not in kinds:
        msg = (f'{args.model} has no {args.kind} model; it has {" and ".join(kinds)}: give '
               f'--kind, or fit it again with --models {args.kind}')
        raise UsageError(msg)
    choices = [parse_choice(text) for text in args.bags]
    settings = MonitorSettings(
        args.kind, rates=Rates(args.false_alarms, 60.0 * args.false_alarms),
        detector=DetectorSettings(debounce=args.debounce))
    with steps(len(choices) + 1) as step:
        data, truths = [], []
        for place, choice in enumerate(choices):
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, bundle.preprocessing))
            truths.append(_truth(args, place, data[-1], bundle))
        seen = _seen(bundle, data)
        step('replay through the detector')
        results = evaluate_collisions(
            bundle, [(bag.choice.path, bag.recording) for bag in data], settings, truths)
    if plot is not None:
        if not any(truth.known for truth in truths):
            msg = '--roc needs to know the pushes; give --pushes FILE.csv, --truth TOPIC or --free'
            raise UsageError(msg)
        write_roc(results, plot)
    if args.json:
        print_json(finite({'model': args.model, 'bags': [str(c) for c in choices],
                           **seen, 'false_alarms_allowed_per_hour': args.false_alarms,
                           'collisions': {item.method: collision_values(item)
                                          for item in results}}))
    else:
        print_collisions(results, args.false_alarms)
        if plot is not None:
            print(f'plot: {plot}')
    return 0


def _truth(args: argparse.Namespace, place: int, bag: BagData, bundle: ModelBundle) -> Truth:
    """Find out what is known of the pushes of one bag."""
    if args.free:
        return FREE
    if not args.pushes:
        return find_truth(bag.choice.path, args.truth, plan_from_arm(bundle.arm).joint_topic)
    begun, _ = bag.choice.span(bag.choice.duration or 0.0)
    return truth_of_table(table_of_pushes(args.pushes[place]), bag.recording, args.pushes[place],
                          begun)


def at_payload(bundle: ModelBundle, payload: float | None) -> ModelBundle:
    """Put the payload of the command line into a model, which may need one."""
    if payload is None and bundle.payload_range is not None:
        msg = 'the model is one of all payloads: say with --payload KG what the arm carries'
        raise UsageError(msg)
    return bundle.at(payload or 0.0)


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
    """
    Write every sample that was compared, whole or not at all.

    Parameters
    ----------
    path : Path
        File to write. Arrays are named ``OUTPUT_KIND_WHAT``, WHAT being bag, stamp [ns], measured,
        predicted and residual; ``OUTPUT_channels`` names the columns.
    found : dict
        Output to kind to validation.

    """
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
    try:
        write_whole(path, buffer.getvalue())
    except OSError as err:
        msg = f'--save {path}: cannot be written ({err.strerror}); give another file'
        raise UsageError(msg) from None


def _figures(item: Validation) -> dict[str, Any]:
    content = rounded(item.score, digits=9)
    del content['samples']
    return content
