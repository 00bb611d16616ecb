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

"""
How the report draws: layout, labels, SVG as data URI.

Through matplotlib's object interface, without pyplot and its global state.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
import io
from pathlib import Path
import re
from typing import Any

from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from tudor_dynamics.files import write_whole
from tudor_dynamics.report.wording import pretty_name, pretty_unit

WIDTH = 8.2
"""Width of all figures [inch]; the page scales them to its column."""

METADATA = {'Date': None, 'Creator': None, 'Format': None, 'Type': None}


def label(name: str, unit: str = '') -> str:
    """Write a channel with its unit; unit: none if empty."""
    return f'{pretty_name(name)} [{pretty_unit(unit)}]' if unit else pretty_name(name)


def plain_text(setter: Any, text: str) -> None:
    """Set a text in which dollar signs are dollar signs: names are not ours."""
    setter(text).set_parse_math(False)


def to_uri(figure: Figure) -> str:
    """Write a figure as SVG into a data URI."""
    stream = io.BytesIO()
    # not savefig: it draws everything twice
    canvas: Any = FigureCanvasSVG(figure)
    canvas.print_svg(stream, metadata=METADATA)
    # a hundredth of a point is enough for a line, and half the size
    text = re.sub(rb' d="[^"]*"', lambda path: re.sub(rb'(\.\d\d)\d+', rb'\1', path[0]),
                  stream.getvalue())
    return 'data:image/svg+xml;base64,' + base64.b64encode(text).decode('ascii')


def new_figure(
    columns: int, heights: Sequence[float], gaps: Sequence[float], *, between: float = 0.5,
) -> tuple[Figure, list[list[Any]]]:
    """Lay out a figure by lengths in inches; matplotlib's own layout is slow."""
    left, right, bottom = 0.75, 0.08, 0.45
    height = sum(heights) + sum(gaps) + bottom
    width = (WIDTH - left - right - between * (columns - 1)) / columns
    figure = Figure(figsize=(WIDTH, height))
    rows = []
    top = height
    for tall, gap in zip(heights, gaps, strict=True):
        top -= gap + tall
        begins = [left + k * (width + between) for k in range(columns)]
        rows.append([figure.add_axes(
            (begin / WIDTH, top / height, width / WIDTH, tall / height)) for begin in begins])
    return figure, rows


def write_figure(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all."""
    stream = io.BytesIO()
    figure.savefig(stream, format=path.suffix[1:], dpi=150)
    write_whole(path, stream.getvalue())
