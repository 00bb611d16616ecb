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

"""Table I as grids of text: for the terminal, Markdown, CSV and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import csv
from dataclasses import dataclass
import io
from pathlib import Path

from papers.campaign import Campaign, KINDS, write_file
from papers.look import render
from papers.table1 import Cell, FIGURES, PRINTED, Table1, TableBlock

EMPTY = ''
PAPER = ('rmse', 'sigma_e', 'fit_printed')
"""Figures that the paper has."""
FIGURE_TEXT = (
    '`fit` is 100 (1 - |y - ŷ| / |y - mean y|); Eq. (18) is what the paper prints in its place, '
    'with |ŷ - mean y| below the line; σ(E) of ours is the standard deviation of the norm of the '
    'error over the channels, that of the paper is not defined')
SPLIT_TEXTS = {
    'stimulus': 'half of the stimuli for training, the other half for testing',
    'random': 'half of the samples at random for training, the other half for testing '
              '(optimistic; the paper splits by stimuli)'}


@dataclass(frozen=True)
class Grid:
    """A table of text."""

    title: str  # Title above the grid
    groups: tuple[tuple[str, int], ...]  # Heads over several columns each, with their number
    heads: tuple[str, ...]  # Heads of the columns
    rows: tuple[tuple[str, ...], ...]  # Cells of each row
    breaks: tuple[int, ...] = ()  # Rows before which a rule is drawn

    def over(self, column: int) -> str:
        """Give the head over a column: that of its group where the group begins."""
        begin = 0
        for name, count in self.groups:
            if begin == column:
                return name
            begin += count
        return EMPTY

    def pieces(self, width: int, gap: int = 2) -> list[list[int]]:
        """Share the groups behind the first one out on tables that are not too wide."""
        def taken(columns: Iterable[int]) -> int:
            return sum(gap + max(map(len, (
                self.over(column), self.heads[column], *(row[column] for row in self.rows))))
                for column in columns)
        begin = self.groups[0][1]
        own, result = taken(range(begin)), [list[int]()]
        for _, count in self.groups[1:]:
            group = range(begin, begin + count)
            if result[-1] and own + taken([*result[-1], *group]) > width:
                result.append([])
            result[-1] += group
            begin += count
        return result

    def look(self, column: int) -> str:
        """Give the style class of a column: text at the left, a line before each group."""
        if column < self.groups[0][1]:
            return 'first'
        begins, total = set(), 0
        for _, count in self.groups:
            begins.add(total)
            total += count
        return 'group' if column in begins else 'figure'


def _number(value: float | None, digits: int) -> str:
    return EMPTY if value is None else f'{value:.{digits}f}'


def _cells(cell: Cell, digits: int, *, with_paper: bool) -> tuple[str, ...]:
    own = (_number(cell.rmse, digits), _number(cell.sigma_e, digits),
           _number(cell.fit_printed, 1), _number(cell.fit, 1))
    return own if not with_paper else (*own, *(_number(cell.paper.get(name), 2) for name in PAPER))


def block_grid(block: TableBlock) -> Grid:
    """Lay one output out: a row for payload and part, the paper's columns behind ours."""
    digits = 1 if block.output == 'strain' else 3
    groups: list[tuple[str, int]] = [(EMPTY, 2)]
    heads = ['', 'payload']
    for model in KINDS:
        names = ['RMSE', 'σ(E)', 'Eq. (18)']
        groups.append((KINDS[model], 4))
        heads += [*names, 'fit']
        if model in PRINTED:
            groups.append((f'paper, {KINDS[model]}', 3))
            heads += names
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    last = ''
    for row in block.rows:
        if last and row.part != last:
            breaks.append(len(rows))
        first = '' if row.part == last else row.part
        last = row.part
        cells = [text for model in KINDS
                 for text in _cells(row.cells[model], digits, with_paper=model in PRINTED)]
        rows.append((first, f'{1000 * row.payload:.0f} g', *cells))
    title = (f'{block.title} ({", ".join(block.channels)}); RMSE and σ(E) in {block.unit}, '
             'fit and Eq. (18) in %')
    return Grid(title, tuple(groups), tuple(heads), tuple(rows), tuple(breaks))


