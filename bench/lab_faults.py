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
What `tudor info` says of recordings with faults that laboratories make, and of good ones.

The faults stand in `lab_faults/faults.py`, written from what goes wrong with recordings of arms
and not from the checks; each is put into every recording in which it can show (`lab_faults/lab.py`
says when), at the first joint or gauge, in an order drawn by the seed, where it does. Bags are cut
to 60 seconds. An answer is

right        a finding with a key that the fault lists, at the right joint; `+` if there are others
unexplained  a finding that names no cause
wrong        another finding
silent       none

Findings that a good recording has as well count there, as clean, and not again. A fault that the
reader refuses counts as right where the refusal says it. Clean: each recording, whole, cut 60/40
and 40/60, and in thirds, must have no finding that blames the arm's description or the wiring.

Recordings are those of TUDOR_SHARED_DATA where it is set, those of bags/, and simulated ones. With
--json the cases are kept in a file, and those that are in it are not run again.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from itertools import chain
import json
import os
from pathlib import Path
import re
import sys
import tempfile
import time
from typing import Any
import warnings
import zlib

from lab_faults.faults import Fault, FAULTS
from lab_faults.lab import CannotShowError, explain, GROWTH, growth, Lab, read_lab
import numpy as np
import tables
from tudor_dynamics.cli.main import main as tudor

ROOT = Path(__file__).parent.parent
SECONDS = 60.0
UNEXPLAINED = 'unexplained'
FACTS = {'standstill', 'jitter', 'load_unknown', 'same_recording', 'constant', 'outlier',
         'saturated', 'drift', 'standing', 'rings', UNEXPLAINED}
"""What a good recording may have: facts about it that blame neither description nor wiring."""
NEUTRAL = {'standstill', 'load_unknown', 'same_recording', 'rings'}
"""What is no cause of anything."""
KEYS_OF_NOTES = {
    r'look like degrees': 'degrees',
    r'velocity of .* opposite sign': 'velocity_sign',
    r'velocity of .* times the derivative': 'velocity_scale',
    r'velocity of .* does not follow': 'velocity_unlike',
    r'velocity of .* is always zero': 'velocity_zeros',
    r'does not move|no joint moves': 'standing',
    r'beyond|check the units|in rad, not in degrees': 'degrees',
    r'clock|set back': 'clock_set_back',
    r'\bgaps?\b|stretches': 'gaps'}
"""What the reader says, and the key that this is an answer by."""
CUTS = {'whole': (0.0, 1.0), '60': (0.0, 0.6), '/40': (0.6, 1.0), '40': (0.0, 0.4),
        '/60': (0.4, 1.0), 'third 1': (0.0, 1 / 3), 'third 2': (1 / 3, 2 / 3),
        'third 3': (2 / 3, 1.0)}
ANSWERS = ('right', 'right +', UNEXPLAINED, 'wrong', 'silent')
TRIES = 4
"""Joints or gauges that a fault is tried at until it shows."""
ALIKE = {'arm_200g_free_3', 'arm_200g_free_4', 'two_blade_train_2', 'emps_validation'}
"""Recordings of the same arm, load and kind of motion as others: faults go into the others."""
BOUNDS = {'named': 0.90, 'wrong': 0.02, 'silent': 0.05}


# -- Recordings

