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

"""``tudor evaluate --collisions``: how well the detector finds pushes, and what it finds."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from typing import Any

from tudor_dynamics.bags.sources import plan_from_arm
from tudor_dynamics.cli.console import finite, new_table, print_json, print_table, steps
from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.bag_choice import parse_choice
from tudor_dynamics.identification.collisions.replay import evaluate_collisions, MethodResult
from tudor_dynamics.identification.collisions.score import Watched
from tudor_dynamics.identification.collisions.truth import (
    find_truth, FREE, table_of_pushes, Truth, truth_of_table)
from tudor_dynamics.identification.dataset import BagData, load
from tudor_dynamics.library.prediction import warn_of_training
from tudor_dynamics.models.bundle import ModelBundle
from tudor_dynamics.models.storage.bundle_io import load_bundle
from tudor_dynamics.monitoring.detector import DetectorSettings
from tudor_dynamics.monitoring.settings import MonitorSettings
from tudor_dynamics.monitoring.thresholds.excess import Rates
from tudor_dynamics.report.events import write_events
from tudor_dynamics.report.roc import picture_path, write_roc


def run_collisions(args: argparse.Namespace) -> int:
    """Replay bags through the detector, and judge it by what is known of the pushes."""
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
    picture = picture_path(args.plot) if args.plot else None
    bundle = at_payload(load_bundle(args.model), args.payload)
    kinds = sorted({kind for models in bundle.models.values() for kind in models})
    if args.kind not in kinds:
        msg = (f'{args.model} has no {args.kind} model; it has {" and ".join(kinds)}: give '
               f'--kind, or fit it again with --models {args.kind}')
        raise UsageError(msg)
    choices = [parse_choice(text) for text in args.bags]
    settings = MonitorSettings(
        args.kind, rates=Rates(args.false_alarms, 60.0 * args.false_alarms),
        detector=DetectorSettings(debounce=args.debounce), contact=True)
    with steps(len(choices) + 1) as step:
        data, truths = [], []
        for place, choice in enumerate(choices):
            step(f'read {choice}')
            data.append(load(choice, bundle.arm, bundle.preprocessing))
            truths.append(_truth(args, place, data[-1], bundle))
        seen = warn_of_training(bundle, data)
        step('replay through the detector')
        results = evaluate_collisions(
            bundle, [(bag.choice.path, bag.recording) for bag in data], settings, truths)
    if plot is not None:
        if not any(truth.known for truth in truths):
            msg = '--roc needs to know the pushes; give --pushes FILE.csv, --truth TOPIC or --free'
            raise UsageError(msg)
        write_roc(results, plot)
    if picture is not None:
        write_events(results, picture)
    if args.json:
        print_json(finite({'model': args.model, 'bags': [str(c) for c in choices],
                           **({'trained_on': seen} if seen else {}),
                           'false_alarms_allowed_per_hour': args.false_alarms,
                           'collisions': {item.method: collision_values(item)
                                          for item in results}}))
    else:
        print_collisions(results, args.false_alarms)
        for file in (plot, picture):
            if file is not None:
                print(f'plot: {file}')
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


def print_collisions(results: Sequence[MethodResult], allowed: float) -> None:
    """Print one row a method, and behind it one row an event."""
    table = new_table(
        f'collisions, thresholds for {allowed:g} false alarms per hour', names=('method',),
        figures=('events', 'pushes\nfound', 'latency\nmedian [ms]', '\n95 % [ms]',
                 'false\nalarms', '\nin [min]', 'largest\nratio free'))
    for item in results:
        score = item.score
        quiet = [float(bag.ratio.max(initial=0.0)) for bag in item.watched
                 if bag.truth.known and not bag.truth.pushes]
        told = score.false_alarms is not None
        table.add_row(
            item.method, str(score.events),
            f'{score.found} of {score.pushes}' if told else '-',
            _milliseconds(score.latency_median), _milliseconds(score.latency_p95),
            str(score.false_alarms) if told else '-', f'{60 * score.hours:.1f}' if told else '-',
            f'{max(quiet):.2f}' if quiet else '-')
    print_table(table)
    _print_events(results)
    for sentence in (*unknown(results), *(
            f'{item.method}: force and place are not told: {item.no_contact}'
            for item in results if item.no_contact)):
        print(sentence)


def _milliseconds(value: float | None) -> str:
    return '-' if value is None else f'{1e3 * value:.0f}'


def _print_events(results: Sequence[MethodResult]) -> None:
    for place, bag in enumerate(results[0].watched):
        rows = [(item.method, seen, item.watched[place])
                for item in results for seen in item.watched[place].sightings]
        if not rows:
            continue
        table = new_table(f'events in {bag.bag}', names=('method', 'link', 'channel', 'push'),
                          figures=('time [s]', 'ratio', 'lasts [s]', 'touched at',
                                   'force [N]', 'place [mm]'))
        for method, seen, watched in sorted(rows, key=lambda row: row[1].time):
            table.add_row(method, seen.event.link, seen.channel, _push(watched, seen.push),
                          f'{seen.time:.2f}', f'{seen.ratio:.1f}', f'{seen.seconds:.2f}',
                          *_contact(seen.contact))
        print_table(table)


def _contact(found: dict[str, Any] | None) -> tuple[str, str, str]:
    """Give link, force and place of what touched the arm."""
    if not found:
        return '-', '-', '-'
    place, spread = found['place'], found['place_deviation']
    return (found['link'], f'{found["force"]:.1f}',
            'not told' if place is None else f'{1e3 * place:.0f} +- {1e3 * spread:.0f}')


def _push(watched: Watched, place: int | None) -> str:
    if not watched.truth.known:
        return '?'
    if place is None:
        return 'none: false'
    force = watched.truth.pushes[place].force
    return f'{place + 1}' + ('' if math.isnan(force) else f' ({force:.3g} N)')


def unknown(results: Sequence[MethodResult]) -> list[str]:
    """Say of which bags it is not known what happened, with the number of events in each."""
    said = []
    for place, bag in enumerate(results[0].watched):
        if not bag.truth.known:
            counts = ', '.join(f'{len(item.watched[place].sightings)} by {item.method}'
                               for item in results)
            said.append(f'{bag.bag}: {counts} events, no truth in this bag: give --pushes '
                        'FILE.csv or --truth TOPIC, or --free if nothing touched the arm')
    return said


def collision_values(item: MethodResult) -> dict[str, Any]:
    """Give figures, events and curve of one method as plain values."""
    return {**item.score.as_dict(),
            'largest_ratio': {bag.bag: float(bag.ratio.max(initial=0.0)) for bag in item.watched},
            'truth': {bag.bag: bag.truth.source or None for bag in item.watched},
            'event_list': [{'bag': bag.bag, **seen.as_dict()}
                           for bag in item.watched for seen in bag.sightings],
            'roc': [list(point) for point in item.roc]}
