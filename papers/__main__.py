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

"""``python -m papers``: the published experiments, repeated in simulation."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
import json
import os
from pathlib import Path
import sys
import time
from typing import Any

from papers import lshape, merit
from papers.campaign import Campaign, ELASTIC, KINDS, Plan, ResultCache
from papers.figures import gallery, write_figures
from papers.fits import Fits
from papers.outlook import compute_of, content, PARTS, Setting, write_outlook
from papers.table1 import (
    build, FIGURE_TEXT, finding_texts, grids, SPLIT_TEXTS, Table1, write_table)
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
import tudor_dynamics as td

EXAMPLES = """\
examples:
  python -m papers                       # all of it, into papers_out
  python -m papers table1 --split random --out out
  python -m papers lshape --elements 4 --dt 0.0001 --animate l.gif --out out
  python -m papers lshape --reference lshape_reference.npz --out out
  python -m papers outlook --only payload --out out
  python -m papers import-merit FILE.csv --out BAG

table1: Table I of Malzahn et al.: strain and current of the damped arm, five payloads with ten
stimuli of 80 s each, every kind of model, and one model for all payloads beside them; terminal,
table1.csv, table1.md and table1.html.
figures: the figures of both papers and four more, as SVG and PNG, with index.html, the numbers in
figures.json and tables of them in figures.md. It uses what table1 has left in the same DIR, and
the other way round: finished stages are kept in DIR/stages, so that an interrupted run goes on
where it was.
lshape: the L-shaped mechanism of two flexible links of Gasparetto et al. (2013). Two opposite
steps of torque take it from 135 deg (from hanging) to about 30 deg. Figures as in the paper:
torque (4), elbow and tip acceleration over time and frequency (5 to 8), bending moment in the
middle of the second link (9). With --reference, a run of an independent computation is repeated
and compared too.
outlook: what the first paper names as its outlook, computed on the simulated reference arm, part
by part; outlook.html with figures and with what must be reached, its tables in outlook.md, the
numbers in outlook.json.
import-merit: a bag of a CSV file of the public recordings of the TUDOR arm; see its own --help.
force: short for outlook --only force, steps of a held force on floors of 100 to 20 000 N/m.

exit codes: 0 done, 2 wrong input
"""
EXPERIMENTS = ('table1', 'figures', 'lshape', 'outlook', 'force')
CAMPAIGN = ('arm', 'models', 'quick', 'stimuli', 'seconds', 'seed', 'jobs', 'cluster')
OWN: dict[str, tuple[str, ...]] = {
    'table1': (*CAMPAIGN, 'split'), 'figures': CAMPAIGN,
    'lshape': ('elements', 'dt', 'animate', 'reference'),
    'outlook': ('arm', 'quick', 'seed', 'jobs', 'cluster', 'only'),
    'force': ('arm', 'quick', 'seed', 'jobs', 'cluster')}
"""Options that an experiment knows, beside --out and --json."""
DEFAULTS: dict[str, Any] = {
    'elements': 2, 'dt': 2.5e-4, 'split': 'stimulus', 'quick': False, 'seed': 0,
    'jobs': os.cpu_count() or 1, 'models': tuple(KINDS)}
NARROW = 78
"""Characters of a table, so that it stands whole on the narrowest of terminals."""
MET = {True: 'yes', False: 'no', None: '-'}


def build_parser() -> argparse.ArgumentParser:
    """Build the parser."""
    parser = argparse.ArgumentParser(
        prog='python -m papers', description='Repeat published experiments in simulation.',
        epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('experiment', nargs='?', choices=EXPERIMENTS, help='experiment (all)')
    parser.add_argument('--out', metavar='DIR', default='papers_out',
                        help='results go there (papers_out)')
    parser.add_argument('--json', action='store_true', help='print figures as JSON')
    arm = parser.add_argument_group('table1, figures and outlook')
    arm.add_argument('--arm', metavar='YAML',
                     help='arm description with links, motors and damper (config/tudor.yaml)')
    arm.add_argument('--models', nargs='+', choices=tuple(KINDS), help='kinds of models (all)')
    arm.add_argument('--split', choices=('stimulus', 'random'),
                     help='train on half of the stimuli, as the paper, or on half of the samples '
                          'at random, which flatters (table1; stimulus)')
    arm.add_argument('--quick', action='store_true', default=None,
                     help='three payloads, two short stimuli each, fast models: to see that it '
                          'works')
    arm.add_argument('--stimuli', type=int, metavar='N',
                     help='recordings a payload, half of them for training (10)')
    arm.add_argument('--seconds', type=float, metavar='S', help='length of each (80)')
    arm.add_argument('--seed', type=int, metavar='N', help='of motions, noise and pushes (0)')
    arm.add_argument('--jobs', type=int, metavar='N', help='processes (one for each processor)')
    arm.add_argument('--cluster', metavar='tcp://HOST:PORT',
                     help='scheduler of a Dask cluster, whose workers do the work')
    arm.add_argument('--only', nargs='+', choices=tuple(PARTS), help='parts of outlook (all)')
    shape = parser.add_argument_group('lshape')
    shape.add_argument('--elements', type=int, help='elements a beam (2)')
    shape.add_argument('--dt', type=float, help='step [s] (0.00025)')
    shape.add_argument('--animate', metavar='FILE', help='.gif or .mp4')
    shape.add_argument('--reference', metavar='FILE.npz', help='computation to compare with')
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one experiment, or all of them; gives the exit code."""
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        if words[:1] == ['import-merit']:
            return merit.main(words[1:])
        args = build_parser().parse_args(words)
        for experiment in [args.experiment] if args.experiment else EXPERIMENTS[:-1]:
            chosen = _settled(argparse.Namespace(**vars(args)), experiment,
                              strict=args.experiment is not None)
            with td.on_cluster(chosen.cluster):
                found = RUN[experiment](chosen)
            if args.json:
                print(json.dumps(finite(found), indent=2, default=str))
    except (td.TudorError, OSError) as err:
        print(f'python -m papers: {err}', file=sys.stderr)
        return 2
    return 0


