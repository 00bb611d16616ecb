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

"""What is asked of every bag of many, and under which name what it came to is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
import hashlib
import json
from pathlib import Path

from tudor_dynamics.arm import Arm, PreprocessingSpec
from tudor_dynamics.identification.bag_choice import BagChoice
from tudor_dynamics.identification.dataset import BagData, load
from tudor_dynamics.identification.fit import FitSettings
from tudor_dynamics.models.analytical import AnalyticalModel
from tudor_dynamics.source_digest import source_digest

PARTS = ('arm', 'bags', 'signals', 'models', 'identification')
"""Parts of the package that sums depend on."""
Place = tuple[int, str]
"""Number of the filters among those of a task, and the output."""


@dataclass(frozen=True)
class Sight:
    """A bag before it is read."""

    choice: BagChoice  # bag, or part of one, as it was given
    checksum: str  # SHA-256 over its storage files
    payload: float | None = None  # mass at the tip, as given or as its metadata say [kg]
    fold: int = -1  # which bags it is left out with


@dataclass(frozen=True, eq=False)
class Task:
    """What is asked of every bag."""

    arm: Arm  # arm that was recorded, its friction settled
    # Filters and rates; all of them are gone through in one reading.
    specs: tuple[PreprocessingSpec, ...]
    outputs: tuple[str, ...]  # outputs that every bag must have
    settings: FitSettings  # settings with nothing left open
    base: Path  # directory that the names of bags are relative to
    folder: Path  # where sums are kept
    # Version of the package, by its sources.
    source: str = field(default_factory=lambda: source_digest(PARTS))
    # Bags, by the names they were given by, that stand elsewhere than these say.
    sent: Mapping[str, Path] = field(default_factory=dict)

    @property
    def with_payload(self) -> bool:
        """Say whether one model of all payloads is fitted."""
        return self.settings.payloads is not None

    def place(self, seen: Sight) -> Path:
        """Say where a bag stands."""
        return self.sent.get(seen.choice.path, self.base / seen.choice.path)

    def read(self, seen: Sight) -> BagData:
        """Read a bag by the first filters, under the name that it was given by."""
        there = replace(seen.choice, path=str(self.place(seen)))
        bag = load(there, self.arm, self.specs[0], learn=True, payload=seen.payload)
        return replace(bag, choice=replace(bag.choice, path=seen.choice.path))

    def file(self, seen: Sight, suffix: str, depends: str = '') -> Path:
        """Name the file of what a bag comes to; other settings or sources are another file."""
        choice = seen.choice
        own = json.dumps([choice.begin, choice.end, choice.seconds, choice.path, seen.payload,
                          self._digest, depends])
        return self.folder / (f'{seen.checksum[:24]}-'
                              f'{hashlib.sha256(own.encode()).hexdigest()[:16]}{suffix}')

    @cached_property
    def _digest(self) -> str:
        arm, settings = self.arm, self.settings
        return json.dumps([
            self.source, arm.digest, arm.spec.model_dump_json(),
            [spec.model_dump_json() for spec in self.specs], self.outputs, settings.strain_form,
            settings.shared, self.with_payload])


Models = Mapping[Place, AnalyticalModel]


def digest_of(models: Models) -> str:
    """Give a digest of what models predict."""
    digest = hashlib.sha256()
    for place, model in models.items():
        digest.update(repr(place).encode() + model.coefficients().tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Trial:
    """Bags with the models that are judged by them."""

    task: Task  # what is asked of every bag
    bags: tuple[Sight, ...]  # bags to predict
    # Models that have not seen these bags, and models that have; either may be none.
    unseen: Models
    seen: Models

    def file(self, seen: Sight) -> Path:
        """Name the file of how the models did on a bag."""
        return self.task.file(seen, '.json', self._digest)

    @cached_property
    def _digest(self) -> str:
        return digest_of(self.unseen) + digest_of(self.seen)
