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

"""Bags in folders: what is one, what holds some, in which order."""

from __future__ import annotations

from pathlib import Path
import re

from tudor_dynamics.bags.storage.metadata import METADATA

SUFFIXES = ('.db3', '.mcap')
"""Of storage files."""
DEEPEST = 4
"""Folders within folders that are looked into."""


def natural(path: Path) -> list[tuple[int, int, str]]:
    """Give what paths are sorted by: their names, numbers in them by their size."""
    return [(0, int(part), '') if part.isdecimal() else (1, 0, part)
            for part in re.split(r'([0-9]{1,18})', path.name)]


def bags_below(path: Path, deepest: int = DEEPEST) -> list[Path]:
    """
    Find the bags in a folder.

    Returns the path itself where it is a bag, or has none below it.
    """
    if deepest == 0 or not path.is_dir() or _is_bag(path):
        return [path]
    found = []
    for item in sorted(path.iterdir(), key=natural):
        if item.is_dir() and not item.name.startswith('.'):
            found += [bag for bag in bags_below(item, deepest - 1) if _is_bag(bag)]
    return found or [path]


def _is_bag(path: Path) -> bool:
    return (path / METADATA).exists() or any(
        item.suffix in SUFFIXES and item.is_file() for item in path.iterdir())