def _settled(args: argparse.Namespace, experiment: str, *, strict: bool) -> argparse.Namespace:
    """Put defaults where nothing was given, and refuse options of another experiment."""
    own = OWN[experiment]
    for name in sorted({name for names in OWN.values() for name in names}):
        if getattr(args, name) is None or name not in own and not strict:
            setattr(args, name, DEFAULTS.get(name))
        elif name not in own:
            known = ', '.join(f'--{item}' for item in (*own, 'out', 'json'))
            raise td.TudorError(f'--{name} is no option of {experiment}',
                                remedy=f'it knows {known}')
    args.experiment = experiment
    return args


def default_arm() -> Path:
    """Find the description of the reference arm."""
    return Path(__file__).resolve().parents[1] / 'config' / 'tudor.yaml'


@contextmanager
def opened(args: argparse.Namespace) -> Iterator[Campaign]:
    """Open a campaign, with a progress bar while a terminal watches."""
    if args.seed < 0 or args.jobs < 1:
        raise td.TudorError(f'--seed {args.seed} --jobs {args.jobs}',
                            remedy='give a seed of 0 or more and 1 job or more')
    plan = Plan(str(args.arm or default_arm()), seed=args.seed, jobs=args.jobs,
                kinds=tuple(dict.fromkeys(args.models)))
    if args.quick:
        plan = plan.quick()
    if args.stimuli is not None:
        plan = replace(plan, stimuli=args.stimuli)
    if args.seconds is not None:
        plan = replace(plan, seconds=args.seconds)
    if plan.stimuli < 2 or not 10.0 <= plan.seconds < float('inf'):
        raise td.TudorError(
            f'--stimuli {plan.stimuli} --seconds {plan.seconds:g}', remedy='give two stimuli or '
            'more, half of which are for testing, of 10 s or more')
    if args.split == 'random' and plan.kinds == (ELASTIC,):
        raise td.TudorError('--split random: the elastic model has a memory and no random split',
                            remedy='name others')
    campaign = Campaign(plan, ResultCache(args.out))
    console = Console(file=sys.stderr)
    columns = (TextColumn('{task.description}'), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True,
                  disable=not console.is_terminal) as bar:
        task = bar.add_task('', total=1.0)
        campaign.progress = lambda text, share: bar.update(task, description=text, completed=share)
        yield campaign


