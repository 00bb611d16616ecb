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

"""Pages of a reproduction; each is one file that needs no other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2

from tudor_dynamics._version import __version__
from tudor_dynamics.errors import UsageError
from tudor_dynamics.files import write_whole
from tudor_dynamics.reproduction.plan import Campaign
from tudor_dynamics.reproduction.table1 import Table1
from tudor_dynamics.reproduction.table_text import (
    csv_text, FIGURE_TEXT, grids, markdown, SPLIT_TEXTS)

_HERE = Path(__file__).parent


def render(template: str, **values: Any) -> str:
    """
    Render a template; everything that is put in is escaped.

    Parameters
    ----------
    template : str
        File of this directory.
    **values
        What it shows.

    Returns
    -------
    str
        HTML.

    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader([_HERE, _HERE.parent / 'report' / 'templates']),
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(template).render(version=__version__, **values)


def write_file(path: Path, content: str | bytes) -> None:
    """
    Write a file, whole or not at all.

    Parameters
    ----------
    path : Path
        File; one that is there is replaced.
    content : str or bytes
        Content of the file.

    Raises
    ------
    UsageError
        If it cannot be written.

    """
    data = content.encode() if isinstance(content, str) else content
    try:
        write_whole(path, data)
    except OSError as err:
        msg = f'{path}: cannot be written ({err.strerror or err}); give another --out'
        raise UsageError(msg) from None


def write_table(table: Table1, campaign: Campaign, out: Path) -> list[Path]:
    """
    Write Table I as CSV, Markdown and page.

    Parameters
    ----------
    table : Table1
        Table with its findings.
    campaign : Campaign
        What was recorded.
    out : Path
        Directory for the page.

    Returns
    -------
    list of Path
        Files, the page first.

    """
    page = render('table1.html.j2', arm=campaign.arm.name, plan=campaign.plan, table=table,
                  grids=grids(table), split=SPLIT_TEXTS[table.split], figure_text=FIGURE_TEXT)
    files = {'table1.html': page, 'table1.md': markdown(table), 'table1.csv': csv_text(table)}
    for name, content in files.items():
        write_file(out / name, content)
    return [out / name for name in files]
