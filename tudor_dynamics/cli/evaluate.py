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

"""``tudor evaluate``: compare a saved model with bags, and judge its detector."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import shlex
from typing import Any

import numpy as np

from tudor_dynamics.arm.description import load_arm
from tudor_dynamics.arm.schema import PreprocessingSpec
from tudor_dynamics.bags.recording import plan_from_arm
from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.cli.console import (
    add_bags_and_model, add_overwrite, new_table, print_findings, print_json, print_table, say,
    say_command, say_verdict, score_table, steps, write)
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import check_target, dump_npz, provenance
from tudor_dynamics.identification.dataset import BagData, load, parse_choice
from tudor_dynamics.identification.detection import (
    ALL, evaluate_collisions, EVENT_NAMES, event_notes, event_table, find_truth, FREE,
    MethodResult, Truth, truth_of_file, UTC, within)
from tudor_dynamics.identification.doctor.between import examine_evaluation
from tudor_dynamics.identification.next_steps import changes, fit_with, touched
from tudor_dynamics.identification.validation import Grade, rounded, Validation
from tudor_dynamics.library import predict_bags, warn_of_training
from tudor_dynamics.models.bundle import KINDS, load_bundle, ModelBundle
from tudor_dynamics.models.regressor import output_units
from tudor_dynamics.online.black_box import records_of
from tudor_dynamics.online.detector import DetectorSettings, Rates
from tudor_dynamics.online.monitor import MonitorSettings


LONGEST_DEBOUNCE = 60.0  # a push that lasts longer is none [s]
HALF = 0.5  # where less is judged, no stretch may be so long that a fit can use it
TOO_WIDE = 10.0  # times what was promised: where even more would be no surprise, nothing is known


# -- ``tudor evaluate --collisions``: how well the detector finds pushes, and what it finds

def run_collisions(args: argparse.Namespace) -> int:
    """Replay bags through the detector, and judge it by what is known of the pushes."""
    if not args.false_alarms > 0 or not 0 <= args.debounce <= LONGEST_DEBOUNCE:
        raise UsageError(f'--false-alarms {args.false_alarms:g} --debounce {args.debounce:g}: '
                         'expected a rate above 0 per hour and a time of 0 to '
                         f'{LONGEST_DEBOUNCE:g} s')
    if args.pushes and len(args.pushes) != len(args.bags):
        raise UsageError(f'--pushes: {len(args.pushes)} tables for {len(args.bags)} bags; give '
                         'one table for each bag, in the order of the bags')
    bundle = load_bundle(args.model)
    if args.payload is None and bundle.payload_range is not None:
        raise UsageError('the model covers several loads; say with --payload KG what the arm '
                         'carries')
    bundle = bundle.at(args.payload or 0.0)
    kinds = sorted({kind for models in bundle.models.values() for kind in models})
    if args.kind not in kinds:
        raise UsageError(f'{args.model}: the folder has no model of kind {args.kind}; give --kind '
                         f'{" or ".join(kinds)}, or run tudor fit --models '
                         f'{" ".join([*kinds, args.kind])}')
    choices = [parse_choice(text) for text in args.bags]
    settings = MonitorSettings(
        args.kind, rates=Rates(args.false_alarms, 60.0 * args.false_alarms),
        detector=DetectorSettings(debounce=args.debounce), contact=True)
    with steps(len(choices) + 1) as step:
        data, truths = [], []
        for place, choice in enumerate(choices):
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, None))
            truths.append(_truth(args, place, data[-1], bundle))
        seen = warn_of_training(bundle, data)
        step('replay through the detector')
        results = evaluate_collisions(
            bundle, [(bag.choice.path, bag.recording) for bag in data], settings, truths)
    if args.report:
        from tudor_dynamics.show.page import collision_page  # slow to import
        write(args.report, '--report', collision_page(
            bundle, data, results, args.false_alarms, _made(args, bundle)).encode())
    if args.json:
        print_json({'model': args.model, 'bags': [str(c) for c in choices],
                    **({'trained_on': seen} if seen else {}),
                    'false_alarms_allowed_per_hour': args.false_alarms,
                    'collisions': {item.method: collision_values(item, args.false_alarms)
                                   for item in results}})
    else:
        _print_verdict(results, args, bundle)
        print_collisions(results, args.false_alarms)
        say(*[f'{item.method} in {bag.bag}: up to {bag.ratio.max(initial=0.0):.2f} times its '
              f'threshold; pushes are known from {bag.truth.source or "nothing"}'
              for item in results for bag in item.watched] * args.verbose)
        if args.report:
            say(f'report: {args.report}')
    return 0


def _truth(args: argparse.Namespace, place: int, bag: BagData, bundle: ModelBundle) -> Truth:
    """Find out what is known of the pushes of one bag."""
    if args.free:
        return FREE
    if not args.pushes:
        return find_truth(bag.choice.path, args.truth, plan_from_arm(bundle.arm).joint_topic)
    return truth_of_file(args.pushes[place], bag)


def print_collisions(results: Sequence[MethodResult], allowed: float) -> None:
    """Print one row a method, and after it one row an event."""
    table = new_table(
        f'collisions, false alarms allowed per hour: {allowed:g}', names=('method',),
        figures=('events', 'pushes\nfound', 'latency\nmedian [ms]', '\n95 % [ms]',
                 'false\nalarms', '\nin [min]'))
    for item in results:
        score = item.score
        known = score.false_alarms is not None
        latencies = ('-' if value is None else f'{1e3 * value:.0f}'
                     for value in (score.latency_median, score.latency_p95))
        table.add_row(
            item.method, str(score.events),
            f'{score.found} of {score.pushes}' if known else '-', *latencies,
            str(score.false_alarms) if known else '-', f'{60 * score.hours:.1f}' if known else '-')
    print_table(table)
    for place, bag in enumerate(results[0].watched):
        begin, figures, rows = event_table(results, place)
        if rows:
            table = new_table(f'events in {bag.bag}, 0 s is {begin}', EVENT_NAMES, figures)
            for row in rows:
                table.add_row(*row)
            print_table(table, spare=UTC)
    say(*(f'{bag.bag}: no truth in this bag: give --pushes FILE.csv or --truth TOPIC, or --free '
          'if nothing touched the arm' for bag in results[0].watched if not bag.truth.known),
        *event_notes(results))


def _print_verdict(
    results: Sequence[MethodResult], args: argparse.Namespace, bundle: ModelBundle,
) -> None:
    """Say what a monitor finds, how many times what was promised came, and what to do."""
    name, score = results[0].method, results[0].score
    if score.pushes and score.hours:
        level = Grade.USABLE if score.found else Grade.DO_NOT_USE
        if score.found == score.pushes and not score.false_alarms:
            level = Grade.GOOD
        who = 'all methods together, as a monitor runs, find' if name == ALL else f'{name} finds'
        say_verdict(level, f'{who} {score.found} of {score.pushes} pushes',
                    f'; false alarms in {60 * score.hours:.1f} min: {score.false_alarms}')
    broken = False
    for item in results:
        kept = item.score.kept(args.false_alarms)
        if kept is not None:
            broken |= kept['low'] > 1.0
            grade = Grade.DO_NOT_USE if kept['low'] > 1.0 else (
                Grade.GOOD if kept['high'] < TOO_WIDE else None)
            times = (f'too short to judge ({60.0 * item.score.hours:.2g} min)' if grade is None
                     else f'{kept["ratio"]:.3g} times as many (90 % interval {kept["low"]:.3g} to '
                     f'{kept["high"]:.3g})')
            say_verdict(grade, times, of=f'{item.method}: false alarms in {item.score.hours:.3g} '
                        f'h: {item.score.false_alarms}, {kept["promised"]:.3g} promised: ')
    if broken and args.free:
        gaps = [bag.bag for bag in results[0].watched if bag.not_judged > HALF]
        command = '' if gaps else fit_with(bundle, args.bags, args.model, args.payload)
        say('more than was promised: ' + (
            f'{", ".join(gaps)}: most was not judged; record that motion without gaps' if gaps else
            'this motion is of another kind or day; thresholds learn it from these bags'
            + ':' * bool(command)))
        if command:
            say_command(command)


def collision_values(item: MethodResult, allowed: float) -> dict[str, Any]:
    """Give figures, events and curve of one method as plain values."""
    return {**item.score.as_dict(), 'kept': item.score.kept(allowed),
            'largest_ratio': {bag.bag: float(bag.ratio.max(initial=0.0)) for bag in item.watched},
            'not_judged': {bag.bag: bag.not_judged for bag in item.watched},
            'truth': {bag.bag: bag.truth.source or None for bag in item.watched},
            'event_list': [{'bag': bag.bag, **seen.as_dict()}
                           for bag in item.watched for seen in bag.sightings],
            'roc': [list(point) for point in item.roc]}


# -- ``tudor evaluate``: compare a saved model with bags

EXAMPLES = """\
examples:
  tudor evaluate --model model run4
  tudor evaluate --model model run4 run5 --json
  tudor evaluate --model model run1@60-100%
  tudor evaluate --model model run4 --rate full --save run4.npz
  tudor evaluate --model model pushes free --collisions --report pushes.html