def run_table1(args: argparse.Namespace) -> dict[str, Any]:
    """Record, fit, print and write Table I."""
    begun = time.perf_counter()
    with opened(args) as campaign:
        table = build(Fits(campaign), args.split)
        files = write_table(table, campaign, Path(args.out))
    seconds = time.perf_counter() - begun
    if not args.json:
        _print_table1(table)
        print(f'{seconds:.0f} s; {", ".join(str(file) for file in files)}')
    return {'out': args.out, 'seconds': round(seconds, 1), **asdict(table)}


def _print_table1(table: Table1) -> None:
    for grid in grids(table):
        first, title = grid.groups[0][1], grid.title
        for columns in grid.pieces(NARROW):
            heads = [f'\n{head}' for head in grid.heads[:first]] + [
                f'{grid.over(column)}\n{grid.heads[column]}' for column in columns]
            rows = [(*row[:first], *(row[column] for column in columns)) for row in grid.rows]
            print_rows(title, heads, rows, first, grid.breaks)
            title = ''
    missing = [label for model, label in KINDS.items() if all(
        row.cells[model].fit is None for block in table.blocks for row in block.rows)]
    if missing:
        print(f'{", ".join(missing)}: no figures, this kind of model was not fitted')
    print(f'{SPLIT_TEXTS[table.split]}; {FIGURE_TEXT}')
    for remark in table.remarks:
        print(remark)
    print('expected shape:')
    for text in finding_texts(table):
        print(f'  {text}')


def run_figures(args: argparse.Namespace) -> dict[str, Any]:
    """Compute what is not there yet, draw the figures, and write their page."""
    begun = time.perf_counter()
    out = Path(args.out)
    with opened(args) as campaign:
        chosen = gallery(Fits(campaign))
        campaign.progress('draw', 0.0)
        names = write_figures(chosen, campaign.arm.name, out)
    seconds = time.perf_counter() - begun
    if not args.json:
        for picture in chosen.pictures:
            print(f'{picture.name}: {picture.title}')
        print(f'{len(names)} figures as SVG and PNG in {seconds:.0f} s; {out / "index.html"}')
    return {'out': str(out), 'seconds': round(seconds, 1), 'figures': names, **chosen.data}


def run_outlook(args: argparse.Namespace) -> dict[str, Any]:
    """Compute the parts that are asked for, print what they reach, and write the page."""
    begun = time.perf_counter()
    out = Path(args.out)
    names = ['force'] if args.experiment == 'force' else list(dict.fromkeys(args.only or PARTS))
    with opened(args) as campaign:
        sections = {}
        for name in names:
            setting = Setting(name, campaign, args.quick)
            sections[name] = compute_of(name)(setting)
            setting.progress('done', 1.0)
        files = write_outlook(sections, campaign.arm.name, out)
    seconds = time.perf_counter() - begun
    if not args.json:
        for name, section in sections.items():
            print_rows(PARTS[name], ('what', 'must reach', 'reached', ''), [
                (floor.what, floor.wanted, floor.reached, MET[floor.met])
                for floor in section.floors], 4)
        if args.quick:
            print('--quick: too little of everything for what must be reached')
        print(f'{seconds:.0f} s; {", ".join(str(file) for file in files)}')
    return {'out': str(out), 'seconds': round(seconds, 1), **content(sections)}


def print_rows(
    title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], left: int,
    breaks: Sequence[int] = (),
) -> None:
    """Print a table; its first columns, so many, are text, the others figures."""
    table = Table(title=title or None, title_justify='left', box=box.SIMPLE_HEAD, show_edge=False,
                  pad_edge=False, padding=(0, 1, 0, 0))
    for number, head in enumerate(heads):
        text = number < left
        table.add_column(head, justify='left' if text else 'right', no_wrap=not text)
    for number, row in enumerate(rows):
        if number in breaks:
            table.add_section()
        table.add_row(*row)
    # no markup: units in brackets stand as they are
    Console(markup=False, highlight=False, emoji=False).print(table)


def finite(found: Any) -> Any:
    """Replace numbers that JSON does not know by null."""
    if isinstance(found, dict):
        return {key: finite(item) for key, item in found.items()}
    if isinstance(found, (list, tuple)):
        return [finite(item) for item in found]
    if isinstance(found, float) and not abs(found) < float('inf'):
        return None
    return found


RUN = {'table1': run_table1, 'figures': run_figures, 'lshape': lshape.run,
       'outlook': run_outlook, 'force': run_outlook}

if __name__ == '__main__':
    sys.exit(main())
