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

"""What a part of the outlook is given, and what it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from tudor_dynamics.reproduction.figures.pictures import Picture
from tudor_dynamics.reproduction.plan import Campaign


@dataclass(frozen=True, eq=False)
class Setting:
    """
    What a part computes with.

    Attributes
    ----------
    name : str
        Name of the part, before all that it reports.
    campaign : Campaign
        Arm and seed, recordings on demand, and the stages that results are kept in.
    quick : bool
        Seconds instead of minutes, to see that all of it works; floors do not hold then.
    data : Path or None
        Directory of bags and arm descriptions that are no part of the package (``bags/NAME``,
        ``arms/NAME.yaml``); None where there are none.

    """

    name: str
    campaign: Campaign
    quick: bool = False
    data: Path | None = None

    def progress(self, text: str, share: float) -> None:
        """
        Tell what is done now.

        Parameters
        ----------
        text : str
            What is done.
        share : float
            How much of the whole part is done (0 to 1).

        """
        self.campaign.progress(f'{self.name}: {text}', share)

    def bag(self, name: str) -> Path | None:
        """
        Give a bag of the other recordings; None where it is not there.

        Parameters
        ----------
        name : str
            Directory of the bag.

        """
        return self._other('bags', name)

    def arm(self, name: str) -> Path | None:
        """
        Give an arm description of the other recordings; None where it is not there.

        Parameters
        ----------
        name : str
            File without suffix.

        """
        return self._other('arms', f'{name}.yaml')

    def _other(self, folder: str, name: str) -> Path | None:
        path = None if self.data is None else self.data / folder / name
        return path if path is not None and path.exists() else None


@dataclass(frozen=True)
class Floor:
    """
    What a part must reach, and what it reaches.

    Attributes
    ----------
    what : str
        What is measured, on what.
    wanted, reached : str
        Both with their units.
    met : bool or None
        Whether it is reached; None where it could not be measured (`reached` says why).

    """

    what: str
    wanted: str
    reached: str
    met: bool | None


@dataclass(frozen=True, eq=False)
class Section:
    """
    Section of the page.

    Attributes
    ----------
    text : tuple of str
        Paragraphs above the figures.
    floors : tuple of Floor
        What must be reached.
    pictures : tuple of Picture
        Figures; the file of each begins with the name of the part.
    data : dict
        Figures as plain values, for programs.

    """

    text: tuple[str, ...]
    floors: tuple[Floor, ...] = ()
    pictures: tuple[Picture, ...] = ()
    data: dict[str, Any] | None = None


Compute = Callable[[Setting], Section]
"""What the module of a part offers under the name ``section``."""


def compute_of(name: str) -> Compute:
    """
    Give what computes a part; its module is imported now.

    Parameters
    ----------
    name : str
        One of `parts.PARTS`.

    Returns
    -------
    callable
        Gives the section of a setting.

    """
    return cast(Compute, import_module(f'{__package__}.{name}').section)
