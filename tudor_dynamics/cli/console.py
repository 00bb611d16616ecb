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

"""What subcommands share: options, progress on a terminal, tables of figures, JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import count
import math
import os
from pathlib import Path
import re
import sys
import textwrap
from threading import Event, Thread
from typing import Any

from pydantic import TypeAdapter
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.progress import (
    BarColumn, Progress, SpinnerColumn, TimeElapsedColumn, TimeRemainingColumn)
from rich.table import Table
from rich.text import Text

from tudor_dynamics.bags.storage import METADATA
from tudor_dynamics.bags.trajectory import is_table, read_trajectories, Sent, Trajectory
from tudor_dynamics.errors import complain, remedy_of, TudorError, UsageError, wrapped
from tudor_dynamics.files import check_target, write_whole
from tudor_dynamics.identification.doctor.findings import Finding
from tudor_dynamics.identification.uses import Use
from tudor_dynamics.identification.validation import ChannelScore, Grade, Score, shown_fit

LEAST_TEXT = 10
"""Characters that a column of text keeps at least; longer text goes on in the next line."""
GAP = 2  # blanks between columns
SILENCE, PAUSE = 3.0, 10.0
"""Where no terminal shows a bar, a line says after so long how far it is, and again [s]."""

Advance = Callable[..., None]
"""Takes what changes about a bar: ``advance`` or ``completed``, ``total``, ``description``."""


@contextmanager
def bar(total: int | None, text: str) -> Iterator[Advance]:
    """Show a bar while a terminal watches, elsewhere lines; text may have the description."""
    console, ended = Console(file=sys.stderr), Event()
    shown = console.is_terminal and not console.is_dumb_terminal
    with Progress(SpinnerColumn(), text, BarColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
                  console=console, transient=True, disable=not shown) as progress:
        number = progress.add_task('', total=total)

        def tell() -> None:
            task, pause = progress.tasks[0], SILENCE
            while not ended.wait(pause):
                if said := text.format(task=task):
                    share = '' if task.total is None else f': {task.percentage:.0f} %'
                    complain(f'{task.elapsed:.0f} s: {said}{share}')
                    pause = PAUSE
        if not shown:
            Thread(target=tell, daemon=True).start()
        try:
            yield partial(progress.update, number)
        finally:
            ended.set()


@contextmanager
def steps(total: int | None) -> Iterator[Callable[[str], None]]:
    """Show a bar over steps that are named as they begin; their number may not be known."""
    begun = count()
    with bar(total, '{task.description}') as advance:
        yield lambda text: advance(completed=next(begun), description=text)


def say(*lines: str) -> None:
    """Print lines on standard output, each wrapped at the width of the terminal."""
    width = Console().width
    for line in lines:
        print(wrapped(line, width))


def say_command(command: str) -> None:
    """Print a command so that it can be copied: a line that goes on ends with a backslash."""
    quoted = re.sub(r"""'[^']*'|"[^"]*\"""", lambda word: word[0].replace(' ', '\0'), command)
    lines = textwrap.wrap(quoted, Console().width - 6, break_long_words=False,
                          break_on_hyphens=False)
    print('   ' + ' \\\n     '.join(lines).replace('\0', ' '))


def write(path: str | Path, option: str, content: bytes) -> None:
    """Write a file that was asked for, whole or not at all."""
    try:
        write_whole(Path(path), content)
    except OSError as err:
        raise UsageError(f'cannot be written ({err.strerror})', place=f'{option} {path}',
                         remedy=remedy_of(err)) from None


def print_json(content: Any) -> None:
    """Print one JSON object on standard output."""
    print(as_json(content))


def as_json(content: Any) -> str:
    """Write JSON, with null for numbers that JSON does not know."""
    return TypeAdapter(Any).dump_json(content, indent=2, fallback=str).decode()


def _percents(score: Score | ChannelScore) -> Iterator[str]:
    """Write fit and relative error; far outside, their digits mean nothing."""
    for value in (shown_fit(score.fit, 2), 100.0 * score.relative_error):
        yield ('n/a' if math.isnan(value) else '< -999' if value < -999.0 else
               '> 999' if value > 999.0 else f'{value:.2f}')


STYLES = {Grade.GOOD: 'green', Grade.USABLE: 'yellow', Grade.DO_NOT_USE: 'red', None: 'dim'}
"""Colour of a verdict on a terminal."""


def say_verdict(level: Grade | None, verdict: str, rest: str = '', of: str = '') -> None:
    """Print a verdict in the colour of its grade, with what stands before and after it."""
    console = Console()
    text = Text(wrapped(f'{of}{verdict}{rest}', console.width))
    text.stylize(STYLES[level], len(of), len(of) + len(verdict) if rest else None)
    console.print(text, soft_wrap=True)


def print_verdicts(name: str, uses: Sequence[Use]) -> None:
    """Print what models may be used for, a line a grade; outputs are named where they differ."""
    by_use: dict[str, list[Use]] = {}
    for use in uses:
        by_use.setdefault(use.name.partition(' (')[0], []).append(use)
    for level in STYLES:
        names = [
            what if len({one.level for one in same}) == 1 else
            f'{use.name} by {use.kind} {use.output}'
            for what, same in by_use.items() for use in same if use.level is level]
        if names:
            word = 'not known' if level is None else level.value
            say_verdict(level, word, f': {", ".join(dict.fromkeys(names))}', f'{name}: ')


