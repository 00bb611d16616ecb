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

"""Tables as ``tools/figures.py`` reads them: Markdown, with the head that the page shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def show(head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table."""
    print()
    for row in (head, ['---'] * len(head), *rows):
        print(f'| {" | ".join(str(cell) for cell in row)} |')
    print(flush=True)


PUSHES = ('pushes found', 'median', '95 %', 'false alarms')
"""Heads of the cells of `pushes`."""


def pushes(score: Mapping[str, Any]) -> tuple[str, ...]:
    """Give the cells of a score of collisions, as plain values."""
    late = (score['latency_median'], score['latency_p95'])
    return (f'{score["found"]} of {score["pushes"]}', *(
        '' if value is None else f'{1000 * value:.0f} ms' for value in late),
        f'{score["false_alarms"]}')
