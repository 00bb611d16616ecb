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

"""How figures and pages look: lines, colours, legends, files."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
import io
from pathlib import Path
from typing import Any

import jinja2
import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from papers.campaign import HERE, write_file
import tudor_dynamics as td

BLUE, VERMILION = '#0072b2', '#d55e00'
"""Of Okabe and Ito, as all colours here: colour-blind readers tell them apart."""
STYLE: Any = {
    'axes.axisbelow': True, 'axes.grid': True, 'axes.spines.right': False,
    'axes.spines.top': False, 'axes.titlelocation': 'left', 'grid.color': '#dddddd',
    'grid.linewidth': 0.6, 'legend.frameon': False, 'path.simplify': True,
    # ids come from the content alone, so that equal results give equal files
    'svg.hashsalt': 'tudor_dynamics', 'font.size': 9.0, 'axes.titlesize': 9.5,
    'axes.labelsize': 9.0, 'legend.fontsize': 8.5, 'legend.handlelength': 2.8,
    'xtick.labelsize': 8.5, 'ytick.labelsize': 8.5, 'svg.fonttype': 'path'}
MEASURED: dict[str, Any] = {'color': '#a3a3a3', 'linewidth': 2.6, 'linestyle': '-',
                            'solid_capstyle': 'round', 'label': 'measured'}
MODELS: dict[str, dict[str, Any]] = {
    'analytical': {'color': BLUE, 'linewidth': 1.1, 'linestyle': '-'},
    'elm': {'color': VERMILION, 'linewidth': 1.1, 'linestyle': (0, (4, 1.6))},
    'elastic': {'color': '#00785a', 'linewidth': 1.1, 'linestyle': (0, (5, 1.4, 1, 1.4))}}
"""Every line has a style of its own, so that prints in grey stay legible."""
WIDTH = 7.2
"""Inches: two columns of a paper."""
DPI = 130

MARKERS = {'analytical': 'o', 'elm': 's', 'elastic': '^'}
DAMPED: dict[str, Any] = {'color': BLUE, 'linewidth': 1.5, 'linestyle': '-',
                          'label': 'damped'}
UNDAMPED: dict[str, Any] = {'color': '#e08b3a', 'linewidth': 1.1, 'linestyle': '-',
                            'label': 'undamped'}
CURVES: tuple[dict[str, Any], ...] = (
    {'color': BLUE, 'linestyle': '-'}, {'color': VERMILION, 'linestyle': (0, (4, 1.6))},
    {'color': '#111111', 'linestyle': (0, (1, 1.2))},
    {'color': '#b2669a', 'linestyle': (0, (5, 1.4, 1, 1.4))})


def new_figure(height: float, rows: int, columns: int = 1, **more: Any) -> tuple[Figure, Any]:
    """Make a figure with axes."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **more)


def legend_above(figure: Figure, axes: Any, columns: int = 4) -> None:
    """Put the legend of some axes above the figure, where it covers nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper right', ncols=columns, borderpad=0.1)


def unit(text: str) -> str:
    """Write a unit as it is printed."""
    return text.replace('um/m', 'µm/m')


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure to be drawn: file without suffix, and what the page says of it."""

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class Shown:
    """A figure on the page: as a `Picture`, with its content as data URI."""

    name: str
    section: str
    title: str
    caption: str
    uri: str


def draw(pictures: Sequence[Picture], out: Path) -> list[Shown]:
    """Draw pictures as SVG and PNG; the same figure gives the same bytes."""
    shown = []
    for picture in pictures:
        with matplotlib.rc_context():
            matplotlib.rcdefaults()
            matplotlib.rcParams.update(STYLE)
            content = _save(picture.draw(), out, picture.name)
        uri = f'data:image/svg+xml;base64,{base64.b64encode(content).decode("ascii")}'
        shown.append(Shown(picture.name, picture.section, picture.title, picture.caption, uri))
    return shown


def _save(figure: Figure, out: Path, name: str) -> bytes:
    """Write a figure as SVG and PNG, and give the former."""
    written = []
    for suffix, canvas, metadata in (
            ('svg', FigureCanvasSVG, {'Date': None, 'Creator': 'tudor_dynamics'}),
            ('png', FigureCanvasAgg, {'Software': 'tudor_dynamics'})):
        stream = io.BytesIO()
        chosen: Any = canvas
        chosen(figure)
        figure.savefig(stream, format=suffix, dpi=DPI, metadata=metadata)
        written.append(stream.getvalue())
        write_file(out / f'{name}.{suffix}', written[-1])
    return written[0]


def table_lines(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Write a table in Markdown, as ``tools/figures.py`` reads it too."""
    return [f'| {" | ".join(cells)} |' for cells in (head, ['---'] * len(head), *rows)]


def render(template: str, **values: Any) -> str:
    """Render a page from a template of this directory; everything that is put in is escaped."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(HERE), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True)
    return environment.get_template(template).render(version=td.__version__, **values)
