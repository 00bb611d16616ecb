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

"""What subcommands share: progress on a terminal, tables of figures, JSON."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import json
import math
import sys
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from tudor_dynamics.identification.metrics import Score


class Steps:
    """
    A progress bar over steps that are named as they begin.

    Parameters
    ----------
    progress : rich.progress.Progress or None
        Bar to be moved; None where nobody watches.
    total : int
        Number of steps.

    """

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._task = progress.add_task('', total=total) if progress is not None else None
        self._begun = False

    def __call__(self, text: str) -> None:
        """Begin the next step."""
        if self._progress is None or self._task is None:
            return
        if self._begun:
            self._progress.advance(self._task)
        self._begun = True
        self._progress.update(self._task, description=text)


@contextmanager
def steps(total: int) -> Iterator[Steps]:
    """
    Show a progress bar on standard error while a terminal watches.

    Parameters
    ----------
    total : int
        Number of steps.

    Yields
    ------
    Steps
        To be called with the name of each step as it begins.

    """
    console = Console(file=sys.stderr)
    if not console.is_terminal:
        yield Steps(None, total)
        return
    columns = (SpinnerColumn(), TextColumn('{task.description}'), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield Steps(progress, total)


def print_json(content: Any) -> None:
    """Print one JSON object on standard output."""
    json.dump(content, sys.stdout, indent=2, allow_nan=False, default=str)
    sys.stdout.write('\n')


def finite(content: Any) -> Any:
    """Replace numbers that JSON does not know by null."""
    if isinstance(content, dict):
        return {key: finite(item) for key, item in content.items()}
    if isinstance(content, (list, tuple)):
        return [finite(item) for item in content]
    if isinstance(content, float) and not abs(content) < float('inf'):
        return None
    return content


def _percent(value: float) -> str:
    """Write a percentage; far outside, its digits mean nothing."""
    if math.isnan(value):
        return 'n/a'
    if value < -999.0:
        return '< -999'
    return '> 999' if value > 999.0 else f'{value:.2f}'


def score_table(title: str, rows: list[tuple[str, str, Score, dict[str, str]]]) -> Table:
    """
    Lay figures out as a table.

    Parameters
    ----------
    title : str
        Title above the table.
    rows : list of (output, model, Score, units)
        One model of one output each; units by channel.

    Returns
    -------
    rich.table.Table
        Over all channels first, then each channel.

    """
    table = Table(title=title, title_justify='left')
    for name in ('output', 'model', 'channel'):
        table.add_column(name, no_wrap=True)
    for name in ('RMSE', 'unit', 'sigma(E)', 'fit %', 'Eq. 18 %', 'rel. error %'):
        table.add_column(name, justify='left' if name == 'unit' else 'right', no_wrap=True)
    for output, model, score, units in rows:
        unit = set(units.values())
        table.add_row(output, model, 'all', f'{score.rmse:.4g}',
                      unit.pop() if len(unit) == 1 else 'mixed', f'{score.sigma_e:.4g}',
                      _percent(score.fit), _percent(score.fit_printed),
                      _percent(100 * score.relative_error))
        for name, channel in score.channels.items():
            table.add_row('', '', name, f'{channel.rmse:.4g}', units[name], '',
                          _percent(channel.fit), '', _percent(100 * channel.relative_error))
        table.add_section()
    return table


def print_table(table: Table) -> None:
    """Print a table on standard output; wide enough to be whole where it goes to a file."""
    # no markup: units in brackets, and names that come from bags, stand as they are
    console = Console(markup=False)
    if not console.is_terminal:
        console = Console(width=160, markup=False)
    console.print(table)
