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

"""Sums of bags on disk: what a fit has kept of each bag, and takes up again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
import re

from tudor_dynamics.files import read_bounded, write_whole

LARGEST = 200_000_000
"""Bytes of what one bag came to."""
NAME = re.compile(r'[0-9a-f]{24}-[0-9a-f]{16}\.(npz|json)')
"""Of a file: checksum of the bag, digest of settings and sources."""
SUFFIX = '.sums'
"""Of the directory next to a bundle in which sums are kept."""


@dataclass(frozen=True)
class Folder:
    """A directory with a file for what each bag came to, made where it is not."""

    path: Path
    shared: bool = True  # other processes and machines see it

    def read(self, name: str) -> bytes | None:
        """Read what was kept; None where nothing is."""
        try:
            return read_bounded(self.path / name, LARGEST)
        except (OSError, ValueError):
            return None

    def write(self, name: str, content: bytes) -> None:
        """Keep something, whole or not at all."""
        write_whole(self.path / name, content)

    def forget(self, used: Collection[str]) -> None:
        """Remove what bags came to under settings or sources of before."""
        for file in self.path.iterdir():
            if file.name not in used and NAME.fullmatch(file.name):
                file.unlink(missing_ok=True)

    def place(self, name: str) -> str:
        """Say where something is kept, in words."""
        return str(self.path / name)
