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

"""The paper's Table I as it is kept here, and what is said of its shape."""

from __future__ import annotations

import csv
from pathlib import Path

from papers.campaign import KINDS
from papers.table1 import (
    block_grid, Cell, findings, PARTS, published, TableBlock, TableRow, TITLES)
import pytest

PAYLOADS = (0, 100, 200, 300, 400)


def papers_own() -> tuple[TableBlock, ...]:
    """Lay the paper's figures out as if they were ours."""
    known = {(output, part, payload, model): Cell(rmse, sigma, printed, None, {
        'rmse': rmse, 'sigma_e': sigma, 'fit_printed': printed})
        for output, part, payload, model, rmse, sigma, printed in published()['cells']}
    none = Cell(None, None, None, None, {})
    return tuple(TableBlock(output, TITLES[output], '', (), tuple(
        TableRow(1e-3 * payload, part, {model: known.get((output, part, payload, model), none)
                                        for model in KINDS})
        for part in PARTS for payload in PAYLOADS)) for output in ('strain', 'effort'))


def test_every_cell_once() -> None:
    """Two outputs, two parts, five payloads, two models; the spread that a row means is alike."""
    cells = published()['cells']
    assert len({tuple(cell[:4]) for cell in cells}) == len(cells) == 40
    for output, part, payload, model, rmse, _, printed in cells:
        spread = rmse / (1.0 - printed / 100.0)
        misprint = (output, part, payload, model) == ('effort', 'training', 200, 'analytical')
        low, high = (130.0, 260.0) if output == 'strain' else (0.33, 0.65)
        assert (low < spread < high) is not misprint, (output, part, payload, model)


@pytest.mark.parametrize('width', [78, 60, 200])
def test_tables_fit_a_terminal(width: int) -> None:
    """Every group of columns stands in one piece, once, and pieces are as narrow as they can."""
    for block in papers_own():
        grid = block_grid(block)
        pieces = grid.pieces(width)
        assert [column for piece in pieces for column in piece] == list(
            range(2, len(grid.heads)))
        assert (len(pieces) == 1) == (width == 200)
        for piece in pieces:
            shown = sum(2 + max(len(row[column]) for row in (grid.heads, *grid.rows))
                        for column in (0, 1, *piece))
            assert shown <= width or len({grid.over(column) for column in piece} - {''}) == 1


def test_what_is_said_of_the_paper_is_so() -> None:
    """Each finding holds for the paper's own figures; the current's is no steady fall."""
    found = findings(papers_own())
    assert len(found) == 9
    for item in found:
        assert item.holds and item.paper_holds and item.figures == item.paper, item.text
    current = next(item for item in found if item.text.startswith('Current: Eq. (18)'))
    assert '64.0, 55.6, 52.8, 54.8, 57.0 %' in current.paper


def test_sigma_is_no_deviation_of_the_norm() -> None:
    """Of two channels that could not exceed sqrt(2) times the RMSE: the note says the figure."""
    ratios = [cell[5] / cell[4] for cell in published()['cells'] if cell[0] == 'strain']
    assert max(ratios) == pytest.approx(1.517, abs=1e-3)
    assert any('1.52' in note for note in published()['notes'])


@pytest.mark.shared
def test_cells_are_the_papers(shared_data: Path) -> None:
    """The same as in the table that was taken down from the paper."""
    names = {'strain': 'strain', 'current': 'effort'}
    with (shared_data / 'table1_malzahn.csv').open() as file:
        expected = {(names[r['output']], r['part'], int(r['payload_g']), r['model']): [
            float(r[name]) for name in ('rmse', 'sigma_e', 'fit')] for r in csv.DictReader(file)}
    assert {tuple(cell[:4]): cell[4:] for cell in published()['cells']} == expected
