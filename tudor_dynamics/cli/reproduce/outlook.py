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

"""``tudor reproduce outlook``: what the first paper names as its outlook, part by part."""

from __future__ import annotations

import argparse
from pathlib import Path
import time

from tudor_dynamics.cli.console import finite, new_table, print_json, print_table
from tudor_dynamics.cli.reproduce.campaign_options import opened
from tudor_dynamics.errors import UsageError
from tudor_dynamics.reproduction.outlook.page import content, write_outlook
from tudor_dynamics.reproduction.outlook.part import compute_of, Section, Setting
from tudor_dynamics.reproduction.outlook.parts import PARTS

MET = {True: 'yes', False: 'no', None: '-'}


def run(args: argparse.Namespace) -> int:
    """Compute the parts that are asked for, print what they reach, and write the page."""
    begun = time.perf_counter()
    out = Path(args.out)
    data = None if args.data is None else Path(args.data)
    if data is not None and not data.is_dir():
        msg = f'--data {data}: is no directory; give one that has bags/NAME and arms/NAME.yaml'
        raise UsageError(msg)
    names = list(dict.fromkeys(args.only or PARTS))
    with opened(args) as campaign:
        sections = {}
        for name in names:
            setting = Setting(name, campaign, args.quick, data)
            sections[name] = compute_of(name)(setting)
            setting.progress('done', 1.0)
        files = write_outlook(sections, campaign.arm.name, out)
    seconds = time.perf_counter() - begun
    if args.json:
        print_json(finite({'out': str(out), 'seconds': round(seconds, 1), **content(sections)}))
        return 0
    for name, section in sections.items():
        _print(PARTS[name], section)
    if args.quick:
        print('--quick: too little of everything for what must be reached')
    print(f'{seconds:.0f} s; {", ".join(str(file) for file in files)}')
    return 0


def _print(title: str, section: Section) -> None:
    table = new_table(title, names=('what', 'must reach', 'reached', ''), figures=())
    for floor in section.floors:
        table.add_row(floor.what, floor.wanted, floor.reached, MET[floor.met])
    print_table(table)
