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

"""What a fleet came to: numbers by arm and date, and which arms are named for what."""

from __future__ import annotations

from dataclasses import asdict, dataclass
import datetime
from typing import Any

from tudor_dynamics.identification.bag_facts import Unused
from tudor_dynamics.identification.fleet.quantities import Quantity

WORDS = {'unlike': 'unlike the others', 'drift': 'drifts', 'aged': 'its model has aged'}
"""Kinds of what an arm is named for."""


@dataclass(frozen=True)
class Seen:
    """A number of an arm at a date."""

    arm: str  # name of the arm
    date: datetime.date  # when it was recorded
    # What it was found in: `effort`, `strain`, `ring` of the strain at rest, or the `elastic`
    # model.
    output: str
    quantity: Quantity  # what it is, with its standard error

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        item = self.quantity
        return {'arm': self.arm, 'date': self.date.isoformat(), 'output': self.output,
                'quantity': item.name, 'channel': item.channel, 'unit': item.unit,
                'value': item.value, 'standard_error': item.error}


@dataclass(frozen=True)
class Named:
    """Something that an arm is named for."""

    # Which arm; one of `WORDS`.
    arm: str
    kind: str
    # Quantity and channel; unit of the values.
    what: str
    unit: str
    # Its value; that of the other arms, of its first date, or of its validation.
    value: float
    expected: float
    sigmas: float  # their difference over its standard error

    def __str__(self) -> str:
        """Write it on one line."""
        beside = {'unlike': 'the others', 'drift': 'at first', 'aged': 'when it was new'}
        return (f'{self.arm}: {WORDS[self.kind]}: {self.what}: {self.value:.3g} {self.unit}, '
                f'{beside[self.kind]} {self.expected:.3g} ({self.sigmas:+.1f} standard errors)')

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Fleet:
    """A fleet that was fitted and compared."""

    name: str  # what it is called
    arms: tuple[str, ...]  # names of the arms
    seen: tuple[Seen, ...]  # all numbers, of each arm at each of its dates
    named: tuple[Named, ...]  # arms that are named, and what for
    choices: tuple[str, ...]  # what was chosen for all arms, in words
    models: dict[str, str]  # arm to the folder of its model, below that of the fleet
    unused: tuple[Unused, ...]  # bags, dates and models that were left out

    def as_dict(self) -> dict[str, Any]:
        """Give it as plain values."""
        return {'name': self.name, 'arms': list(self.arms), 'models': self.models,
                'named': [item.as_dict() for item in self.named],
                'quantities': [item.as_dict() for item in self.seen],
                'choices': list(self.choices), 'unused': [asdict(item) for item in self.unused]}
