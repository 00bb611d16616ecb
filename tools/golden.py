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
Record what the package does, and compare two records: numbers bit for bit.

    python tools/golden.py record OUT [--root DIR] [--quick] [--only NAME ...]
    python tools/golden.py compare A B [--tolerance 1e-9] [--only NAME ...]
    python tools/golden.py check REV [--quick] [--only NAME ...] [--tolerance 1e-9]
    python tools/golden.py list

A record is a folder: ``about.json``, and for each case a JSON file with values and texts and an
NPZ file with arrays. ``check`` records a commit and the working tree and compares them; the record
of a commit is kept in ``build/golden``.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from fnmatch import fnmatch
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
from typing import Any

from golden_cases import Case, ordered, read_table, write_inputs
from golden_files import digest, dropped, of_folder, of_text, Values
import numpy as np

HERE = Path(__file__).resolve().parent
LONGEST = 600.0
"""Seconds after which a command is ended."""
SHOWN = 6
"""Differences of a case that are printed."""
CHECKSUM = re.compile(r'(?<![\w.])(?=[0-9]*[a-f])[0-9a-f]{12,64}\b')
"""Compared bit for bit alone: with a tolerance, what it was made of may differ."""
NUMBER = re.compile(r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?')


def environment(root: Path) -> dict[str, str]:
    """Give an environment in which the package of ``root`` runs, the same on each machine."""
    own = {'PYTHONPATH': str(root), 'COLUMNS': '160', 'NO_COLOR': '1', 'TZ': 'UTC',
           'LC_ALL': 'C.UTF-8', 'LOKY_MAX_CPU_COUNT': '1', 'MPLBACKEND': 'Agg',
           'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'RCUTILS_COLORIZED_OUTPUT': '0'}
    own.update(dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'), '1'))
    kept = {key: value for key, value in os.environ.items() if not key.startswith('TUDOR_')}
    return {**kept, **own}


def run_case(case: Case, root: Path, work: Path) -> Values:
    """Run a case and give all that came of it."""
    (work / case.name).mkdir(parents=True)
    start = ['-m', 'tudor_dynamics', *case.arguments]
    if case.arguments[:1] == ('!',):
        start = [str(HERE / 'golden_objects.py'), case.name, *case.arguments[1:]]
    run = subprocess.run([sys.executable, *start], cwd=work, env=environment(root),
                         stdin=subprocess.DEVNULL, capture_output=True, timeout=LONGEST)
    found: Values = {'exit code': run.returncode}
    for name, data in (('stdout', run.stdout), ('stderr', run.stderr)):
        text = data.decode('utf-8', 'replace').replace(str(root), 'ROOT')
        found.update((f'{name}:{key}', value) for key, value in of_text(text).items())
    return {**found, **of_folder(work / case.name)}


def save_case(folder: Path, name: str, values: Values) -> None:
    """Write the values of a case."""
    file = folder / f'{name}.json'
    file.parent.mkdir(parents=True, exist_ok=True)
    arrays: Values = {
        key: value for key, value in values.items() if isinstance(value, np.ndarray)}
    texts = {key: {'dtype': str(value.dtype), 'shape': value.shape,
                   'sha256': digest(np.ascontiguousarray(value).tobytes())}
             if key in arrays else value for key, value in values.items()}
    file.write_text(json.dumps(texts, indent=1) + '\n', encoding='utf-8')
    if arrays:
        np.savez_compressed(file.with_suffix('.npz'), **{
            str(place): value for place, value in enumerate(arrays.values())})


def load_case(folder: Path, name: str) -> Values:
    """Read the values of a case that are compared."""
    values: Values = json.loads((folder / f'{name}.json').read_text(encoding='utf-8'))
    keys = [key for key, value in values.items() if isinstance(value, dict)]
    if keys:
        with np.load(folder / f'{name}.npz', allow_pickle=False) as file:
            values.update({key: file[str(place)] for place, key in enumerate(keys)})
    return {key: value for key, value in values.items() if not dropped(key)}


def record(out: Path, root: Path, cases: list[Case]) -> None:
    """Run cases in a folder of their own, one after the other; a record of that tree grows."""
    about = out / 'about.json'
    commit = commit_of(root)
    seconds: dict[str, float] = {}
    if about.exists():
        before = json.loads(about.read_text())
        if before['commit'] != commit or commit.endswith('+'):
            sys.exit(f'{out}: is a record of {before["commit"]}; expected {commit}, or a new name')
        seconds = before['seconds']
    out.mkdir(parents=True, exist_ok=True)
    place = subprocess.run(
        [sys.executable, '-c', 'import tudor_dynamics; print(tudor_dynamics.__file__)'],
        cwd=out, env=environment(root), capture_output=True, text=True, check=True).stdout
    if not Path(place).is_relative_to(root):
        sys.exit(f'{root}: the package is taken from {place.strip()}; expected it in that folder')
    with tempfile.TemporaryDirectory(prefix='golden_') as name:
        work = Path(name).resolve()
        for folder in ('bags', 'config'):
            shutil.copytree(root / folder, work / folder)
        write_inputs(work / 'inputs')
        for case in cases:
            begun = os.times()
            values = run_case(case, root, work)
            ended = os.times()
            seconds[case.name] = round(sum(ended[2:4]) - sum(begun[2:4]), 2)
            save_case(out, case.name, values)
            print(f'{case.name:28} {seconds[case.name]:6.1f} s  exit {values["exit code"]}  '
                  f'{len(values)} values', flush=True)
    about.write_text(json.dumps(
        {'commit': commit, 'python': sys.version.split()[0], 'numpy': np.__version__,
         'seconds': seconds, 'cases': list(seconds)}, indent=1) + '\n')
    took = sum(seconds[case.name] for case in cases)
    print(f'{out}: {len(cases)} cases in {took:.0f} s of one core')


def commit_of(root: Path) -> str:
    """Name the commit of a tree, with a + where something is changed."""
    def git(*words: str) -> str:
        return subprocess.run(['git', '-C', str(root), *words], capture_output=True,
                              text=True).stdout.strip()
    return git('rev-parse', 'HEAD') + '+' * bool(
        git('status', '--porcelain', 'tudor_dynamics', 'bags', 'config'))


def differences(a: Values, b: Values, tolerance: float = 0.0) -> Iterator[str]:
    """Say what differs between the values of a case in two records."""
    for key in [*a, *(key for key in b if key not in a)]:
        if key not in b or key not in a:
            yield f'{key}: only in {"A" if key in a else "B"}'
        elif (not tolerance or 'sha256' not in key) and (
                said := difference(a[key], b[key], tolerance)):
            yield f'{key}: {said}'
    if a.keys() == b.keys() and list(a) != list(b):
        yield 'the keys are the same in another order'


def difference(a: Any, b: Any, tolerance: float) -> str:
    """Say how two values differ; empty if not."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return array_difference(np.asarray(a), np.asarray(b), tolerance)
    if isinstance(a, str) and isinstance(b, str):
        return text_difference(a, b, tolerance)
    if repr(a) == repr(b):
        return ''
    if {type(a), type(b)} <= {int, float} and near(a, b, tolerance):
        return ''
    return f'{a!r} -> {b!r}'


def near(a: float, b: float, tolerance: float) -> bool:
    """Say whether numbers are within a relative tolerance."""
    return tolerance > 0.0 and (a == b or abs(a - b) <= tolerance * max(abs(a), abs(b)))


def array_difference(a: Any, b: Any, tolerance: float) -> str:
    """Compare arrays bit for bit, or relative to the largest size in each column."""
    if (a.dtype, a.shape) != (b.dtype, b.shape):
        return f'{a.dtype} {a.shape} -> {b.dtype} {b.shape}'
    if a.tobytes() == b.tobytes():
        return ''
    if a.dtype.kind not in 'fiu':
        return f'{int(np.count_nonzero(a != b))} of {a.size} entries differ'
    wide = [np.atleast_1d(item).astype(np.longdouble) for item in (a, b)]
    same = (wide[0] == wide[1]) | (np.isnan(wide[0]) & np.isnan(wide[1]))
    size = np.where(np.isfinite(wide[0]), np.abs(wide[0]), 0).max(axis=0, initial=0)
    with np.errstate(invalid='ignore', divide='ignore'):
        ratio = np.where(same, 0, np.abs(wide[0] - wide[1]) / size)
    if tolerance > 0.0 and bool((ratio <= tolerance).all()):
        return ''
    return (f'{int(np.count_nonzero(~same))} of {a.size} numbers differ, by up to '
            f'{float(ratio.max()):.2g} of the largest')


def text_difference(a: str, b: str, tolerance: float) -> str:
    """Say in which line texts differ first; with a tolerance numbers in them may differ by it."""
    if a == b:
        return ''
    lines, others = a.splitlines(), b.splitlines()
    for number in range(max(len(lines), len(others))):
        line, other = ((text[number] if number < len(text) else '(no line)')
                       for text in (lines, others))
        if line != other and not (tolerance > 0.0 and alike(line, other, tolerance)):
            place = f'line {number + 1}: ' if max(len(lines), len(others)) > 1 else ''
            return f'{place}{line[:200]!r} -> {other[:200]!r}'
    return '' if tolerance > 0.0 else 'ends of lines differ'


def alike(line: str, other: str, tolerance: float) -> bool:
    """Say whether lines are the same but for numbers within the tolerance."""
    line, other = (CHECKSUM.sub('#', text) for text in (line, other))
    if NUMBER.split(line) != NUMBER.split(other):
        return False
    return all(near(float(a), float(b), tolerance)
               for a, b in zip(NUMBER.findall(line), NUMBER.findall(other), strict=True))


def compare(a: Path, b: Path, tolerance: float, only: list[str]) -> int:
    """Print the differences of two records, by case; give the exit code."""
    cases = [json.loads((record / 'about.json').read_text())['cases'] for record in (a, b)]
    both = [name for name in cases[0] if name in cases[1] and chosen(name, only)]
    changed = 0
    for name in both:
        found = list(differences(load_case(a, name), load_case(b, name), tolerance))
        changed += bool(found)
        for line in found[:SHOWN]:
            print(f'{name}  {line}')
        if len(found) > SHOWN:
            print(f'{name}  ... and {len(found) - SHOWN} more')
    alone = [name for name in {*cases[0]} ^ {*cases[1]} if chosen(name, only)]
    print(f'{len(both) - changed} of {len(both)} cases are equal'
          + (f' within {tolerance:g}' if tolerance else ', bit for bit')
          + (f'; {len(alone)} are in one record alone' if alone else ''))
    return 0 if both and not changed else 1


def chosen(name: str, only: list[str]) -> bool:
    """Say whether a case is asked for: by its name, its part, or a pattern."""
    return not only or any(fnmatch(name, item) or name.startswith(f'{item.rstrip("/")}/')
                           for item in only)


def check(rev: str, cases: list[Case], root: Path, tolerance: float) -> int:
    """Compare the working tree with a commit, whose record is kept once it was made."""
    sha = subprocess.run(['git', '-C', str(root), 'rev-parse', '--verify', f'{rev}^{{commit}}'],
                         capture_output=True, text=True, check=True).stdout.strip()
    names = digest(repr(cases).encode())[:8]
    kept = root / 'build' / 'golden' / f'{sha[:12]}-{names}'
    if not (kept / 'about.json').exists():
        shutil.rmtree(kept, ignore_errors=True)
        with tempfile.TemporaryDirectory(prefix='golden_tree_') as name:
            tree = Path(name).resolve() / 'tree'
            git = ['git', '-C', str(root), 'worktree']
            subprocess.run([*git, 'add', '--quiet', '--detach', str(tree), sha], check=True)
            try:
                record(kept, tree, cases)
            finally:
                subprocess.run([*git, 'remove', '--force', str(tree)], check=True)
    now = root / 'build' / 'golden' / 'now'
    shutil.rmtree(now, ignore_errors=True)
    record(now, root, cases)
    return compare(kept, now, tolerance, [])


def main(argv: list[str] | None = None) -> int:
    """Run the tool."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('action', choices=('record', 'compare', 'check', 'list'))
    parser.add_argument('places', nargs='*', help='OUT; A B; REV')
    parser.add_argument('--root', type=Path, default=HERE.parent, help='tree of the package')
    parser.add_argument('--only', nargs='+', default=[], metavar='NAME',
                        help='cases, parts, or patterns; what they need is run as well')
    parser.add_argument('--skip', nargs='+', default=[], metavar='NAME', help='not these')
    parser.add_argument('--quick', action='store_true', help='a choice that takes a minute')
    parser.add_argument('--tolerance', type=float, default=0.0,
                        help='numbers may differ by this part of their size (0: bit for bit)')
    args = parser.parse_args(argv)
    wanted = {'record': 1, 'compare': 2, 'check': 1, 'list': 0}[args.action]
    if len(args.places) != wanted:
        parser.error(f'{args.action} takes {wanted} names, not {len(args.places)}')
    if args.action == 'compare':
        return compare(Path(args.places[0]), Path(args.places[1]), args.tolerance, args.only)
    table = read_table()
    names = [name for name, case in table.items() if chosen(name, args.only)
             and (case.quick or not args.quick) and not (args.skip and chosen(name, args.skip))]
    cases = ordered(table, names)
    root = args.root.resolve()
    if args.action == 'check':
        return check(args.places[0], cases, root, args.tolerance)
    if args.action == 'record':
        record(Path(args.places[0]).resolve(), root, cases)
        return 0
    for case in cases:
        print(f'{case.name}{"+" * case.quick} = {" ".join(case.arguments)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
