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
Say how old the figures of the documents are, or measure some again.

    python tools/figures.py             every file of docs/figures: commit, date, old or not
    python tools/figures.py NAME ...    run their commands, and write what they print
    python tools/figures.py --work DIR NAME ...     the same; what a command leaves there is kept

A command has to print a Markdown table with the head that the file has (``bench/tables.py``), or
write it into a file ``*.md``; it runs once for all names that share it. ``DATA`` in it stands for
the folder in TUDOR_SHARED_DATA (../shared/data), ``DIR`` and ``out`` for a folder that is made,
``model`` for a model of the sample bags. Files marked *copied* in the list were written by hand.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date
import os
from pathlib import Path
import re
import shlex
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'docs' / '_extensions'))

from figure_data import Figures, FOLDER, read  # noqa: E402, I100


def cells(line: str) -> list[str]:
    """Split a row of a Markdown table; pages have a space before the sign of percent."""
    return [re.sub(r'(?<=\d)%', ' %', cell.strip()) for cell in line.strip().strip('|').split('|')]


def rows_below(head: list[str], output: str) -> list[list[str]]:
    """Give the rows of the tables with a head; empty where there is none."""
    rows: list[list[str]] = []
    within = False
    for line in output.splitlines():
        if not line.startswith('|'):
            within = False
        elif cells(line) == head:
            within = True
        elif within and set(line) - set('|-: '):
            rows.append(cells(line))
    return rows


def whole(command: str, folder: Path) -> str:
    """Put folders and a model in the place of the words that stand for them."""
    data = os.environ.get('TUDOR_SHARED_DATA', ROOT.parent / 'shared' / 'data')
    given = {'DATA': data, 'DIR': folder / 'work', 'out': folder / 'out',
             'model': folder / 'model', 'MODEL': folder / 'model'}
    words = command.split()
    for at, option in enumerate(words[:-1], start=1):
        name, _, below = words[at].partition('/')
        if option.startswith('--') and name in given:
            words[at] = shlex.quote(str(Path(given[name]) / below))
    text = ' '.join(words)
    if str(given['model']) not in text:
        return text
    bags = [f'bags/two_blade_train_{number}' for number in (1, 2)]
    return (f'tudor fit {" ".join(bags)} --test bags/two_blade_test --arm '
            f'config/two_blade_arm.yaml --out {given["model"]} --overwrite >&2 && {text}')


def output_of(command: str, folder: Path) -> tuple[int, str]:
    """Run a command; give its exit code and what it printed and wrote as Markdown."""
    path = f'{Path(sys.executable).parent}:{os.environ["PATH"]}'  # `python` is this one
    begun = time.time()
    done = subprocess.run(
        whole(command, folder), shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True,
        check=False, env={**os.environ, 'PATH': path, 'PYTHONPATH': f'{ROOT}:{ROOT / "bench"}'})
    return done.returncode, '\n\n'.join([done.stdout, *(
        page.read_text(encoding='utf-8') for page in sorted(folder.rglob('*.md'))
        if page.stat().st_mtime >= begun - 1.0)])


def measure(tables: list[Figures], work: Path | None = None) -> list[Figures]:
    """Run the command that tables share; give its figures, of the commit that is checked out."""
    paths = sorted({path for figures in tables for path in figures.paths})
    changed = subprocess.run(['git', 'status', '--porcelain', '--', *paths], cwd=ROOT,
                             stdout=subprocess.PIPE, text=True, check=True).stdout
    if changed:
        sys.exit(f'figures belong to a commit; first commit these:\n{changed}')
    commit = subprocess.run(['git', 'rev-parse', '--short', 'HEAD'], cwd=ROOT,
                            stdout=subprocess.PIPE, text=True, check=True).stdout.strip()
    with TemporaryDirectory() as folder:
        code, output = output_of(tables[0].command, work or Path(folder))
    found = [replace(figures, rows=rows_below(figures.head, output), commit=commit,
                     date=date.today().isoformat(), measured=True) for figures in tables]
    for figures in found:
        if not figures.rows:
            sys.exit(f'exit code {code}, and no table with the head {figures.head} in what was '
                     f'printed:\n{output[-2000:]}')
    return found


def main() -> None:
    """List the files, or measure those named."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('names', nargs='*', metavar='NAME', help='files of figures to measure')
    parser.add_argument('--work', type=Path, metavar='DIR', help='folder of DIR, out and model')
    args = parser.parse_args()
    by_command: dict[str, list[str]] = {}
    for name in args.names:
        by_command.setdefault(read(name).command, []).append(name)
    for names in by_command.values():
        for name, figures in zip(names, measure(
                [read(name) for name in names], args.work), strict=True):
            (FOLDER / f'{name}.json').write_text(figures.text(), encoding='utf-8')
    for file in [] if by_command else sorted(FOLDER.glob('*.json')):
        figures = read(file.stem)
        changes = figures.changes()
        age = '?' if changes is None else f'old: {changes:3d}' if changes else ''
        print(f'{file.stem:24s} {figures.date} {figures.commit:8s} {age:10s}'
              f'{"" if figures.measured else "copied":8s}{figures.command}')


if __name__ == '__main__':
    main()
