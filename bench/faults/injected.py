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

"""What is put in: a row of the table, with kind, place and size that the doctor has to name."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class Fault:
    """
    A fault that was put into one bag or description.

    ``kinds`` are those that name it, the first one literally; the others where the data cannot
    tell two of them apart. None for channels, time or size: any is right.
    """

    row: str
    kinds: tuple
    arm: object
    bags: tuple
    channels: tuple | None = None
    time: float | None = None
    seconds: float = 0.5
    size: float | None = None
    part: float = 0.3
    least: float = 0.0
    bag: str | None = None

    def named_by(self, finding):
        """Say whether a finding has the kind of the fault."""
        return finding.kind in self.kinds

    def placed_by(self, finding):
        """Say whether a finding has the place of the fault, too."""
        if not self.named_by(finding):
            return False
        if self.channels is not None and not set(self.channels) <= set(finding.channels):
            return False
        if self.bag is not None and finding.bag and self.bag not in finding.bag:
            return False
        return self.time is None or (
            finding.time is not None and abs(finding.time - self.time) <= self.seconds)

    def sized_by(self, finding):
        """Say whether a finding has the size of the fault, too."""
        if not self.placed_by(finding):
            return False
        return self.size is None or (
            finding.size is not None
            and abs(finding.size - self.size) <= max(self.part * abs(self.size), self.least))