def shared_bags(data: Path) -> Iterator[tuple[str, Path, Any]]:
    """Go through the shared recordings and their descriptions."""
    arms, bags = data / 'arms', data / 'bags'
    config = ROOT / 'config'
    fer = {'name': 'fer', 'kinematics': {'urdf': str(arms / 'fer.urdf')}, 'joints': [
        {'name': f'fer_joint{k}', 'effort': {'topic': 'joint_states', 'unit': 'N m'}}
        for k in range(1, 8)]}
    described = {
        'airbot_chirp': arms / 'airbot.yaml', 'airbot_chirp_loaded': arms / 'airbot.yaml',
        'airbot_trapezoidal': arms / 'airbot.yaml', 'panda_fer_exciting': fer,
        'emps_estimation': config / 'emps.yaml', 'emps_validation': config / 'emps.yaml',
        'quanser_hinf': arms / 'quanser.yaml', 'quanser_lqg': arms / 'quanser.yaml',
        'tx40_exciting': arms / 'tx40.yaml', 'ur10_exciting': config / 'ur10.yaml',
        'ur10e_unloaded': arms / 'ur10e.yaml', 'ur10e_loaded': arms / 'ur10e.yaml',
        'ur10e_pushes': arms / 'ur10e.yaml'}
    for bag in sorted(bags.glob('arm_*')):
        described[bag.name] = config / 'two_blade_arm.yaml'
    for name, description in sorted(described.items()):
        if isinstance(description, Path) and name.startswith(('quanser', 'tx40')):
            description = amended(description)
        yield name, bags / name, description


def beam_bags(data: Path) -> Iterator[tuple[str, Path, Any]]:
    """Go through recordings of an arm whose tool rings: good ones that take long."""
    for bag in sorted((data / 'bags').glob('beam_*')):
        yield bag.name, bag, data / 'arms/panda.yaml'


def amended(description: Path) -> dict[str, Any]:
    """Complete the first tries of descriptions by what is known of these arms."""
    import yaml

    content = yaml.safe_load(description.read_text())
    kinematics = content['kinematics']
    if 'urdf' in kinematics:
        kinematics['urdf'] = str((description.parent / kinematics['urdf']).absolute())
    if content['name'] == 'tx40':
        content['couplings'] = {'pairs': [{'motor': 'joint_6', 'joint': 'joint_5', 'ratio': 1}]}
    else:  # one gauge was recorded, and the second stage stands
        content['gauges'] = content['gauges'][:1]
    return content


def own_bags(folder: Path, wanted: Callable[[str], bool]) -> Iterator[tuple[str, Path, Any]]:
    """Go through the bags of the repository and some of the simulated arm."""
    for bag in sorted((ROOT / 'bags').glob('two_blade_*')):
        yield bag.name, bag, ROOT / 'config/two_blade_arm.yaml'
    for bag in sorted((ROOT / 'bags').glob('tudor_*')):
        yield bag.name, bag / 'stimulus_01', ROOT / 'config/tudor.yaml'
    for kilograms, seed in ((0.0, 31), (0.4, 32)):
        out = folder / f'simulated_{kilograms:g}'
        if wanted(out.name):
            spoken('record', '--arm', ROOT / 'config/tudor.yaml', '--payload', kilograms,
                   '--stimuli', 1, '--seconds', SECONDS, '--seed', seed, '--jobs', 1,
                   '--out', out)
        yield out.name, out / 'stimulus_01', ROOT / 'config/tudor.yaml'


def by_faults(name: str) -> bool:
    """Say whether faults are put in: not where a beam rings, nor into more of the same motion."""
    return not name.startswith('beam_') and name not in ALIKE


# -- What the command says

