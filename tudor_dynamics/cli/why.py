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

"""``tudor why``: why a monitor alarmed, by its messages past the same objects again."""

from __future__ import annotations

import argparse
from pathlib import Path
import re
import warnings

from tudor_dynamics.bags.storage import bags_below, open_bag
from tudor_dynamics.cli.console import bar, print_json, say, say_verdict
from tudor_dynamics.errors import TudorWarning, UsageError
from tudor_dynamics.identification.causes import Cause, explain
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.online.black_box import records_of
from tudor_dynamics.online.detector import Rates, time_of_day
from tudor_dynamics.online.monitor import MonitorSettings

EXAMPLES = """\
examples:
  tudor why ~/.ros/tudor_dynamics/events/event_20260314_140315_401236
  tudor why run4 --model model --at 14:03:12

The bag of an event holds the settings of the monitor, and names its model. In a bag without events
that were recorded, all that come are explained. Causes: clock, gauge, gap, load, friction after
standstill, touch, motion outside training, threshold too low; otherwise the event is unexplained.
exit codes: 0 each event has a cause; 1 one has none, or none came; 2 wrong input.
"""
OWN = re.compile(r'event_\d{8}_\d{6}_')
DETAILS = 'print the ratio of each channel at which an event became certain, too'


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor why``."""
    parser.add_argument('bag', metavar='BAG', help='bag of events, or any other recording; of a '
                        'folder of events the newest')
    parser.add_argument('--model', metavar='MODEL',
                        help='directory of tudor fit (that which the bag names)')
    parser.add_argument('--at', default='', metavar='HH:MM:SS',
                        help='explain the events whose date or time, in UTC, has this in it')
    parser.add_argument('--payload', type=float, metavar='KG',
                        help='mass at the tip (that which the bag names, or 0)')
    parser.add_argument('--false-alarms', type=float, default=1.0, metavar='N',
                        help='false alarms per hour of a bag without events (1)')


def run(args: argparse.Namespace) -> int:
    """Replay, explain, print."""
    if re.search('[^0-9 :.UTC-]', args.at):
        raise UsageError(f'--at {args.at}: expected a time of day in UTC, such as 14:03:12')
    folder, args.bag = args.bag, max(
        (str(bag) for bag in bags_below(Path(args.bag)) if OWN.match(bag.name)),
        key=lambda bag: Path(bag).name, default=args.bag)
    if args.bag != str(Path(folder)) and not args.json:
        say(f'{args.bag}: the newest bag of an event')
    with bar(None, 'replay'):
        found = causes(args)
    code = 0 if found and all(cause.evidence for cause in found) else 1
    if args.json:
        print_json([{
            **cause.event.as_dict(), 'method': cause.event.event.method, 'cause': cause.name,
            'evidence': cause.evidence, 'remedy': cause.remedy, 'same': cause.same}
            for cause in found])
        return code
    if not found:
        say_verdict(Grade.USABLE, 'no such event comes when the messages pass the monitor again',
                    '; times are in UTC')
    for cause in found:
        seen = cause.event
        say_verdict(Grade.GOOD if cause.evidence else Grade.USABLE, cause.name,
                    of=f'{time_of_day(seen.event.onset)}: ')
        say(f'  {seen.channel} of {seen.event.link}, by {seen.event.method}: '
            f'{seen.ratio:.2f} times its threshold, for {1e3 * seen.seconds:.0f} ms',
            *(f'  {text}' for text in (cause.evidence, cause.remedy, seen.note) if text))
        if args.verbose:
            say('  when it became certain, in thresholds: ' + ', '.join(
                f'{name} {ratio:.2f}' for name, ratio in seen.event.ratios.items()))
        if cause.same is not None:
            say('  the replay gives the event of the node to the last bit' if cause.same else
                '  the replay comes near to the event of the node, not to the last bit: model '
                'or payload differ, or the bag is of another version or of less than 25 s')
    return code


def causes(args: argparse.Namespace) -> list[Cause]:
    """Explain the events of a bag with the settings that it holds, or with the usual ones."""
    bag = open_bag(args.bag)
    records = records_of(bag)
    params = records[0]['settings'] if records else {}
    model = args.model or params.get('model')
    if not model:
        raise UsageError('the bag names no model', place=args.bag, remedy='give --model MODEL')
    try:
        settings = MonitorSettings.of({**params, 'estimate_contact': True}) if params else (
            MonitorSettings(methods=(), contact=True, rates=Rates(
                args.false_alarms, 60.0 * args.false_alarms)))
        payload = float(params.get('payload', 0.0) if args.payload is None else args.payload)
    except (KeyError, TypeError, ValueError) as err:
        raise UsageError(f'it has damaged settings of its monitor ({err})', place=args.bag,
                         remedy='give a bag that the monitor of this version wrote') from None
    bundle = load_bundle(model)
    digest = records[0].get('digest', bundle.digest) if records else bundle.digest
    if digest != bundle.digest:
        warnings.warn(f'the model {model!r} is not the one that the monitor used for this event '
                      f'(checksum {bundle.digest[:4]}, not {str(digest)[:4]}), so results may '
                      "differ from the monitor's; give the monitor's model with --model",
                      TudorWarning, stacklevel=2)
    found = explain(bag, bundle, settings, str(params.get('payload_source', 'parameter')), payload,
                    records)
    return [cause for cause in found if args.at in time_of_day(cause.event.event.onset)]
