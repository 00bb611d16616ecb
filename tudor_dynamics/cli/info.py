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

"""``tudor info``: what is in a bag, what it can be used for, what is wrong with it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime, timezone

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tudor_dynamics.arm.description import Arm, load_arm
from tudor_dynamics.bags.info import BagReport, ChannelReport, describe, TopicReport
from tudor_dynamics.cli.console import (
    new_table, print_findings, print_json, print_table, say, say_verdict)
from tudor_dynamics.errors import BagError, complain, printable
from tudor_dynamics.identification.doctor.examine import examine
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.doctor.samples import look_at_samples
from tudor_dynamics.identification.validation import Grade
from tudor_dynamics.signals.preprocessing import retimed

EXAMPLES = """\
examples:
  tudor info my_bag
  tudor info bags/* --arm config/two_blade_arm.yaml
  tudor info recording_0.mcap --json

Without --arm, joints, efforts and strains are guessed from the topics. The exit code is 0 for a
bag that can be read, even if nothing can be learned from it, and 2 for one that cannot.
"""
DETAILS = 'print files with their checksum, aligned samples and messages left out, too'
REAL_TIME = 1e8  # stamps before this are no dates, but times since some start [s]


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``tudor info``."""
    parser.add_argument('bags', metavar='BAG', nargs='+',
                        help='rosbag2 directory, .mcap or .db3 file')
    parser.add_argument('--arm', metavar='ARM.yaml',
                        help='arm description: look for its joints and gauges')


def run(args: argparse.Namespace) -> int:
    """Describe the bags; 2 if one could not be read, the others are described nevertheless."""
    arm = None if args.arm is None else load_arm(args.arm)
    console = Console(highlight=False, markup=False, emoji=False)
    reports, code = [], 0
    for path in args.bags:
        try:
            report = describe(path, arm)
        except BagError as err:
            if len(args.bags) == 1:
                raise
            complain(f'tudor info: {err}')
            code = 2
            continue
        findings = look_at(report, arm)
        reports.append(report.as_dict() | {'findings': [one.as_dict() for one in findings]})
        if not args.json:
            show(report, console, findings)
        if args.verbose and not args.json:
            left = ', '.join(f'{count} {cause}' for cause, count in report.dropped.items())
            say(f'{report.samples} aligned samples; messages left out: {left or "none"}',
                f'{", ".join(report.files)}: SHA-256 {report.checksum}')
    if args.json:
        print_json({'bags': reports})
    return code


def look_at(report: BagReport, arm: Arm | None) -> Sequence[Finding]:
    """Let the doctor look at a bag; without an arm it sees samples and stamps alone."""
    if report.recording is None or report.plan is None:
        return ()
    recording, timing = retimed(report.recording)
    if arm is not None:
        return examine(arm, recording, timing).findings
    return look_at_samples(recording, report.plan.joints, report.plan.gauges, timing)[1]


def _range(channel: ChannelReport | None) -> str:
    if channel is None:
        return ''
    if channel.minimum is None or channel.maximum is None:
        return 'no number'
    return f'{channel.minimum:.4g} .. {channel.maximum:.4g}'


def _channel_table(topic: TopicReport) -> Table:
    fields = ', '.join(topic.fields) or 'no values'
    table = new_table(f'{printable(topic.name)}: {printable(fields)}', names=(
        'name', *(f'{printable(what)} range' for what in topic.fields)), figures=('NaN',))
    for name in topic.names:
        found = {channel.field: channel for channel in topic.channels if channel.name == name}
        bad = sum(channel.not_finite for channel in found.values())
        table.add_row(printable(name), *(_range(found.get(what)) for what in topic.fields),
                      str(bad))
    return table


def show(report: BagReport, console: Console, findings: Sequence[Finding] = ()) -> None:
    """Print a report."""
    start = ''
    if report.start is not None and report.start > REAL_TIME:
        moment = datetime.fromtimestamp(report.start, tz=timezone.utc)
        start = f', recorded {moment:%Y-%m-%d %H:%M:%S} UTC'
    payload = '' if report.payload is None else f', payload {report.payload:g} kg'
    console.print(Text(printable(report.path), style='bold'))
    console.print(f'{report.storage}, {len(report.files)} file(s), {report.size / 1e6:.3g} MB, '
                  f'{report.duration:.4g} s{start}{payload}')
    usable = report.effort_model or report.strain_model
    say_verdict(Grade.GOOD if usable else Grade.DO_NOT_USE, f'use: {report.verdict}')
    for text in report.odd:
        say_verdict(Grade.USABLE, f'odd: {text}')
    print_findings(findings)
    console.print()
    table = new_table('', names=('topic\n  type', 'clock'), figures=(
        'messages', 'rate\n[Hz]', 'jitter\n[ms]', 'gaps', 'double\n/ back'))
    for topic in report.topics:
        rate = '' if topic.rate is None else f'{topic.rate:.4g}'
        jitter = '' if topic.jitter is None else f'{topic.jitter * 1e3:.3g}'
        gaps = f'{topic.gaps} ({topic.longest_gap:.3g} s)' if topic.gaps else '0'
        table.add_row(f'{printable(topic.name)}\n  {printable(topic.type.replace("/msg/", "/"))}',
                      topic.clock, str(topic.count), rate, jitter, gaps,
                      f'{topic.duplicates} / {topic.backward}')
    print_table(table)
    for topic in report.topics:
        if topic.names:
            console.print()
            print_table(_channel_table(topic))
    console.print()
