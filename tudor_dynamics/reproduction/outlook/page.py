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

"""The page of the outlook: a section for each part, what must be reached above its figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import json
from pathlib import Path
from typing import Any

from tudor_dynamics.reproduction.figures.pictures import draw
from tudor_dynamics.reproduction.outlook.part import Section
from tudor_dynamics.reproduction.outlook.parts import PARTS
from tudor_dynamics.reproduction.pages import render, write_file


def content(sections: Mapping[str, Section]) -> dict[str, Any]:
    """
    Give sections as plain values.

    Parameters
    ----------
    sections : mapping of str to Section
        By the name of their part.

    Returns
    -------
    dict
        For each part its ``floors`` and ``data``.

    """
    return {name: {'floors': [asdict(floor) for floor in section.floors],
                   'data': section.data or {}} for name, section in sections.items()}


def write_outlook(sections: Mapping[str, Section], arm: str, out: Path) -> list[Path]:
    """
    Draw the figures, and write the page and its numbers.

    Parameters
    ----------
    sections : mapping of str to Section
        By the name of their part.
    arm : str
        Name of the arm.
    out : Path
        Directory for page and pictures.

    Returns
    -------
    list of Path
        The page and the numbers.

    """
    parts = [(name, PARTS[name], section, draw(section.pictures, out))
             for name, section in sections.items()]
    page, numbers = out / 'outlook.html', out / 'outlook.json'
    write_file(page, render('outlook.html.j2', arm=arm, parts=parts))
    write_file(numbers, json.dumps(content(sections), indent=1, allow_nan=False) + '\n')
    return [page, numbers]
