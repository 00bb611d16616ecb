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

"""``tudor watch``: residuals against thresholds, events and load, from a bag or from topics."""

from __future__ import annotations

import argparse
from contextlib import suppress
from importlib.util import find_spec
import os
import shlex
import sys
import time

from tudor_dynamics.bags.storage import open_bag
from tudor_dynamics.cli.console import add_overwrite, print_json, say, write
from tudor_dynamics.errors import ModelError, UsageError
from tudor_dynamics.files import check_target
from tudor_dynamics.load.live import carried_load, load_facts, load_text
from tudor_dynamics.models.bundle import load_bundle
from tudor_dynamics.online.black_box import messages_of, replayed
from tudor_dynamics.online.detector import Rates, time_of_day
from tudor_dynamics.online.monitor import Monitor, MonitorSettings
from tudor_dynamics.online.settings import STUCK_TIME
from tudor_dynamics.show.live import DRAWN, LiveView, PARTS, picture_of, shown

EXAMPLES = """\
examples:
  tudor watch run4 --model model
  tudor watch run4 --model model --speed 10 --web 8080
  tudor watch run4 --model model --picture watch.svg
  tudor watch --namespace left

With a bag, the messages pass a monitor at the speed at which they were recorded; without, the
topics of a monitor that runs are shown (ROS 2 is needed). Where no terminal watches, a bag passes
at once, and each event is a line. --web serves view and all events to browsers of this machine.
"""
LAST_PORT = 65535


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor watch``."""
    parser.add_argument('bag', nargs='?', metavar='BAG', help='recording (live topics)')
    parser.add_argument('--model', metavar='MODEL', help='directory of tudor fit, for a bag')
    parser.add_argument('--payload', type=float, default=0.0, metavar='KG',
                        help='mass at the tip at the beginning; it is followed (0)')
    parser.add_argument('--false-alarms', type=float, default=1.0, metavar='N',
                        help='false alarms per hour that are allowed (1)')
    parser.add_argument('--speed', type=float, default=1.0, metavar='TIMES',
                        help='speed of the replay, 0 for as fast as it goes (1)')
    parser.add_argument('--picture', metavar='FILE.svg', help='write the last view')
    add_overwrite(parser, '--picture')
    parser.add_argument('--web', type=int, metavar='PORT', help='serve a page on 127.0.0.1')
    parser.add_argument('--namespace', default='', metavar='NS',
                        help='that of the monitor, for live topics')


def run(args: argparse.Namespace) -> int:
    """Watch a bag, or become the node that watches topics."""
    if args.web is not None and not 0 < args.web <= LAST_PORT:
        raise UsageError(f'--web {args.web}: expected a port of 1 to {LAST_PORT}')
    if args.bag is None:
        if args.picture or args.model or args.json:
            raise UsageError('--picture, --model and --json need a BAG; give a BAG, or omit them')
        if find_spec('rclpy') is None:
            raise UsageError('live topics need ROS 2',
                             remedy='source its setup.bash, or give a BAG')
        command = ['-m', 'tudor_dynamics.nodes', 'watch', '--ros-args', '--log-level', 'error',
                   '-p', f'web:={args.web or 0}']
        if args.namespace:
            command += ['-r', f'__ns:=/{args.namespace.strip("/")}']
        os.execv(sys.executable, [sys.executable, *command])
    if not args.model:
        raise UsageError('watching a bag needs a model of its arm', remedy='give --model MODEL')
    if not args.speed >= 0.0:
        raise UsageError(f'--speed {args.speed:g}: give 0 or more')
    if not args.false_alarms > 0.0:
        raise UsageError(f'--false-alarms {args.false_alarms:g}: give more than 0 an hour')
    if args.picture:
        check_target(args.picture, overwrite=args.overwrite, name='picture', endings=('.svg',))
    return _bag(args)


def _bag(args: argparse.Namespace) -> int:
    """Let the messages of a bag pass a monitor that is looked at."""
    bundle = load_bundle(args.model).beside_robot()
    load = None
    with suppress(ModelError):  # not every model knows a load
        load = carried_load('estimate', bundle, args.payload)
    monitor = Monitor(bundle.at(args.payload), MonitorSettings(
        methods=(), rates=Rates(args.false_alarms, 60.0 * args.false_alarms)), payload=load)
    messages = messages_of(open_bag(args.bag), bundle.arm)
    terminal = sys.stdout.isatty() and not args.json
    speed = args.speed if terminal or args.web else 0.0
    view, events = LiveView(f'{bundle.arm.spec.name}: {args.bag}'), []
    begun, drawn = time.monotonic(), 0.0
    why = ['tudor', 'why', args.bag, '--model', args.model]
    for name, value, usual in (('payload', args.payload, 0.0),
                               ('false-alarms', args.false_alarms, 1.0)):
        why += [f'--{name}', f'{value:g}'] if value != usual else []

    def look() -> None:
        """Take level, load and state into the view, once for each time that it is drawn."""
        watch = monitor.watch
        view.level = watch.level.name.lower()
        view.diagnosed(watch.figures(STUCK_TIME) | {
            'load': load_text(**load_facts(load, bundle, args.payload))})
        view.warning = watch.stuck(STUCK_TIME) or watch.outside_training
    with shown(view, args.web, terminal=terminal) as draw:
        for message, found in replayed(messages, bundle.arm, monitor):
            for event in found.events:
                line = view.event(event.onset, event.method, event.link, event.ratios, shlex.join(
                    [*why, '--at', time_of_day(event.onset)[11:23]]))
                events.append({'onset': event.onset, 'method': event.method, 'link': event.link,
                               'ratio': event.ratios})
                if not terminal and not args.json:
                    say(line)
            for method, excess in found.excesses:
                channels = monitor.watch.stages[method].thresholds.channels
                for part, values in zip(PARTS, (
                        excess.collision, excess.residual.value, excess.threshold), strict=True):
                    view.take(excess.residual.motion.stamp, method, part, channels, values)
            now = time.monotonic()
            if now > drawn + DRAWN:
                drawn = now
                look()
                draw()
            if speed:
                due = begun + (message.time - messages[0].time) * 1e-9 / speed
                time.sleep(max(0.0, due - now))
        look()
        draw()
    if args.picture:
        write(args.picture, '--picture', picture_of(view).encode())
    if args.json:
        print_json({'model': args.model, 'bag': args.bag, 'events': events})
    elif not terminal:
        say(f'{len(events)} event{"s" * (len(events) != 1)}')
    return 0
