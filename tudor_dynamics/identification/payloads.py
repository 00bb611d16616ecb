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

"""Which payload each bag was recorded with, and models that know of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from tudor_dynamics.errors import UsageError
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.dataset import BagData
from tudor_dynamics.models.base import Model, Range
from tudor_dynamics.models.payload import SAME


class Loaded(Protocol):
    """A bag of which it is said what the arm carried."""

    @property
    def choice(self) -> BagChoice:
        """Bag, or part of one."""

    @property
    def payload(self) -> float | None:
        """Mass at the tip, where it is known [kg]."""


def parse_payloads(texts: Sequence[str], choices: Sequence[BagChoice]) -> dict[str, float]:
    """Read ``BAG=KG`` arguments [kg]."""
    known = {str(Path(choice.path).resolve()) for choice in choices}
    found = {}
    for text in texts:
        path, mark, number = text.rpartition('=')
        try:
            mass = float(number)
        except ValueError:
            mass = -1.0
        if not mark or not 0.0 <= mass < float('inf'):
            msg = (f'--payload-of {text}: expected BAG=KG with a mass of 0 or more, such as '
                   'run1=0.2')
            raise UsageError(msg)
        resolved = str(Path(path).resolve())
        if resolved not in known:
            msg = f'--payload-of {text}: {path} is none of the bags of this command'
            raise UsageError(msg)
        found[resolved] = mass
    return found


def payload_range(training: Sequence[Loaded], test: Sequence[Loaded]) -> Range | None:
    """
    Find the payloads of a fit.

    Returns least and largest payload of the training bags [kg], None where they do not differ.
    """
    masses = [bag.payload for bag in training if bag.payload is not None]
    if not masses or max(masses) - min(masses) < SAME:
        return None
    unknown = [str(bag.choice) for bag in (*training, *test) if bag.payload is None]
    if unknown:
        msg = (f'the training bags have payloads of {min(masses):g} to {max(masses):g} kg, but '
               f'that of {", ".join(unknown)} is not known: say so with --payload-of BAG=KG, or '
               'use --ignore-payload')
        raise UsageError(msg)
    return min(masses), max(masses)


def model_for(model: Model, bag: BagData) -> Model:
    """Put the payload of a bag into a model that knows of payloads; others stay as they are."""
    if model.payload_range is not None:
        if bag.payload is None:
            msg = (f'{bag.choice}: its payload is not known, and the model needs it: give '
                   '--payload KG, or --payload-of BAG=KG')
            raise UsageError(msg)
        return model.at(bag.payload)
    return model
