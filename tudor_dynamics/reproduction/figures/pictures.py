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

"""Pictures of a page: what they are, drawn into files and for the page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from tudor_dynamics.report.style import PRINT, style
from tudor_dynamics.reproduction.figures import look


@dataclass(frozen=True, eq=False)
class Picture:
    """
    A figure to be drawn.

    Attributes
    ----------
    name : str
        File without suffix.
    section, title, caption : str
        On the page.
    draw : callable
        Gives the figure.

    """

    name: str
    section: str
    title: str
    caption: str
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class Shown:
    """
    A figure on the page: as a `Picture`, with its content as data URI.

    Attributes
    ----------
    name : str
        Name of the picture's file.
    section : str
        Section of the page.
    title : str
        Title above it.
    caption : str
        Text below it.
    uri : str
        Its content as data URI.

    """

    name: str
    section: str
    title: str
    caption: str
    uri: str


def draw(pictures: Sequence[Picture], out: Path) -> list[Shown]:
    """
    Draw pictures as SVG and PNG.

    Parameters
    ----------
    pictures : sequence of Picture
        In the order of the page.
    out : Path
        Directory for the files.

    Returns
    -------
    list of Shown
        The same, for the page.

    """
    shown = []
    for picture in pictures:
        with style(PRINT):
            look.save(picture.draw(), out, picture.name)
        content = base64.b64encode((out / f'{picture.name}.svg').read_bytes()).decode('ascii')
        shown.append(Shown(picture.name, picture.section, picture.title, picture.caption,
                           f'data:image/svg+xml;base64,{content}'))
    return shown
