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

"""What the first paper names as its outlook, computed part by part; its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
import json
from pathlib import Path
from typing import Any, cast

from papers.campaign import Campaign, write_file
from papers.look import draw, Picture, render, table_lines

PARTS: dict[str, str] = {
    'payload': 'Payload',
    'contact': 'Contact',
    'force': 'Force control',
    'damping': 'Load-adaptive damping',
    'shaping': 'Shaped references',
}
"""Name of a part to its title on the page. Its module, of the same name beside this one, has a
function ``section``, see `Compute`."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What a part computes with."""

    name: str  # name of the part, before all that it reports
    # arm and seed, recordings on demand, and the stages that results are kept in
    campaign: Campaign
    # seconds instead of minutes, to see that all of it works; floors do not hold then
    quick: bool = False

    def progress(self, text: str, share: float) -> None:
        """Tell what is done now."""
        self.campaign.progress(f'{self.name}: {text}', share)


@dataclass(frozen=True)
class Floor:
    """What a part must reach, and what it reaches."""

    what: str  # what is measured, on what
    wanted: str  # both with their units
    reached: str
    # whether it is reached; None where it could not be measured (`reached` says why)
    met: bool | None


@dataclass(frozen=True, eq=False)
class Section:
    """Section of the page."""

    text: tuple[str, ...]  # paragraphs above the figures
    floors: tuple[Floor, ...] = ()  # what must be reached
    # Figures; the file of each begins with the name of the part
    pictures: tuple[Picture, ...] = ()
    data: dict[str, Any] | None = None  # figures as plain values, for programs
    grid: tuple[tuple[str, ...], ...] = ()  # a table more: its head, then its rows


Compute = Callable[[Setting], Section]
"""What the module of a part offers under the name ``section``."""


def compute_of(name: str) -> Compute:
    """Give what computes a part; its module is imported now."""
    return cast(Compute, import_module(f'{__package__}.{name}').section)


def content(sections: Mapping[str, Section]) -> dict[str, Any]:
    """Give sections as plain values."""
    return {name: {'floors': [asdict(floor) for floor in section.floors],
                   'data': section.data or {}} for name, section in sections.items()}


def write_outlook(sections: Mapping[str, Section], arm: str, out: Path) -> list[Path]:
    """Draw the figures, and write the page, its tables and its numbers."""
    parts = [(name, PARTS[name], section, draw(section.pictures, out))
             for name, section in sections.items()]
    page, tables, numbers = (out / f'outlook.{suffix}' for suffix in ('html', 'md', 'json'))
    write_file(page, render('outlook.html.j2', arm=arm, parts=parts))
    write_file(tables, markdown(sections))
    write_file(numbers, json.dumps(content(sections), indent=1, allow_nan=False) + '\n')
    return [page, tables, numbers]


def markdown(sections: Mapping[str, Section]) -> str:
    """Write the tables of sections."""
    lines: list[str] = []
    for name, section in sections.items():
        lines += [f'# {PARTS[name]}', '', *table_lines(('what', 'must reach', 'reached'), [
            (floor.what, floor.wanted, floor.reached) for floor in section.floors]), '']
        if section.grid:
            lines += [*table_lines(section.grid[0], section.grid[1:]), '']
    return '\n'.join(lines)
