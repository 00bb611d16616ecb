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

"""What was chosen, and what it brought: for people and for files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Choice:
    """One thing that was left open."""

    what: str  # what was to be chosen
    # What it came to, and what it is compared with, in words.
    chosen: str
    instead: str
    # Relative error on the parts that were left out, with the one and with the other [%].
    error: float
    error_instead: float

    def __str__(self) -> str:
        """Write what was chosen and what it brought."""
        if self.chosen == self.instead:
            return f'{self.what}: {self.chosen} (nothing else pays)'
        return (f'{self.what}: {self.chosen} ({self.error:.1f} % error on parts left out, with '
                f'{self.instead} {self.error_instead:.1f} %)')


def choices_to_list(made: Sequence[Choice]) -> list[dict[str, Any]]:
    """Give choices as plain values, for JSON and bundles."""
    return [{**asdict(choice), 'error': round(choice.error, 3),
             'error_instead': round(choice.error_instead, 3)} for choice in made]
