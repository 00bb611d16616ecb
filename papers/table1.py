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

"""Table I: all cells of ours and of the paper, and what the paper concluded from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import csv
from dataclasses import dataclass
from functools import lru_cache, partial
import io
import math
from pathlib import Path
from typing import Any

from papers.campaign import (
    Campaign, ELASTIC, grams, HERE, hub_gauges, KINDS, OUTPUTS, units, write_file)
from papers.fits import Fits, one_model
from papers.look import render, table_lines
import tudor_dynamics as td
import yaml

PRINTED = ('analytical', 'elm')
"""Those of them that the paper has."""
FIGURES = ('rmse', 'sigma_e', 'fit_printed', 'fit')
PARTS = ('training', 'test')
TITLES = {'strain': 'Strain', 'effort': 'Current'}
EVEN = 5.0
"""Spread up to which the figures of several payloads are alike, in points."""
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
class Cell:
    """Figures of one model; None where there is no such model."""

    rmse: float | None  # in the unit of the output
    sigma_e: float | None
    # Eq. (18) as printed, and the fit, with the measured values in the denominator [%]
    fit_printed: float | None
    fit: float | None
    # the paper's own rmse, sigma_e and fit_printed; empty where it has none
    paper: dict[str, float]


@dataclass(frozen=True)
class TableRow:
    """Cells of all models for one payload, in training or test."""

    payload: float  # mass at the tip [kg]
    part: str  # training or test
    cells: dict[str, Cell]  # figures of each model


@dataclass(frozen=True)
class TableBlock:
    """One output: its unit, the channels counted, and rows."""

    output: str  # output, effort or strain
    title: str  # title above it
    unit: str  # unit of the output
    channels: tuple[str, ...]  # channels that are counted
    rows: tuple[TableRow, ...]  # A row for each payload and part


@dataclass(frozen=True)
class PaperClaim:
    """What the paper found, and whether it holds here."""

    text: str  # what was found, in words
    holds: bool  # whether it does here, and the figures that decide
    figures: str
    paper_holds: bool  # the same by the paper's own figures; empty where it has none
    paper: str


def findings(blocks: tuple[TableBlock, ...]) -> list[PaperClaim]:
    """Compare the shape of the table with that of the paper's."""
    def column(output: str, model: str, part: str, name: str, *, paper: bool) -> list[float]:
        block = next(item for item in blocks if item.output == output)
        cells = [row.cells[model] for row in block.rows if row.part == part]
        found = [cell.paper.get(name) if paper else getattr(cell, name) for cell in cells]
        return [math.nan if value is None else value for value in found]

    ours, theirs = (_claims(partial(column, paper=paper)) for paper in (False, True))
    return [PaperClaim(text, holds, figures, paper_holds, paper) for (text, holds, figures), (
        _, paper_holds, paper) in zip(ours, theirs, strict=True) if 'nan' not in figures]


def _claims(column: Callable[[str, str, str, str], list[float]]) -> list[tuple[str, bool, str]]:
    """Say of a table what is to be expected, whether it is so, and by which figures."""
    def shown(values: list[float], digits: int = 1) -> str:
        return ', '.join(f'{value:.{digits}f}' for value in values)

    result = []
    for output in OUTPUTS:
        title = TITLES[output]
        rmse = column(output, 'analytical', 'test', 'rmse')
        result.append((f'{title}: the RMSE does not fall with the payload',
                       all(a <= b for a, b in zip(rmse, rmse[1:], strict=False)),
                       f'analytical, test: {shown(rmse, 1 if output == "strain" else 3)}'))
        values = column(output, 'analytical', 'test', 'fit_printed')
        loaded = values[1:]
        shape, holds = ('lowest with the largest', min(values) == values[-1])
        if output == 'effort':
            shape = f'the others lie within {EVEN:g} points'
            holds = max(loaded) - min(loaded) <= EVEN
        result.append((f'{title}: Eq. (18) is highest without payload, and {shape}',
                       max(values) == values[0] and holds,
                       f'analytical, test: {shown(values)} %'))
        for part, better in (('training', True), ('test', False)):
            gaps = [b - a for a, b in zip(*(
                column(output, model, part, 'fit_printed') for model in ('analytical', 'elm')),
                strict=True)]
            result.append((f'{title}: the ELM is {"better" if better else "worse"} in {part}',
                           all((gap > 0.0) == better for gap in gaps),
                           f'points above the analytical model: {shown(gaps)}'))
    strain, current = (column(output, 'analytical', 'test', 'fit_printed')
                       for output in ('strain', 'effort'))
    result.append(('Current is below strain',
                   all(a > b for a, b in zip(strain, current, strict=True)),
                   f'analytical, test: {shown(current)} % against {shown(strain)} %'))
    return result