def print_findings(findings: Sequence[Finding]) -> None:
    """Print what the doctor says, one finding after the other."""
    for item in findings:
        say(f'doctor: {item.title}')
        for name, text in ((f'bag {item.bag!r}' if item.bag else 'found', item.what),
                           ('evidence', item.evidence), ('remedy', item.remedy)):
            if text:
                say(f'  {name}: {text}')


def score_table(title: str, rows: list[tuple[str, str, Score, dict[str, str]]]) -> Table:
    """Lay figures out as a table."""
    table = new_table(title, names=('channel',), figures=(
        'RMSE', 'unit', 'sigma(E)', 'fit\n%', 'rel. error\n%'))
    table.columns[2].justify = 'left'
    for output, model, score, units in rows:
        unit = set(units.values())
        table.add_row(f'{output}, {model}', f'{score.rmse:.4g}',
                      unit.pop() if len(unit) == 1 else 'mixed', f'{score.sigma_e:.4g}',
                      *_percents(score))
        for name, channel in score.channels.items():
            table.add_row(f'  {name}', f'{channel.rmse:.4g}', units[name], '',
                          *_percents(channel))
        table.add_section()
    return table


def new_table(title: str, names: Sequence[str] = (), figures: Sequence[str] = ()) -> Table:
    """Make a table whose names may take several lines and whose figures are never cut."""
    table = Table(title=title, title_justify='left', box=box.SIMPLE_HEAD, show_edge=False,
                  pad_edge=False, padding=(0, GAP - 1, 0, 0))
    for name in names:
        table.add_column(name, overflow='fold')
    for name in figures:
        table.add_column(name, justify='right', no_wrap=True)
    return table


def print_table(table: Table, spare: str = '') -> None:
    """Print a table as wide as the terminal, or its figures; spare: a column to give up."""
    # no markup: units in brackets, and names that come from bags, stand as they are
    console = Console(markup=False, highlight=False, emoji=False)
    if _least(table) > console.width:
        table.columns = [column for column in table.columns if column.header != spare]
    console.width = max(console.width, _least(table))
    title, table.title = table.title, None  # rich would fold it to the width of the figures
    say(*[str(title)] * bool(title))
    with console.capture() as drawn:
        console.print(table)
    print('\n'.join(line.rstrip() for line in drawn.get().splitlines()))


def _least(table: Table) -> int:
    """Give the width at which figures are whole, and texts have a few characters."""
    lines = [(column, [cell_len(line) for cell in (column.header, *column.cells)
                       for line in str(cell).splitlines()]) for column in table.columns]
    return sum(GAP + max(min(length, LEAST_TEXT) if not column.no_wrap else length
                         for length in lengths) for column, lengths in lines) - GAP


def add_bags_and_model(parser: Any) -> None:
    """Add the options that name bags, and the model of a fit that they are compared with."""
    parser.add_argument('bags', nargs='+', metavar='BAG',
                        help='bag directory or file, or a part of it: BAG@60-100%%')
    parser.add_argument('--model', required=True, metavar='MODEL', help='directory of tudor fit')
    parser.add_argument('--arm', metavar='YAML',
                        help='refuse the model if it is not of this arm (it carries its own)')


def add_trajectories(parser: Any) -> None:
    """Add the options that name trajectories, and where those that are changed go."""
    parser.add_argument('trajectory', metavar='TRAJECTORY', help='CSV file, or bag')
    add_out(parser, 'FILE', 'CSV file, or directory of a bag')
    parser.add_argument('--topic', default='', metavar='TOPIC',
                        help='topic of the bag (the only one with trajectories)')


def check_trajectories(args: argparse.Namespace) -> None:
    """Refuse a table for a bag, and what would be overwritten."""
    source, out = Path(args.trajectory), Path(args.out)
    if is_table(source) != is_table(out):
        raise UsageError(f'{source} and --out {out}: one is a CSV table, the other a bag',
                         remedy='give two CSV tables (.csv) or two bags')
    check_target(out, overwrite=args.overwrite, mark='' if is_table(out) else METADATA)


def changed_trajectories(
    args: argparse.Namespace, change: Callable[[Trajectory], Trajectory],
) -> list[Sent]:
    """Read trajectories and change each; what is wrong with one says which it is."""
    done = []
    for number, sent in enumerate(read_trajectories(Path(args.trajectory), args.topic), start=1):
        try:
            done.append(replace(sent, trajectory=change(sent.trajectory)))
        except TudorError as err:
            raise err.at(f'{args.trajectory}, trajectory {number}') from None
    return done


def add_out(parser: Any, metavar: str, text: str, *, required: bool = True) -> None:
    """Add where results go."""
    parser.add_argument('--out', metavar=metavar, required=required, help=text)
    add_overwrite(parser, '--out')


def add_overwrite(parser: Any, *names: str) -> None:
    """Add what lets options replace what is there; pages and pictures of tudor need none."""
    parser.add_argument('--overwrite', action='store_true',
                        help=f'replace what is there at {" and ".join(names)}')


def add_running(parser: Any) -> None:
    """Add what says where pieces of work are done."""
    parser.add_argument('--jobs', type=int, default=os.cpu_count() or 1, metavar='N',
                        help='processes (default: one a core)')
    parser.add_argument('--cluster', metavar='tcp://HOST:PORT',
                        help='Dask scheduler whose workers do it in their place; they see the '
                             'same paths')


def check_running(args: argparse.Namespace) -> None:
    """Refuse numbers of processes that there cannot be."""
    if args.jobs < 1:
        raise UsageError(f'--jobs {args.jobs}: give 1 or more')
