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

"""What is asked for the values that a first description leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from typing import Any

from tudor_dynamics.arm.open_values import OPEN
from tudor_dynamics.arm.schema import one_spelling
from tudor_dynamics.library.drafting.draft import Draft

Question = tuple[str, Callable[[str], Any]]


def question_of(draft: Draft, path: tuple[str | int, ...]) -> Question | None:
    """Give what to ask for an open value; returns None for what cannot be said in a word."""
    entry: Any = draft.content
    for step in path[:-1]:
        entry = entry[step]
    joints = [joint['name'] for joint in draft.content['joints']]

    def one_of(values: Sequence[str]) -> Callable[[str], str]:
        def choose(answer: str) -> str:
            value = str(one_spelling(answer))
            if value not in values:
                raise ValueError(f'one of {", ".join(values)}')
            return value
        return choose

    def length(answer: str) -> float:
        value = float(answer)
        if not 0.0 <= value < math.inf:
            raise ValueError('a distance in m')
        return value

    key = path[-1]
    if key == 'unit' and 'distance' not in entry:
        return 'unit (A, N m, N)', one_of(('A', 'N m', 'N'))
    if key == 'unit':
        return 'unit (um/m, m/m, mV/V, V, N m)', one_of(('um/m', 'm/m', 'mV/V', 'V', 'N m'))
    if key == 'joint':
        return f'joint before it ({", ".join(joints)})', one_of(joints)
    if key == 'distance':
        return 'distance along the link from that joint [m]', length
    if key == 'index':
        return 'place in the array, from 0', int
    return None


def answer(draft: Draft, path: tuple[str | int, ...], value: Any) -> None:
    """Put a value in the place of an open one."""
    entry: Any = draft.content
    for step in path[:-1]:
        entry = entry[step]
    entry[path[-1]] = value
    if path[-1] == 'unit' and path[0] == 'joints':  # one driver, one unit
        for joint in draft.content['joints']:
            other = joint.get('effort', {})
            if other.get('unit') == OPEN and all(
                    other.get(key) == entry.get(key) for key in ('topic', 'interface')):
                other['unit'] = value