@dataclass(frozen=True)
class Shared:
    """Test fits of one output and model: separate models, and one for all [%]."""

    output: str  # output, effort or strain
    model: str  # kind of model
    separate: dict[float, float | None]  # payload [kg] to fit of a model of its own [%]
    together: dict[float, float | None]  # payload [kg] to fit of the one model [%]


@dataclass(frozen=True)
class Table1:
    """The whole table."""

    split: str  # how training and test were split
    blocks: tuple[TableBlock, ...]  # strain, then current
    shared: tuple[Shared, ...]  # one model for all payloads beside separate ones
    trained_at: tuple[float, float]  # payloads that the one model was fitted to [kg]
    findings: tuple[PaperClaim, ...]  # the expected shape
    remarks: tuple[str, ...]  # on how ours were fitted
    notes: tuple[str, ...]  # on the paper's figures
    source: str  # of the paper's figures


@lru_cache
def published() -> dict[str, Any]:
    """Give the paper's figures."""
    text = (HERE / 'published.yaml').read_text(encoding='utf-8')
    content: dict[str, Any] = yaml.safe_load(text)
    return content


def _paper(output: str, model: str, part: str, payload: float) -> dict[str, float]:
    for *place, rmse, sigma_e, printed in published()['cells']:
        if place == [output, part, round(1000 * payload), model]:
            return {'rmse': rmse, 'sigma_e': sigma_e, 'fit_printed': printed}
    return {}


def _cell(output: str, model: str, part: str, payload: float, content: dict[str, Any]) -> Cell:
    paper = _paper(output, model, part, payload)
    found = content.get(output, {}).get(model)
    if found is None:
        return Cell(None, None, None, None, paper)
    values = [float(found[part][name]) for name in FIGURES]
    return Cell(values[0], values[1], values[2], values[3], paper)


def build(fits: Fits, split: str) -> Table1:
    """Compute the table, or put it together from what was computed before."""
    plan, arm = fits.campaign.plan, fits.campaign.arm
    separate = {payload: fits.separate(payload, split=split).content for payload in plan.payloads}
    honest = separate if split == 'stimulus' else {
        payload: fits.separate(payload).content for payload in plan.payloads}
    together = one_model(fits)
    blocks = tuple(_block(arm, output, separate) for output in ('strain', 'effort'))
    shared = []
    for output in ('strain', 'effort'):
        for model in KINDS:
            shared.append(Shared(
                output, model,
                {payload: _test_fit(content.get(output, {}).get(model, {}).get('test'))
                 for payload, content in honest.items()},
                {payload: _test_fit(together[grams(payload)].get(output, {}).get(model))
                 for payload in plan.payloads}))
    return Table1(split, blocks, tuple(shared), (min(plan.payloads), max(plan.payloads)),
                  tuple(findings(blocks)), _remarks(fits, split), tuple(published()['notes']),
                  published()['source'])


def _remarks(fits: Fits, split: str) -> tuple[str, ...]:
    plan = fits.campaign.plan
    if ELASTIC not in plan.kinds:
        return ()
    if split == 'random':
        return ('The elastic model has a memory and no random split; beside the one model of all '
                'payloads it stands with half of the stimuli.',)
    count, of = fits.stimuli_for_search(), plan.stimuli // 2
    return (f'The elastic model is identified from {count} of the {of} training stimuli of each '
            f'payload ({count * plan.seconds:g} of {of * plan.seconds:g} s), and its training '
            'figures are those of these; it is tested on the same stimuli as the other models.',)


