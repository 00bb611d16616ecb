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

"""``tudor why``: what made a monitor alarm, from the bag that it wrote."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime
import json
from typing import Any

from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.cli.console import print_json
from tudor_dynamics.errors import BagError, UsageError
from tudor_dynamics.load.live import PayloadStage
from tudor_dynamics.models.bundle_io import load_bundle
from tudor_dynamics.online.black_box import EVENTS, heard_in, Replay
from tudor_dynamics.online.detector import CollisionEvent
from tudor_dynamics.online.explanation import explain, REMEDIES
from tudor_dynamics.online.monitor import MonitorSettings, SOURCE

EXAMPLES = """\
examples:
  tudor why ~/.ros/tudor_dynamics/events/event_20260314_140315_401236
  tudor why my_bag --model model --at 14:03:12

The messages are replayed in the order in which they arrived, through what the node runs, with the
parameters that its bag holds; another bag is replayed with the defaults. Causes: touch, load,
samples (lost, repeated, or stamped late), clock, motion unlike training, friction after
standstill, sensor (a gauge, a current, an encoder), threshold (chance), or unexplained. exit
codes: 0 each event has a cause; 1 no event, or one is unexplained; 2 wrong input.
"""


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor why``."""
    parser.add_argument('bag', metavar='BAG', help='bag of an event, or any bag of the arm')
    parser.add_argument('--model', metavar='MODEL',
                        help='bundle of tudor fit (default: that of the node)')
    parser.add_argument('--at', metavar='HH:MM:SS', help='only the event next to this time of day')
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip, for a model of all payloads')
    parser.add_argument('--json', action='store_true', help='print one JSON object')


def run(args: argparse.Namespace) -> int:
    """Replay, and explain each event."""
    bag = open_bag(args.bag)
    try:
        records = json.loads(bag.custom.get(EVENTS, '[]'))
        told = [CollisionEvent(*(record[name] for name in (
            'onset', 'stamp', 'method', 'link', 'residual', 'ratio'))) for record in records]
        params = dict(records[0]['settings']) if records else {}
        float(params.get('payload', 0.0)), [SOURCE[event.method] for event in told]
    except (KeyError, TypeError, ValueError):
        raise BagError(f'{EVENTS} of its metadata is no record of events', place=bag.path,
                       remedy='take it out, and give --model') from None
    path = args.model or params.get('model')
    if not path:
        raise UsageError(f'{args.bag} holds no record of an event: give --model MODEL')
    whole = load_bundle(path)
    known = float(params.get('payload', 0.0) if args.payload is None else args.payload)
    bundle, settings = whole.at(known), MonitorSettings.of(params)
    heard = heard_in(bag, bundle.arm)

    def load() -> PayloadStage | None:
        return PayloadStage(whole, known) if params.get('payload_source') == 'estimate' else None
    found = Replay(bundle, settings, heard, load()).events
    content: list[dict[str, Any]] = []
    for event in chosen(told or found, args.at):
        why = explain(bundle, settings, heard, event, load)
        channel = max(event.ratios, key=lambda name: event.ratios[name])
        content.append({
            'time': str(_moment(event).isoformat(' ', 'milliseconds')), 'link': event.link,
            'method': event.method, 'channel': channel, 'ratio': event.ratios[channel],
            'cause': why.cause, 'evidence': why.text, 'what to do': REMEDIES[why.cause],
            'replay': 'the same to the last bit' if event in found else
            'not the same: the node was older than its bag, or another model',
            'remains': why.remains})
    if args.json:
        print_json({'bag': args.bag, 'model': str(path), 'events': content})
    for item in () if args.json else content:
        print('{time} collision at {link} by {method}: {channel} {ratio:.2f} times its '
              'threshold'.format(**item))
        item['remains'] = ', '.join(f'{name} {100 * share:.0f} %' for name, share in
                                    item['remains'].items() if name != 'nothing') or '-'
        for name in ('cause', 'evidence', 'what to do', 'replay', 'remains'):
            print(f'  {name + ":":12s}{item[name]}')
    if not content and not args.json:
        print('no event comes in this bag')
    return int(not content or any(item['cause'] == 'unexplained' for item in content))


def _moment(event: CollisionEvent) -> datetime:
    """Give the time of day of an event, as the log has it."""
    return datetime.fromtimestamp(event.onset * 1e-9)


def chosen(events: Sequence[CollisionEvent], at: str | None) -> Sequence[CollisionEvent]:
    """Choose the event next to a time of day; all of them without one."""
    try:
        wanted = None if at is None else datetime.strptime(at, '%H:%M:%S')
    except ValueError:
        raise UsageError(f'--at {at}: expected a time of day such as 14:03:12') from None
    if wanted is None or not events:
        return events
    off = [(_moment(event) - wanted).total_seconds() % 86400.0 for event in events]
    return [events[min(range(len(off)), key=lambda k: min(off[k], 86400.0 - off[k]))]]
