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

"""``tudor fit``: learn models from bags, judge them, save bundle and report."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.arm.schema import AUTO, FRICTION_TERMS, PreprocessingSpec, validation_message
from tudor_dynamics.cli.console import (
    add_out, add_running, check_running, print_findings, print_json, print_table,
    print_verdicts, say, say_command, score_table, steps)
from tudor_dynamics.cli.excite import print_comparison
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.dataset import found_choices, parse_payloads
from tudor_dynamics.identification.excitation_plan import read_plan
from tudor_dynamics.identification.fit import (
    choices_to_list, DEFAULT_KINDS, FitResult, FitSettings, headline)
from tudor_dynamics.identification.loads import figures
from tudor_dynamics.identification.many_bags import FROM, Streaming, streams, SUFFIX
from tudor_dynamics.identification.next_steps import Assessment
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.library import fit_choices
from tudor_dynamics.models.bundle import check_bundle_target, KINDS
from tudor_dynamics.models.estimation import ESTIMATORS
from tudor_dynamics.models.regressor import output_units, STRAIN_FORMS
from tudor_dynamics.parallel import on_cluster

EXAMPLES = """\
examples:
  tudor fit run1 run2 run3 --arm my_arm.yaml --out model
        fit to three bags, each left out once for validation
  tudor fit run1 run2 --test run3 --arm my_arm.yaml --out model
        judge by a bag of its own
  tudor fit run1@0-60% --test run1@60-100% --arm my_arm.yaml --out model
        parts of one bag by time; BAG@5s-50s counts seconds
  tudor fit empty full --payload-of empty=0 full=0.4 --arm arm.yaml --out model
        one model of all payloads, its parameters affine in the mass at the tip; bags of
        `tudor record` carry their payload themselves

MODEL/report.html shows what was found. exit codes: 0 done, 1 no model is good enough, 2 wrong
input.
"""
DETAILS = 'print offline figures, all verdicts and what was chosen, too'

VIBRATION = 'vibration'  # stands beside the kinds of models, for `ModelBundle.tool`
CURRENTS = {'shared': True, 'separate': False}
"""Words for whether currents of unknown torque constants share the inertial parameters."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor fit``."""
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bag directory or file, or a part of it: BAG@0-60%%, BAG@5s-50s; a '
                             "folder of bags; or a pattern, such as 'bags/2026-*'")
    parser.add_argument('--arm', metavar='YAML', required=True,
                        help='arm description; tudor init writes one')
    add_out(parser, 'MODEL', 'directory for the model and its report')
    parser.add_argument('--test', nargs='+', default=[], metavar='BAG', action='extend',
                        help='bags to judge by; otherwise each training bag is left out once')
    parser.add_argument('--payload-of', nargs='+', default=[], metavar='BAG=KG', action='extend',
                        help='mass at the tip in a bag; with several masses among the training '
                             'bags, one model of all loads is fitted')
    parser.add_argument('--ignore-payload', action='store_true',
                        help='fit as if all bags had the same load')
    parser.add_argument('--models', nargs='+', choices=(*KINDS, VIBRATION), metavar='KIND',
                        default=list(DEFAULT_KINDS),
                        help='analytical (default), elm, elastic (needs links); and vibration: '
                             'how a tool at the flange rings after motion')
    parser.add_argument('--plan', metavar='PLAN',
                        help='directory of tudor excite that the bags were recorded by: standard '
                             'errors expected and reached')
    parser.add_argument('--compare', metavar='MODEL', type=Path,
                        help='earlier model to compare this fit with (the one that --overwrite '
                             'replaces)')
    parser.add_argument('--exit-zero', action='store_true',
                        help='exit with 0 even if no model is good enough')
    many = parser.add_argument_group('many bags')
    many.add_argument('--stream', action='store_true',
                      help='go through the bags one by one and keep the sums of each in '
                           f'MODEL{SUFFIX} (default from {FROM} bags on)')
    many.add_argument('--strict', action='store_true',
                      help='refuse bags that cannot be used, in place of leaving them out')
    add_running(many)
    signals = parser.add_argument_group('signals (defaults: arm description)')
    signals.add_argument('--filter', choices=(AUTO, 'causal', 'zero_phase'),
                         help="the papers' causal filters, or zero-phase ones; auto chooses by "
                              'parts of the bags that are left out')
    signals.add_argument('--rate', metavar='HZ', help='decimate to this rate; "full" for none')
    signals.add_argument('--cutoff', type=float, metavar='HZ', help='zero-phase cut-off')
    signals.add_argument('--output-cutoff', type=float, metavar='HZ',
                         help='causal low-pass over positions, velocities, efforts and strains')
    models = parser.add_argument_group('models')
    models.add_argument('--estimator', choices=(AUTO, *ESTIMATORS), default=AUTO,
                        help='of the analytical model (default: auto, by parts left out)')
    models.add_argument('--friction', nargs='+', choices=(AUTO, *FRICTION_TERMS), metavar='TERM',
                        help=f'friction of all joints: {", ".join(FRICTION_TERMS)}; or auto '
                             '(default: arm description, auto where it names none)')
    models.add_argument('--currents', choices=(AUTO, *CURRENTS), default=AUTO,
                        help='joints of unknown torque constants: inertial parameters shared '
                             'with the others, or separate (default: auto)')
    models.add_argument('--strain-form', choices=STRAIN_FORMS, default='exact',
                        help="bending moment at the gauge, or the joint's as in the paper")
    models.add_argument('--elm-hidden', type=int, default=100, metavar='H',
                        help='neurons of the ELM (default: 100)')
    models.add_argument('--elm-ridge', type=float, default=1e-6, metavar='LAMBDA',
                        help='its regularisation (default: 1e-6)')
    models.add_argument('--elm-seed', type=int, default=0, metavar='N',
                        help='of its random weights (default: 0)')