def _block(arm: td.Arm, output: str, separate: dict[float, dict[str, Any]]) -> TableBlock:
    found = set(units(arm, output).values())
    sample = next(iter(next(iter(separate.values()))[output].values()))['training']
    hubs = tuple(sample['channels'])
    if output == 'strain':
        hubs = tuple(arm.gauge_names[i] for i in hub_gauges(arm))
    rows = tuple(
        TableRow(payload, part, {model: _cell(output, model, part, payload, content)
                                 for model in KINDS})
        for part in PARTS for payload, content in separate.items())
    unit = found.pop() if len(found) == 1 else 'mixed'
    return TableBlock(output, TITLES[output], unit, hubs, rows)


def _test_fit(figures: dict[str, Any] | None) -> float | None:
    return None if figures is None else float(figures['fit'])


@dataclass(frozen=True)
class Grid:
    """A table of text."""

    title: str  # title above the grid
    groups: tuple[tuple[str, int], ...]  # heads over several columns each, with their number
    heads: tuple[str, ...]  # heads of the columns
    rows: tuple[tuple[str, ...], ...]  # cells of each row
    breaks: tuple[int, ...] = ()  # rows before which a rule is drawn

    def over(self, column: int) -> str:
        """Give the head over a column: that of its group where the group begins."""
        begin = 0
        for name, count in self.groups:
            if begin == column:
                return name
            begin += count
        return EMPTY

    def pieces(self, width: int, gap: int = 2) -> list[list[int]]:
        """Share the groups after the first one out on tables that are not too wide."""
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
    """Lay one output out: a row for payload and part, the paper's columns after ours."""
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


def fit_grid(table: Table1) -> Grid:
    """Lay out the fits on the test stimuli, with the paper's figure after ours."""
    groups, heads = [(EMPTY, 1)], ['payload']
    rows = [[f'{1000 * payload:.0f} g'] for payload in table.shared[0].separate]
    for block in table.blocks:
        groups.append((block.title, len(KINDS) + 1))
        heads += [*KINDS.values(), 'paper, Eq. (18)']
        tests = [row for row in block.rows if row.part == 'test']
        for cells, row in zip(rows, tests, strict=True):
            cells += [_number(row.cells[model].fit, 1) for model in KINDS]
            cells.append(_number(row.cells['analytical'].paper.get('fit_printed'), 2))
    return Grid("Fits on the test stimuli and the paper's Eq. (18), analytical model; all in %",
                tuple(groups), tuple(heads), tuple(map(tuple, rows)))


def shared_grid(table: Table1) -> Grid:
    """Lay out the one model of all payloads, with the separate ones in brackets."""
    titles = {block.output: block.title for block in table.blocks}
    payloads = tuple(table.shared[0].separate)
    low, high = (f'{1000 * value:.0f} g' for value in table.trained_at)
    rows = tuple(
        (f'{titles[item.output]}, {KINDS[item.model]}', *(
            f'{_number(item.together[payload], 1)} ({_number(item.separate[payload], 1)})'
            for payload in payloads))
        for item in table.shared if any(value is not None for value in item.separate.values()))
    return Grid(f'One model for all payloads, fitted at {low} and {high} only; in brackets one '
                'for each payload: fit in % on test stimuli', ((EMPTY, 1), (EMPTY, len(payloads))),
                ('model', *(f'{1000 * payload:.0f} g' for payload in payloads)), rows)


def grids(table: Table1) -> list[Grid]:
    """Lay out everything."""
    return [fit_grid(table), *(block_grid(block) for block in table.blocks), shared_grid(table)]


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
        lines += [f'## {grid.title}', '', *table_lines(heads, grid.rows), '']
    lines += ['## Expected shape', '']
    lines += [f'* {item}' for item in finding_texts(table)]
    lines += ['', "## On the paper's figures", '', *(f'* {note}' for note in table.notes)]
    return '\n'.join(lines) + '\n'


def csv_text(table: Table1) -> str:
    """Write all cells, one a line."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator='\n')

    def exact(value: float | None) -> str:
        return EMPTY if value is None else f'{value:.6g}'

    writer.writerow(['output', 'unit', 'payload_g', 'part', 'model', *FIGURES,
                     *(f'paper_{name}' for name in PAPER), 'one_model_fit'])
    for block in table.blocks:
        for row in block.rows:
            for model in KINDS:
                cell = row.cells[model]
                shared = next(item for item in table.shared
                              if (item.output, item.model) == (block.output, model))
                together = shared.together[row.payload] if row.part == 'test' else None
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
