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

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
import math
from typing import Any

from papers.campaign import ELASTIC, grams, HERE, hub_gauges, KINDS, OUTPUTS, units
from papers.fits import Fits, one_model
import tudor_dynamics as td
import yaml

PRINTED = ('analytical', 'elm')
"""Those of them that the paper has."""
FIGURES = ('rmse', 'sigma_e', 'fit_printed', 'fit')
PARTS = ('training', 'test')
TITLES = {'strain': 'Strain', 'effort': 'Current'}
EVEN = 5.0
"""Spread up to which the figures of several payloads are alike, in points."""


@dataclass(frozen=True)
class Cell:
    """Figures of one model; None where there is no such model."""

    rmse: float | None  # In the unit of the output
    sigma_e: float | None
    # Eq. (18) as printed, and the fit, with the measured values in the denominator [%]
    fit_printed: float | None
    fit: float | None
    # The paper's own rmse, sigma_e and fit_printed; empty where it has none
    paper: dict[str, float]


@dataclass(frozen=True)
class TableRow:
    """Cells of all models for one payload, in training or test."""

    payload: float  # Mass at the tip [kg]
    part: str  # Training or test
    cells: dict[str, Cell]  # Figures of each model


@dataclass(frozen=True)
class TableBlock:
    """One output: its unit, the channels counted, and rows."""

    output: str  # Output, effort or strain
    title: str  # Title above it
    unit: str  # Unit of the output
    channels: tuple[str, ...]  # Channels that are counted
    rows: tuple[TableRow, ...]  # A row for each payload and part


@dataclass(frozen=True)
class PaperClaim:
    """What the paper found, and whether it holds here."""

    text: str  # What was found, in words
    holds: bool  # Whether it does here, and the figures that decide
    figures: str
    paper_holds: bool  # The same by the paper's own figures; empty where it has none
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

    output: str  # Output, effort or strain
    model: str  # Kind of model
    separate: dict[float, float | None]  # Payload [kg] to fit of a model of its own [%]
    together: dict[float, float | None]  # Payload [kg] to fit of the one model [%]


@dataclass(frozen=True)
class Table1:
    """The whole table."""

    split: str  # How training and test were told apart
    blocks: tuple[TableBlock, ...]  # Strain, then current
    shared: tuple[Shared, ...]  # One model for all payloads beside separate ones
    trained_at: tuple[float, float]  # Payloads that the one model was fitted to [kg]
    findings: tuple[PaperClaim, ...]  # The expected shape
    remarks: tuple[str, ...]  # On how ours were fitted
    notes: tuple[str, ...]  # On the paper's figures
    source: str  # Of the paper's figures


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