The filters and the rate are those that the model was fitted with. --collisions replays the bags
through the collision detector; pushes are read from /applied_wrench, a topic or a table.

The figures are compared with those of the validation. A channel is no longer what it was where
its error has grown by 30 % and its relative error by 15 %, and the error by more than three of its
standard errors (of mean squares over 5 s, then and now). exit codes: 0 as it was, or nothing
to compare with (another --rate, an older model); 1 no longer what it was; 2 wrong input. An ELM
beside other models does not count.
"""
DETAILS = ('print samples, and all channels compared, too; with --collisions the largest ratio in '
           'each bag, and what pushes are known from')


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor evaluate``."""
    add_bags_and_model(parser)
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip, for a model of all loads; by default what each '
                             "bag's metadata say")
    parser.add_argument('--rate', metavar='HZ',
                        help='another rate than that of the fit; "full" for every sample')
    parser.add_argument('--causal', action='store_true',
                        help='judge the models as they run beside the robot: with causal filters, '
                             'standstill at the ends included')
    parser.add_argument('--save', metavar='FILE.npz',
                        help='write stamps, measured, predicted and residual values')
    parser.add_argument('--report', metavar='FILE.html',
                        help='write a page: figures, findings, a load that is found; with '
                             '--collisions: ratios, pushes, events and the ROC')
    add_overwrite(parser, '--save', '--report')
    group = parser.add_argument_group('collisions')
    group.add_argument('--collisions', action='store_true',
                       help='judge the collision detector instead of the predictions')
    group.add_argument('--false-alarms', type=float, default=1.0, metavar='N',
                       help='false alarms per hour that are allowed (default: 1)')
    group.add_argument('--debounce', type=float, default=0.01, metavar='S',
                       help='time for which a threshold must be exceeded (default: 0.01 s)')
    group.add_argument('--kind', choices=tuple(KINDS), default='analytical',
                       help='model whose residuals are watched (default: analytical)')
    group = group.add_mutually_exclusive_group()
    group.add_argument('--pushes', nargs='+', default=[], metavar='FILE.csv',
                       help='tables of begin,end[,tolerance] in seconds since the beginning of '
                            'the bag, one for each bag')
    group.add_argument('--truth', metavar='TOPIC',
                       help='WrenchStamped or Bool that says when the arm was touched (default: '
                            'applied_wrench, where there is one)')
    group.add_argument('--free', action='store_true',
                       help='nothing touched the arm: every event is a false alarm')


