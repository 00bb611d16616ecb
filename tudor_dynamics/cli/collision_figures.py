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

"""Collisions of an evaluation: figures of each method and the events, as tables and for JSON."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

from tudor_dynamics.cli.console import new_table, print_table
from tudor_dynamics.identification.collision_score import Watched
from tudor_dynamics.identification.collisions import MethodResult


def print_collisions(results: Sequence[MethodResult], allowed: float) -> None:
    """
    Print one row a method, and behind it one row an event.

    Parameters
    ----------
    results : sequence of MethodResult
        Results of each method.
    allowed : float
        False alarms per hour that the thresholds allow.

    """
    table = new_table(
        f'collisions, thresholds for {allowed:g} false alarms per hour', names=('method',),
        figures=('events', 'pushes\nfound', 'latency\nmedian [ms]', '\n95 % [ms]',
                 'false\nalarms', '\nin [min]', 'largest ratio\nwithout push'))
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
    for sentence in unknown(results):
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
                          figures=('time [s]', 'ratio', 'lasts [s]'))
        for method, seen, watched in sorted(rows, key=lambda row: row[1].time):
            table.add_row(method, seen.event.link, seen.channel, _push(watched, seen.push),
                          f'{seen.time:.2f}', f'{seen.ratio:.1f}', f'{seen.seconds:.2f}')
        print_table(table)


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
