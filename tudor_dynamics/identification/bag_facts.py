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

"""What is known of a bag once it was read: for bundles, pages and JSON, without its samples."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tudor_dynamics.identification.dataset import BagData


@dataclass(frozen=True)
class BagFacts:
    """A bag that was used."""

    bag: str  # bag, or part of one, as it was given
    checksum: str  # SHA-256 over its storage files
    # Samples as recorded, and those that are left after decimation.
    recorded: int
    used: int
    # Length [s] and samples per second as recorded [Hz].
    duration: float
    rate: float
    gaps: int = 0  # number of gaps
    longest_gap: float = 0.0  # length of the longest [s]
    # Cause to messages that were left out.
    dropped: Mapping[str, int] = field(default_factory=dict)
    payload: float | None = None  # mass at the tip, where it is known [kg]
    warnings: tuple[str, ...] = ()  # what is odd about it

    def as_dict(self) -> dict[str, Any]:
        """Say which bag was used, so that it can be found and checked again."""
        facts = {'bag': self.bag, 'sha256': self.checksum, 'samples': self.used,
                 'duration': round(self.duration, 6), 'dropped': dict(self.dropped)}
        return facts if self.payload is None else {**facts, 'payload': self.payload}


@dataclass(frozen=True)
class Unused:
    """A bag that was left out."""

    bag: str  # bag, or part of one, as it was given
    why: str  # what is wrong with it, on one line

    def __str__(self) -> str:
        """Write it on one line."""
        return self.why if self.why.startswith(self.bag) else f'{self.bag}: {self.why}'


def facts_of(bag: BagData) -> BagFacts:
    """Give what is known of a bag."""
    recording = bag.recording
    t, parts = recording.t, recording.segments
    holes = [float(t[after.start] - t[before.stop - 1])
             for before, after in zip(parts, parts[1:], strict=False)]
    return BagFacts(
        str(bag.choice), recording.checksum, len(t), bag.samples, float(t[-1]),
        1.0 / recording.dt, len(holes), max(holes, default=0.0), dict(recording.dropped),
        bag.payload, recording.warnings)