def described(args: argparse.Namespace) -> Arm:
    """Read the arm, with the friction that the command line asks for."""
    arm = load_arm(args.arm)
    if args.friction is None:
        return arm
    if AUTO in args.friction:
        if len(args.friction) > 1:
            raise UsageError(f'--friction {" ".join(args.friction)}: give auto alone, or names of '
                             'terms without auto')
        return arm.with_open_friction()
    terms = tuple(dict.fromkeys(args.friction))
    return arm.with_joints({joint.name: {'friction': terms} for joint in arm.spec.joints})


def chosen_preprocessing(args: argparse.Namespace, arm: Arm) -> PreprocessingSpec:
    """Merge the arm's preprocessing with what the command line says otherwise."""
    changes: dict[str, Any] = {
        name: getattr(args, name) for name in ('filter', 'cutoff', 'output_cutoff')
        if getattr(args, name) is not None}
    if args.rate is not None:
        changes['rate'] = None if args.rate == 'full' else args.rate
    try:
        return PreprocessingSpec.model_validate({
            **arm.spec.preprocessing.model_dump(exclude_unset=True), **changes})
    except ValidationError as err:
        key, wrong = validation_message(err).split(' ', 1)
        raise UsageError(f'--{key.replace("_", "-")} {wrong}; see tudor fit --help') from None


