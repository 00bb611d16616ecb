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

"""``tudor reproduce table1``: Table I of Malzahn et al., and one model for all payloads."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path
import time
from typing import Any

from tudor_dynamics.cli.console import finite, new_table, print_json, print_table
from tudor_dynamics.cli.reproduce.campaign_options import opened
from tudor_dynamics.reproduction.fits import Fits
from tudor_dynamics.reproduction.pages import write_table
from tudor_dynamics.reproduction.table1 import build, LABELS, MODELS, Table1
from tudor_dynamics.reproduction.table_text import (
    FIGURE_TEXT, finding_texts, Grid, grids, SPLIT_TEXTS)

NARROW = 78
"""Characters of a table, so that it stands whole on the narrowest of terminals."""


def run(args: argparse.Namespace) -> int:
    """Record, fit, print and write."""
    begun = time.perf_counter()
    out = Path(args.out)
    with opened(args) as campaign:
        table = build(Fits(campaign), args.split)
        files = write_table(table, campaign, out)
    seconds = time.perf_counter() - begun
    if args.json:
        print_json(finite({'out': str(out), 'seconds': round(seconds, 1), **_content(table)}))
        return 0
    for grid in grids(table):
        _print(grid)
    missing = [LABELS[model] for model in MODELS if all(
        row.cells[model].fit is None for block in table.blocks for row in block.rows)]
    if missing:
        print(f'{", ".join(missing)}: no figures, this kind of model was not fitted')
    print(f'{SPLIT_TEXTS[table.split]}; {FIGURE_TEXT}')
    for remark in table.remarks:
        print(remark)
    print('expected shape:')
    for text in finding_texts(table):
        print(f'  {text}')
    print(f'{seconds:.0f} s; {", ".join(str(file) for file in files)}')
    return 0


def _content(table: Table1) -> dict[str, Any]:
    return asdict(table)


def _print(grid: Grid) -> None:
    first = grid.groups[0][1]
    title = grid.title
    for columns in grid.pieces(NARROW):
        table = new_table(title, names=[f'\n{head}' for head in grid.heads[:first]], figures=[
            f'{grid.over(column)}\n{grid.heads[column]}' for column in columns])
        for number, row in enumerate(grid.rows):
            if number in grid.breaks:
                table.add_section()
            table.add_row(*row[:first], *(row[column] for column in columns))
        print_table(table)
        title = ''
