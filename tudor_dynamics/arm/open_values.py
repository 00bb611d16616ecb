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

"""What a description leaves open: values that are still ``?``, and where they stand."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tudor_dynamics.errors import ArmError

OPEN = '?'
"""Stands in a description for what nobody has said yet; nothing is read from such a file."""
SHOWN = 8
"""Open values that one message names."""
Path = tuple[str | int, ...]
"""Keys and places in lists that lead to a value."""


def open_values(content: Any, path: Path = ()) -> Iterator[Path]:
    """Find the values that are still open."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from open_values(value, (*path, str(key)))
    elif isinstance(content, (list, tuple)):
        for number, value in enumerate(content):
            yield from open_values(value, (*path, number))
    elif isinstance(content, str) and content.strip() == OPEN:
        yield path


def spelled(content: Any, path: Path) -> str:
    """Write where a value stands, entries of lists by their names where they have some."""
    text, here = '', content
    for step in path:
        here = here[step]
        if isinstance(step, int):
            name = here.get('name') if isinstance(here, dict) else None
            text += f'[{name if isinstance(name, str) and name != OPEN else step}]'
        else:
            text += f'.{step}' if text else step
    return text


def check_no_open_values(content: Any, source: str) -> None:
    """Refuse a description in which something is still ``?``."""
    names = [spelled(content, path) for path in open_values(content)]
    if names:
        more = f' and {len(names) - SHOWN} more' if len(names) > SHOWN else ''
        msg = f'still {OPEN!r}: {", ".join(name[:100] for name in names[:SHOWN])}{more}'
        raise ArmError(msg, place=source, remedy=(
            'write what it is in place of the question mark; docs/arm_yaml.md says what each key '
            'means'))