def run(args: argparse.Namespace) -> int:
    """Read, predict, compare."""
    for name, ending in (('save', '.npz'), ('report', '.html')):
        if getattr(args, name):
            check_target(getattr(args, name), overwrite=args.overwrite, name=name,
                         endings=(ending,))
    bundle = load_bundle(args.model, arm=load_arm(args.arm) if args.arm else None)
    if args.causal:
        bundle = bundle.beside_robot()
    if args.payload is not None:
        bundle.at(args.payload)  # says so if it is no use
    choices = [parse_choice(text) for text in args.bags]
    if args.collisions:
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
    # an ELM decides where there is no other model
    decides = [change for change in compared if change.kind != 'elm'] or compared
    worse = [change for change in decides if change.changed]
    if args.save:
        save_traces(args.save, found)
    if args.report:
        from tudor_dynamics.show.page import evaluation_page  # slow to import
        write(args.report, '--report', evaluation_page(
            bundle, [str(c) for c in choices], found, evaluated, worse,
            _made(args, bundle)).encode())
    if args.json:
        content: dict[str, Any] = {'model': args.model, 'bags': [str(c) for c in choices],
                                   'samples': sum(bag.samples for bag in data),
                                   **({'trained_on': seen} if seen else {}),
                                   'findings': [item.as_dict() for item in findings],
                                   'loads': {bag: carried.as_dict()
                                             for bag, carried in evaluated.loads.items()}}
        for output, kinds in found.items():
            content[output] = {kind: {
                name: value for name, value in rounded(item.score, digits=9).items()
                if name != 'samples'} for kind, item in kinds.items()}
        comparison: dict[str, Any] = {}
        for change in compared:
            comparison.setdefault(change.output, {}).setdefault(change.kind, {})[
                change.channel] = change.as_dict()
        print_json({**content, 'as_it_was': None if not compared else not worse,
                    'comparison': comparison})
        return 1 if worse else 0
    rows = [(output, kind, item.score, output_units(bundle.arm, output))
            for output, kinds in found.items() for kind, item in kinds.items()]
    events = [bag.choice.path for bag in data if records_of(open_bag(bag.choice.path))]
    for path in events:
        say(f'{path} is the bag of an event: of the model it says nothing; why it came:')
        say_command(shlex.join(['tudor', 'why', str(path)]))
    for change in worse:
        say_verdict(Grade.DO_NOT_USE, str(change))
    if compared and not worse:
        say_verdict(Grade.GOOD, 'the model is what it was in its validation',
                    ': no channel is worse by more than chance')
    print_table(score_table(f'{args.model} on {", ".join(map(str, choices))}, ' + (
        'as the monitor filters' if args.causal else 'offline: filters without delay'), rows))
    if args.verbose:
        say(*(f'{bag.choice}: {bag.samples} samples' for bag in data),
            *(str(change) for change in compared if change not in worse))
    print_findings(findings)
    for bag, carried in evaluated.loads.items():
        say(f'load in {bag}: {carried.sentence}')
        say_command(shlex.join(['tudor', 'payload', bag, '--model', args.model]))
    if worse and not events and all(item.kind == 'standstill' for item in findings):
        _print_cause(args, data, [touched(change, found[change.output][change.kind])
                                  for change in worse])
    return 1 if worse else 0


