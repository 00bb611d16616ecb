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

"""Table I: its cells, and what the paper concluded from them, ours beside the paper's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math

from tudor_dynamics.identification.dataset import OUTPUTS

PARTS = ('training', 'test')
TITLES = {'strain': 'Strain', 'effort': 'Current'}
EVEN = 5.0
"""Spread up to which the figures of several payloads are alike, in points."""


@dataclass(frozen=True)
class Cell:
    """
    Figures of one model; None where there is no such model.

    Attributes
    ----------
    rmse, sigma_e : float or None
        In the unit of the output.
    fit_printed, fit : float or None
        Eq. (18) as printed, and the fit, with the measured values in the denominator [%].
    paper : dict of str to float
        The paper's own ``rmse``, ``sigma_e`` and ``fit_printed``; empty where it has none.

    """

    rmse: float | None
    sigma_e: float | None
    fit_printed: float | None
    fit: float | None
    paper: dict[str, float]


@dataclass(frozen=True)
class TableRow:
    """
    Cells of all models for one payload, in training or test.

    Attributes
    ----------
    payload : float
        Mass at the tip [kg].
    part : str
        Training or test.
    cells : dict of str to Cell
        Figures of each model.

    """

    payload: float
    part: str
    cells: dict[str, Cell]


@dataclass(frozen=True)
class TableBlock:
    """
    One output: its unit, the channels counted, and rows.

    Attributes
    ----------
    output : str
        Output, ``effort`` or ``strain``.
    title : str
        Title above it.
    unit : str
        Unit of the output.
    channels : tuple of str
        Channels that are counted.
    rows : tuple of TableRow
        A row for each payload and part.

    """

    output: str
    title: str
    unit: str
    channels: tuple[str, ...]
    rows: tuple[TableRow, ...]


@dataclass(frozen=True)
class PaperClaim:
    """
    What the paper found, and whether it holds here.

    Attributes
    ----------
    text : str
        What was found, in words.
    holds, figures : bool and str
        Whether it does here, and the figures that decide.
    paper_holds, paper : bool and str
        The same by the paper's own figures; empty where it has none.

    """

    text: str
    holds: bool
    figures: str
    paper_holds: bool
    paper: str


def findings(blocks: tuple[TableBlock, ...]) -> list[PaperClaim]:
    """
    Compare the shape of the table with that of the paper's.

    Parameters
    ----------
    blocks : tuple of TableBlock
        Strain, then current.

    Returns
    -------
    list of PaperClaim
        Each with the figures that decide, ours and the paper's; none on a model not fitted.

    """
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
    for output in OUTPUTS[::-1]:
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