def spoken(*words: object) -> tuple[int, str, str]:
    """Run tudor; exit code and what it prints."""
    out, err = StringIO(), StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = tudor([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def named_in(lab: Lab, text: str) -> list[str]:
    """Find joints and gauges in a text."""
    return [name for name in (*lab.joints, *lab.gauges)
            if re.search(rf'(?<![\w]){re.escape(name)}(?![\w])', text)]


def answers(lab: Lab, through: str) -> list[dict[str, Any]]:
    """Write a bag and give what the command says of it: findings, and notes of the reader."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bag, description = lab.write(folder)
        words = ['info', bag, '--arm', description, '--json']
        if through == 'fit':
            words = ['fit', bag, '--arm', description, '--json', '--exit-zero', '--out',
                     folder / 'model']
        code, out, err = spoken(*words)
        refused = code not in (0, 1)
        notes = [err] if refused else []
        findings, gaps = [], 0
        if not refused:  # `info` says in its verdict why the reader refuses a bag
            content = json.loads(out)
            if through == 'info':
                content, = content['bags']
                notes += content['odd']
                if str(content['verdict']).startswith('nothing'):
                    refused, notes = True, [content['verdict'], *notes]
                gaps = max(topic['gaps'] or 0 for topic in content['topics'])
            findings = content['findings']
    found = [{'kind': item['kind'], 'channels': item.get('channels') or named_in(
        lab, item['what']), 'what': item['what'], 'size': item.get('size')} for item in findings]
    for place, text in enumerate(notes):
        key = next((key for words, key in KEYS_OF_NOTES.items() if re.search(words, text)),
                   'note' if place or not refused else 'crash' if code == 70 else 'refused')
        found.append({'kind': key, 'channels': named_in(lab, text), 'what': text.strip(),
                      'note': bool(place) or not refused})
    if gaps:
        found.append({'kind': 'gaps', 'channels': [], 'what': f'{gaps} gaps', 'note': True})
    return found


def judge(
    found: Sequence[dict[str, Any]], clean: Sequence[dict[str, Any]], right: set[str],
    target: set[str],
) -> tuple[str, list[dict[str, Any]], list[dict[str, Any]]]:
    """Give the answer's class, the findings that are right, and the others that are new."""
    before = {(item['kind'], tuple(sorted(item['channels']))) for item in clean}
    texts = {item['what'] for item in clean}
    good = [item for item in found if item['kind'] in right and item['what'] not in texts
            and (not target or not item['channels'] or target & set(item['channels']))]
    other = [item for item in found if item not in good and not item.get('note')
             and item['kind'] not in NEUTRAL | {UNEXPLAINED}
             and (item['kind'], tuple(sorted(item['channels']))) not in before]
    if good:
        return ('right +' if other else 'right'), good, other
    if other:
        return 'wrong', good, other
    if any(item['kind'] == UNEXPLAINED and item['what'] not in texts for item in found):
        return UNEXPLAINED, good, other
    return 'silent', good, other


# -- Cases

def columns_of(fault: Fault, lab: Lab) -> tuple[list[int], Sequence[str]]:
    """Give the columns that a fault can be put into, and their names."""
    if not lab.moving:
        raise CannotShowError('no joint moves')
    if fault.on == 'bag':
        return [0], ()
    if fault.on == 'gauge':
        if lab.strain is None:
            raise CannotShowError('no gauge')
        return list(range(len(lab.gauges))), lab.gauges
    if fault.on == 'effort' and lab.effort is None:
        raise CannotShowError('no effort')
    return list(lab.moving), lab.joints


def inject(fault: Fault, lab: Lab, size: float, random: np.random.Generator) -> tuple[
        Lab, int, set[str], set[str], float]:
    """Put a fault in where it can show: the recording, column, names, right keys, growth."""
    columns, names = columns_of(fault, lab)
    reason = ''
    for column in random.permutation(columns).tolist()[:TRIES]:
        try:
            faulty = fault.make(lab, column, size, random)
        except CannotShowError as err:
            reason = str(err)
            continue
        grown = float('nan')
        if fault.model(lab, column):
            left = explain(faulty)
            grown = growth(lab.explained, left)
            if grown < GROWTH:
                reason = 'parameters of rigid bodies take it up'
                continue
        right = set(fault.right) | fault.also(lab, column)
        for key, undo in fault.twins.items():
            if lab.effort is not None and growth(
                    lab.explained, explain(undo(faulty, column, size, random))) < 1.1:
                right.add(key)
        return faulty, column, {names[column]} if names else set(), right, grown
    raise CannotShowError(reason)


def run_case(fault: Fault, lab: Lab, clean: list[dict[str, Any]], size: float, seed: int,
             through: str) -> dict[str, Any]:
    """Put a fault in and judge what is said."""
    random = np.random.default_rng(
        [seed, zlib.crc32(f'{fault.name} {size:g} {lab.name}'.encode())])
    case: dict[str, Any] = {'fault': fault.name, 'size': size, 'bag': lab.name}
    try:
        faulty, _, target, right, grown = inject(fault, lab, size, random)
    except CannotShowError as err:
        return case | {'answer': 'skipped', 'why': str(err)}
    found = answers(faulty, through)
    answer, good, other = judge(found, clean, right, target)
    return case | {'answer': answer, 'target': sorted(target), 'right': good, 'other': other,
                   'growth': None if np.isnan(grown) else round(grown, 2),
                   'notes': [item['what'] for item in found if item.get('note')
                             and item not in good]}


def drawn(fault: Fault, bag: str, seed: int) -> float:
    """Draw one of a fault's sizes for a bag."""
    return fault.sizes[zlib.crc32(f'{seed} {bag} {fault.name}'.encode()) % len(fault.sizes)]


def clean_cases(lab: Lab, through: str) -> Iterator[dict[str, Any]]:
    """Look at a good recording and at its parts."""
    for cut, (begin, end) in CUTS.items():
        found = answers(lab.part(begin, end), through)
        false = [item for item in found if not item.get('note') and item['kind'] not in FACTS]
        yield {'fault': '', 'bag': lab.name, 'cut': cut, 'found': found, 'false': false}


def keep(cases: list[dict[str, Any]], path: Path | None, run: str) -> None:
    """Write what is known, after every fault, so that a run that is ended can go on."""
    for case in cases:
        case.setdefault('run', run)
    if path is not None:
        scratch = path.with_name(path.name + '.part')
        scratch.write_text(json.dumps(cases, indent=1, default=float))
        scratch.replace(path)


def run_all(args: argparse.Namespace, folder: Path) -> list[dict[str, Any]]:
    """Run all cases that are asked for and not known."""
    cases: list[dict[str, Any]] = []
    asked = f'{args.through} {args.seed}'
    if args.json is not None and args.json.exists():
        cases = json.loads(args.json.read_text())
        if any(case.get('run', asked) != asked for case in cases):
            sys.exit(f'{args.json}: keeps cases of another --seed or --through; name another file')
    known = {(case['fault'], case.get('size'), case['bag'], case.get('cut')) for case in cases}
    data = os.environ.get('TUDOR_SHARED_DATA')

    def wanted(name: str) -> bool:
        return not args.bags or any(word in name for word in args.bags)
    bags = chain(shared_bags(Path(data)) if data else (), own_bags(folder, wanted),
                 beam_bags(Path(data)) if data else ())
    begun = time.perf_counter()
    for name, bag, description in bags:
        if not wanted(name) or args.only and not by_faults(name):
            continue
        lab = read_lab(name, bag, description, folder, SECONDS)
        if ('', None, name, 'whole') not in known:
            cases += clean_cases(lab, args.through)
            keep(cases, args.json, asked)
        clean = next(case['found'] for case in cases
                     if case['bag'] == name and case.get('cut') == 'whole')
        for fault in FAULTS if by_faults(name) else ():
            if args.only and not any(word in fault.name for word in args.only):
                continue
            for size in fault.sizes if args.sizes else (drawn(fault, name, args.seed),):
                if (fault.name, size, name, None) not in known:
                    cases.append(run_case(fault, lab, clean, size, args.seed, args.through))
            keep(cases, args.json, asked)
        print(f'{time.perf_counter() - begun:6.0f} s  {name}', file=sys.stderr, flush=True)
    return cases


# -- What is printed

def show(cases: list[dict[str, Any]]) -> bool:
    """Print the table, what is silent or wrong, and the totals; say whether bounds are kept."""
    injected = [case for case in cases if case['fault'] and case['answer'] != 'skipped']
    rows: dict[str, Counter[str]] = defaultdict(Counter)
    for case in cases:
        if case['fault']:
            rows[f'{case["fault"]} {case["size"]:.3g}'][case['answer']] += 1
    print(f'{"fault, size":54}' + ''.join(f'{name:>13}' for name in (*ANSWERS, 'skipped')))
    for name, row in rows.items():
        print(f'{name:54}' + ''.join(f'{row[answer] or ".":>13}' for answer in (
            *ANSWERS, 'skipped')))
    merged: dict[str, Counter[str]] = defaultdict(Counter)
    for case in injected:
        for name in (case['fault'], 'all together'):
            merged[name][case['answer']] += 1
    tables.show(('put in', 'named', 'unexplained', 'wrong', 'silent'), [
        (name, *(count or '' for count in (row['right'] + row['right +'], row[UNEXPLAINED],
                                           row['wrong'], row['silent'])))
        for name, row in sorted(merged.items(), key=lambda item: item[0] == 'all together')])
    print('\nwrong or more than right: fault, size, bag, joint: finding')
    for case in injected:
        for item in case['other']:
            print(f'  {case["answer"]}: {case["fault"]} {case["size"]:.3g}, {case["bag"]}, '
                  f'{", ".join(case["target"])}: {item["kind"]}: {item["what"]}')
    print('\nsilent: fault, size: bags (growth of the residual)')
    silent: dict[str, list[str]] = defaultdict(list)
    for case in injected:
        if case['answer'] == 'silent':
            grown = f' ({case["growth"]:g})' if case['growth'] else ''
            silent[f'{case["fault"]} {case["size"]:.3g}'].append(f'{case["bag"]}{grown}')
    for name, bags in silent.items():
        print(f'  {name}: {", ".join(bags)}')
    clean = [case for case in cases if not case['fault']]
    print('\nclean: structural findings')
    for case in clean:
        for item in case['false']:
            print(f'  {case["bag"]} {case["cut"]}: {item["kind"]}: {item["what"]}')
    counts, total = Counter(case['answer'] for case in injected), max(1, len(injected))
    named = counts['right'] + counts['right +'] + counts[UNEXPLAINED]
    kept = (named >= BOUNDS['named'] * total and counts['wrong'] <= BOUNDS['wrong'] * total
            and counts['silent'] < BOUNDS['silent'] * total
            and not any(case['false'] for case in clean))
    print(f'\n{len(injected)} faults in {len({case["bag"] for case in injected})} recordings: '
          f'right {counts["right"]}, right and more {counts["right +"]}, unexplained '
          f'{counts[UNEXPLAINED]}: {100 * named / total:.1f} % (bound: 90 or more)\n'
          f'wrong {100 * counts["wrong"] / total:.1f} % ({counts["wrong"]}; at most 2), silent '
          f'{100 * counts["silent"] / total:.1f} % ({counts["silent"]}; below 5)\n'
          f'{len(clean)} good recordings and parts: {sum(bool(case["false"]) for case in clean)} '
          'with a structural finding (none)')
    return kept


def main() -> int:
    """Run all, print, and say whether the bounds are kept."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--only', nargs='+', metavar='WORD', help='faults with it in their names')
    parser.add_argument('--bags', nargs='+', metavar='WORD', help='bags with it in their names')
    parser.add_argument('--json', type=Path, metavar='FILE', help='keeps the cases')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--sizes', action='store_true',
                        help='each fault in all its sizes; otherwise one for each bag, drawn')
    parser.add_argument('--through', choices=('info', 'fit'), default='info',
                        help='command that is asked')
    parser.add_argument('--list', action='store_true', help='list the faults and their keys')
    args = parser.parse_args()
    if args.list:
        for fault in FAULTS:
            print(f'{fault.name} ({", ".join(f"{size:g}" for size in fault.sizes)}): '
                  f'{", ".join(sorted(fault.right))}')
        return 0
    warnings.simplefilter('ignore')
    with tempfile.TemporaryDirectory() as folder:
        cases = run_all(args, Path(folder))
    return 0 if show(cases) else 1


if __name__ == '__main__':
    sys.exit(main())