def run(args: argparse.Namespace) -> int:
    """Fit, judge, save, report."""
    check_running(args)
    out = Path(args.out)
    check_bundle_target(out, overwrite=args.overwrite)
    arm = described(args)
    preprocessing = chosen_preprocessing(args, arm)
    plan = None if args.plan is None else read_plan(args.plan)
    training, test = found_choices(args.bags), found_choices(args.test)
    settings = FitSettings(
        kinds=tuple(kind for kind in args.models if kind != VIBRATION) or DEFAULT_KINDS,
        tool=VIBRATION in args.models, estimator=args.estimator, strain_form=args.strain_form,
        elm_hidden=args.elm_hidden, elm_ridge=args.elm_ridge, elm_seed=args.elm_seed,
        shared=CURRENTS.get(args.currents))
    payloads = parse_payloads(args.payload_of, training + test)
    streaming = None
    total = len(training) + len(test)
    if streams(len(training), settings, asked=args.stream):
        sums = out.with_name(out.name + SUFFIX).absolute()
        streaming = Streaming(sums, args.jobs, strict=args.strict)
        total = 4 * len(training) + 2 * len(test)
    # how many steps the search for an elastic model takes shows only at its end
    known = None if 'elastic' in settings.kinds else (
        total + 4 * len(settings.kinds) + 5 + settings.tool)
    with steps(known) as step, on_cluster(args.cluster):
        fit = fit_choices(arm, training, test, preprocessing, settings, payloads,
                          ignore_payload=args.ignore_payload, plan=plan, out=out,
                          overwrite=args.overwrite, streaming=streaming, progress=step,
                          compare=args.compare)
    result, assessment = fit.result, fit.assessment
    report = out / 'report.html'
    live = result.causal or result
    levels = [item.verdict.level for one in (live, result) for item in headline(one.fitted)]
    if assessment.detects is Grade.GOOD:
        levels.append(Grade.USABLE)  # to detect collisions, whatever its figures are
    if args.json:
        print_json({'model': str(out), 'report': str(report), 'seconds': fit.seconds,
                    'findings': [item.as_dict() for item in result.findings],
                    'choices': choices_to_list(result.choices),
                    **({} if fit.plan is None else {'plan': fit.plan.content()}),
                    'unused': [asdict(bag) for bag in result.unused],
                    **assessment.as_dict(), **figures(result), 'beside_robot': figures(live)})
    else:
        _print(result, assessment, report, verbose=args.verbose)
        say(*[f'tool: {fit.bundle.tool}'] * (fit.bundle.tool is not None))
        if fit.plan is not None:
            print_comparison(fit.plan)
    if any(level is not Grade.DO_NOT_USE for level in levels) or args.exit_zero:
        return 0
    return 1


def _print(result: FitResult, assessment: Assessment, report: Path, *, verbose: bool) -> None:
    # first what runs beside the robot, then the offline figures
    live = () if result.causal is None else result.causal.fitted
    judged = [(item, ' beside the robot' * verbose) for item in live]
    if verbose or not live:
        judged += [(item, ' (offline)' if live else '') for item in result.fitted]
    title = f'{result.arm.name}: {result.fitted[0].validation.method}' + (
        ', as the monitor filters' if live and not verbose else '')
    print_verdicts(result.arm.name, assessment.uses)
    rows = []
    for item, where in judged:
        units = output_units(result.arm, item.output)
        rows.append((item.output, f'{item.kind}{where}', item.validation.score, units))
    print_table(score_table(title, rows))
    verdicts = [
        *((item.verdict.level, f'  {item.output} {item.kind}{where}, prediction: {item.verdict}')
          for item, where in judged),
        *((use.level, f'  {use.output} {use.kind}, {use}') for use in assessment.uses
          if use.name != 'prediction')]
    wanted = [text for level, text in verdicts if verbose or level is not Grade.GOOD]
    say(*['verdicts:'] * bool(wanted), *wanted)
    if result.choices and verbose:
        say('chosen on parts of the bags:', *(f'  {choice}' for choice in result.choices))
    say(*(f'mark: {mark}' for mark in assessment.marks))
    print_findings(result.findings)
    say(*(f'the arm rings: {ringing}' for ringing in result.ringing))
    if result.settings.payloads is not None:
        low, high = result.settings.payloads
        say(f'one model of all loads from {low:g} to {high:g} kg; give --payload KG where a '
            'bag does not carry it')
    say(f'model: {report.parent}', f'report: {report}')
    if assessment.steps:
        say('what to do next:')
    for place, step in enumerate(assessment.steps, 1):
        say(f'{place}. {step.what}')
        if step.command:
            say_command(step.command)
