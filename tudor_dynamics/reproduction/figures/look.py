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

"""What all figures of a reproduction share: widths, lines, legends, files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from tudor_dynamics.report.style import BLUE, VERMILION
from tudor_dynamics.reproduction.pages import write_file

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
    """
    Make a figure with axes.

    Parameters
    ----------
    height : float
        Height of the figure [inch].
    rows, columns : int
        Number of axes each way.
    **more
        As for ``Figure.subplots``.

    Returns
    -------
    figure : Figure
        Figure.
    axes : ndarray of Axes, shape (rows, columns)
        Axes.

    """
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **more)


def legend_above(figure: Figure, axes: Any, columns: int = 4) -> None:
    """
    Put the legend of some axes above the figure, where it covers nothing.

    Parameters
    ----------
    figure : Figure
        Figure that gets the legend.
    axes : Axes
        Axes whose lines it explains.
    columns : int
        Columns of the legend.

    """
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside upper right', ncols=columns, borderpad=0.1)


def unit(text: str) -> str:
    """
    Write a unit as it is printed.

    Parameters
    ----------
    text : str
        Unit as it stands in the code.

    """
    return text.replace('um/m', 'µm/m')


def save(figure: Figure, out: Path, name: str) -> None:
    """
    Write a figure as SVG and PNG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : Figure
        Figure, made within `style(PRINT)`.
    out : Path
        Directory for the picture.
    name : str
        File without suffix.

    """
    for suffix, canvas, metadata in (
            ('svg', FigureCanvasSVG, {'Date': None, 'Creator': 'tudor_dynamics'}),
            ('png', FigureCanvasAgg, {'Software': 'tudor_dynamics'})):
        stream = io.BytesIO()
        chosen: Any = canvas
        chosen(figure)
        figure.savefig(stream, format=suffix, dpi=DPI, metadata=metadata)
        write_file(out / f'{name}.{suffix}', stream.getvalue())