def shared_grid(table: Table1) -> Grid:
    """Lay the one model of all payloads out beside the separate ones."""
    present = [item for item in table.shared
               if any(value is not None for value in item.separate.values())]
    low, high = (f'{1000 * value:.0f} g' for value in table.trained_at)
    titles = {block.output: block.title for block in table.blocks}
    groups = [(EMPTY, 1)] + [(f'{titles[item.output]}, {KINDS[item.model]}', 2)
                             for item in present]
    heads = ['payload'] + [text for _ in present for text in ('separate', 'one model')]
    rows = []
    for payload in next(iter(table.shared)).separate:
        seen = payload in table.trained_at
        cells = [f'{1000 * payload:.0f} g{" *" if seen else ""}']
        for item in present:
            cells += [_number(item.separate[payload], 1), _number(item.together[payload], 1)]
        rows.append(tuple(cells))
    title = (f'One model for all payloads, fitted at {low} and {high} (*) only, beside a model '
             'for each: fit in % on test stimuli')
    return Grid(title, tuple(groups), tuple(heads), tuple(rows))


def grids(table: Table1) -> list[Grid]:
    """Lay out everything."""
    return [*(block_grid(block) for block in table.blocks), shared_grid(table)]


def finding_texts(table: Table1) -> list[str]:
    """Write what was expected, and whether it is so here and in the paper, one line each."""
    return [f'{item.text}: {"yes" if item.holds else "NO"} ({item.figures}; paper: '
            f'{"yes" if item.paper_holds else "NO"}, {item.paper})' for item in table.findings]


def markdown(table: Table1) -> str:
    """Write the table as Markdown."""
    lines = ['# Table I', '', f'Simulated arm; {SPLIT_TEXTS[table.split]}. '
             f'{FIGURE_TEXT}. Figures of the paper: {table.source}.', '']
    for remark in table.remarks:
        lines += [remark, '']
    for grid in grids(table):
        # Markdown has no heads over several columns: each column is named in full
        names = [name for name, count in grid.groups for _ in range(count)]
        heads = [f'{name} {head}'.strip() for name, head in zip(names, grid.heads, strict=True)]
        lines += [f'## {grid.title}', '', _line(heads), _line(['---'] * len(heads))]
        lines += [_line(row) for row in grid.rows] + ['']
    lines += ['## Expected shape', '']
    lines += [f'* {item}' for item in finding_texts(table)]
    lines += ['', "## On the paper's figures", '', *(f'* {note}' for note in table.notes)]
    return '\n'.join(lines) + '\n'


def _line(cells: list[str] | tuple[str, ...]) -> str:
    return f'| {" | ".join(cells)} |'


def csv_text(table: Table1) -> str:
    """Write all cells, one a line."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator='\n')
    writer.writerow(['output', 'unit', 'payload_g', 'part', 'model', *FIGURES,
                     *(f'paper_{name}' for name in PAPER), 'one_model_fit'])
    for block in table.blocks:
        for row in block.rows:
            for model in KINDS:
                cell = row.cells[model]
                shared = next(item for item in table.shared
                              if (item.output, item.model) == (block.output, model))
                together = shared.together[row.payload] if row.part == 'test' else None
                exact: Callable[[float | None], str] = (
                    lambda value: EMPTY if value is None else f'{value:.6g}')
                writer.writerow([
                    block.output, block.unit, f'{1000 * row.payload:g}', row.part, model,
                    *(exact(getattr(cell, name)) for name in FIGURES),
                    *(exact(cell.paper.get(name)) for name in PAPER), exact(together)])
    return stream.getvalue()


def write_table(table: Table1, campaign: Campaign, out: Path) -> list[Path]:
    """Write Table I as CSV, Markdown and page."""
    page = render('table1.html.j2', arm=campaign.arm.name, plan=campaign.plan, table=table,
                  grids=grids(table), split=SPLIT_TEXTS[table.split], figure_text=FIGURE_TEXT)
    files = {'table1.html': page, 'table1.md': markdown(table), 'table1.csv': csv_text(table)}
    for name, content in files.items():
        write_file(out / name, content)
    return [out / name for name in files]