def _made(args: argparse.Namespace, bundle: ModelBundle) -> dict[str, str]:
    """Say where a page comes from."""
    return {**provenance(), 'command': args.call, 'model': f'{args.model}, digest {bundle.digest}'}


def _print_cause(args: argparse.Namespace, data: Sequence[BagData], short: Sequence[str]) -> None:
    """Say why an error has grown, where the doctor finds nothing: pushes, or friction."""
    pushed = [f'{bag.choice} holds {count} push{"es" * (count != 1)}' for bag in data if (
        count := len(within(find_truth(bag.choice.path), bag.recording).pushes))]
    if pushed or all(short):
        say(f'{"; ".join(pushed or short)}: something touched the arm, no new fit is needed; look '
            'at the pushes:')
        say_command(shlex.join(['tudor', 'evaluate', '--model', args.model,
                                *(str(bag.choice) for bag in data), '--collisions']))
    else:
        say('the doctor finds no cause in these bags: temperature and wear of the drives change '
            'friction; fit again with these bags')


def chosen_rate(spec: PreprocessingSpec, rate: str | None) -> PreprocessingSpec:
    """Give the preprocessing with another rate, where one is asked for."""
    if rate is None:
        return spec
    try:
        value = None if rate == 'full' else float(rate)
    except ValueError:
        value = -1.0
    if value is not None and not 0 < value < float('inf'):
        raise UsageError(f'--rate {rate}: expected a rate above 0 Hz, or "full"')
    return spec.model_copy(update={'rate': value})


def save_traces(path: str, found: dict[str, dict[str, Validation]]) -> None:
    """Write every sample that was compared, whole or not at all."""
    arrays: dict[str, Any] = {}
    for output, kinds in found.items():
        for kind, item in kinds.items():
            name = f'{output}_{kind}'
            arrays[f'{output}_channels'] = np.array(item.channels)
            arrays[f'{name}_bag'] = np.repeat([trace.bag for trace in item.traces],
                                              [len(trace.t) for trace in item.traces])
            for field in ('stamp', 'measured', 'predicted', 'residual'):
                arrays[f'{name}_{field}'] = np.concatenate(
                    [getattr(trace, field) for trace in item.traces])
    write(path, '--save', dump_npz(arrays, small=True))
