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

"""
Faults put into clean bags: does the doctor name them, with place and size, and nothing else.

Each row of the table of faults goes into every clean bag that it fits, by a seed. Thresholds were
chosen on some robots; the others are the proof.

    python bench/doctor.py
    python bench/doctor.py --own --json
    python bench/doctor.py --only effort_late --missed
    python bench/doctor.py --clean-parts
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
import importlib
import json
from pathlib import Path
import sys
import time
import warnings

sys.path.append(str(Path(__file__).parent))

from faults.clean import clean_bags, more_bags, parts_of, pieces, STANDS_STILL  # noqa: E402
from faults.descriptions import of_descriptions, one_joint_of_many  # noqa: E402
from faults.drives import of_drives  # noqa: E402
from faults.sets import of_loads, of_sets  # noqa: E402
from faults.signals import of_channels, of_time, of_units_and_names, still_ends  # noqa: E402
import numpy as np  # noqa: E402

from tudor_dynamics.cli.console import add_running  # noqa: E402
from tudor_dynamics.errors import TudorWarning  # noqa: E402
from tudor_dynamics.identification.doctor.between import examine_bags  # noqa: E402
from tudor_dynamics.identification.doctor.findings import CHECKS  # noqa: E402
from tudor_dynamics.parallel import in_processes, on_cluster  # noqa: E402

NOTHING = 'nothing'
LEAST_NAMED, MOST_FALSE = 0.95, 0.01


@dataclass
class Row:
    """How often a fault was put in, named, placed and sized."""

    put_in: int = 0
    named: int = 0
    placed: int = 0
    sized: int = 0
    others: Counter = field(default_factory=Counter)

    def __add__(self, other):
        return Row(self.put_in + other.put_in, self.named + other.named,
                   self.placed + other.placed, self.sized + other.sized,
                   self.others + other.others)


def told(bag, findings):
    """Leave out what is true of a recording as it was published."""
    return [item for item in findings
            if not (item.kind == 'standstill' and bag.name in STANDS_STILL)]


class Study:
    """All faults with what the doctor said of them."""

    def __init__(self, missed):
        self.rows = {True: {}, False: {}}
        self.clean = {True: Counter(), False: Counter()}
        self.false = {True: [], False: []}
        self.seconds = []
        self.missed = missed

    def examine(self, arm, bags):
        """Ask the doctor, and note how long it took."""
        begun = time.process_time()
        found = examine_bags(arm, bags)
        self.seconds.append((time.process_time() - begun) / len(bags))
        return found

    def judge(self, bag, fault, findings):
        """Compare what was said with what was put in."""
        row = self.rows[bag.proof].setdefault(fault.row, Row())
        said = told(bag, findings) if fault.row != 'standstill' else findings
        row.put_in += 1
        row.named += any(fault.named_by(item) for item in said)
        row.placed += any(fault.placed_by(item) for item in said)
        right = any(fault.sized_by(item) for item in said)
        row.sized += right
        # what follows from the fault itself is no other finding
        other = sorted({item.kind for item in said if not fault.named_by(item)})
        row.others.update(other if other or row.named else [NOTHING])
        if self.missed and not right:
            print(f'missed: {fault.row} in {bag.name}, {fault.channels} {fault.time} '
                  f'{fault.size}: ' + '; '.join(str(item) for item in said), file=sys.stderr)

    def add(self, other):
        """Add what was found in other bags."""
        for part in (True, False):
            for kind, row in other.rows[part].items():
                self.rows[part][kind] = self.rows[part].get(kind, Row()) + row
            self.clean[part] += other.clean[part]
            self.false[part] += other.false[part]
        self.seconds += other.seconds

    def spare(self, bag, name, findings):
        """Count what is said of a clean bag."""
        said = told(bag, findings)
        self.clean[bag.proof]['bags'] += 1
        self.clean[bag.proof]['with findings'] += bool(said)
        self.false[bag.proof] += [f'{name}: {item}' for item in said]


def study(args):
    """Put every fault into every bag that it fits, a bag to each process."""
    count = len(chosen_bags(args))
    pieces_of_work = [(str(Path(__file__).parent), args, number) for number in range(count + 1)]
    with on_cluster(args.cluster):
        found = in_processes(in_worker, pieces_of_work, args.jobs)
    for more in found[1:]:
        found[0].add(more)
    return found[0]


def in_worker(piece, count):
    """Do the work of one bag where this file need not be on the path."""
    folder, args, number = piece
    sys.path.append(folder)
    done = importlib.import_module('doctor').part_of_study(args, number)
    count(1)
    return done


def chosen_bags(args):
    """Give the clean bags that are asked for."""
    return [bag for bag in read_bags(args.own) if args.bags is None or bag.name in args.bags]


@lru_cache
def read_bags(own):
    """Read the clean bags, once in each process."""
    return clean_bags(own)


def part_of_study(args, number):
    """Put faults into one bag; after the last bag, those that need several."""
    found = Study(args.missed)
    bags = chosen_bags(args)
    rng = np.random.default_rng([args.seed, number])
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        if number < len(bags):
            in_one_bag(found, args, bags[number], rng)
        else:
            in_several_bags(found, args, bags, rng)
    return found


def in_one_bag(found, args, bag, rng):
    """Examine a bag as it is, and with each fault that it fits."""
    for piece in pieces(bag):
        found.spare(bag, str(piece.data.choice), found.examine(bag.arm, [piece.data]))
    for source in (of_descriptions, one_joint_of_many, of_units_and_names, of_drives, of_time,
                   of_channels, still_ends):
        for fault in source(bag, rng):
            if args.only in (None, fault.row):
                found.judge(bag, fault, found.examine(fault.arm, fault.bags))


def in_several_bags(found, args, bags, rng):
    """Examine bags beside each other, and loads beside models."""
    for bag, fault in of_sets(bags, rng):
        if args.only in (None, fault.row):
            found.judge(bag, fault, found.examine(fault.arm, fault.bags))
    if args.only in (None, 'load_unknown'):
        for bag, fault, findings in of_loads(bags):
            if fault is None:
                found.spare(bag, f'{bag.name} beside a model', findings)
            else:
                found.judge(bag, fault, findings)


def summary(found):
    """Give the figures of the study as plain values."""
    content = {}
    for name, parts in (('developed on', [False]), ('proof', [True]), ('all', [False, True])):
        rows = {}
        for kind in CHECKS:
            some = [found.rows[part][kind] for part in parts if kind in found.rows[part]]
            if some:
                row = sum(some[1:], some[0])
                rows[kind] = {'put_in': row.put_in, 'named': row.named, 'placed': row.placed,
                              'sized': row.sized, 'also_said': dict(row.others)}
        put_in = sum(row['put_in'] for row in rows.values())
        clean = sum((found.clean[part] for part in parts), Counter())
        false = sum((found.false[part] for part in parts), [])
        content[name] = {
            'rows': rows, 'put_in': put_in,
            **{what: sum(row[what] for row in rows.values()) / max(put_in, 1)
               for what in ('named', 'placed', 'sized')},
            'clean': clean['bags'], 'clean_with_findings': clean['with findings'],
            'false': false,
            'false_rate': len(false) / max(1, clean['bags'] * len(CHECKS))}
    content['seconds_a_bag'] = {'median': float(np.median(found.seconds)),
                                'largest': float(np.max(found.seconds))}
    return content


def table(content):
    """Give the confusion matrix as the document has it."""
    yield '| put in | n | named | with place | with size | also said |'
    yield '|---|---|---|---|---|---|'
    for kind, row in content['all']['rows'].items():
        others = ', '.join(f'`{name}` {count}' for name, count in row['also_said'].items())
        yield (f'| `{kind}` | {row["put_in"]} | {row["named"]} | {row["placed"]} | '
               f'{row["sized"]} | {others} |')


def show(content):
    """Print the confusion matrix."""
    for line in table(content):
        print(line)
    print()
    for name in ('developed on', 'proof', 'all'):
        part = content[name]
        print(f'{name}: {part["put_in"]} faults, named {100 * part["named"]:.1f} %, with place '
              f'{100 * part["placed"]:.1f} %, with size {100 * part["sized"]:.1f} %; '
              f'{part["clean"]} clean bags and halves, {part["clean_with_findings"]} with '
              f'findings, {100 * part["false_rate"]:.2f} % of all checks')
    for text in content['all']['false']:
        print(f'false: {text}')
    seconds = content['seconds_a_bag']
    print(f'{seconds["median"]:.2f} s a bag, {seconds["largest"]:.2f} s at most')


def clean_parts(args):
    """Say what is found in all recordings without faults, whole and in parts; 1 if anything is."""
    count, false = 0, []
    bags = [*clean_bags(args.own), *([] if args.own else more_bags())]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', TudorWarning)
        for bag in bags:
            if args.bags is not None and bag.name not in args.bags:
                continue
            for piece in parts_of(bag):
                count += 1
                false += [f'{piece.data.choice}: {item.kind}: {item}' for item in examine_bags(
                    bag.arm, [piece.data]) if item.kind != 'standstill']
    for text in false:
        print(f'false: {text}')
    print(f'{count} recordings and parts, {len(false)} false findings')
    return int(bool(false))


def main():
    """Run the study; 1 where too little is named or too much is said."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--own', action='store_true', help='bags of the repository only')
    parser.add_argument('--bags', nargs='+', metavar='NAME', help='these bags only')
    parser.add_argument('--only', choices=tuple(CHECKS), help='one row of the table')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--missed', action='store_true', help='say what was missed')
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--clean-parts', action='store_true',
                        help='all recordings without faults, whole and in parts')
    add_running(parser)
    args = parser.parse_args()
    if args.clean_parts:
        return clean_parts(args)
    content = summary(study(args))
    if args.json:
        print(json.dumps(content, indent=2))
    else:
        show(content)
    done = content['all']
    return int(done['sized'] < LEAST_NAMED or done['clean_with_findings']
               > MOST_FALSE * max(done['clean'], 1))


if __name__ == '__main__':
    sys.exit(main())
