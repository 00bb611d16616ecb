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

"""What lasts for longer than the recording of an event: kept now and then, recalled in replays."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from copy import deepcopy
from typing import Any

import numpy as np

from tudor_dynamics.online.settings import MEMORY_APART, MEMORY_EVERY, MEMORY_OLDEST


def state_of(part: Any) -> Any:
    """Give the state of a part, as JSON has it: of an object, the attributes in ``REMEMBERED``."""
    if isinstance(part, np.ndarray):
        return part.tolist()
    if isinstance(part, dict):
        return {key: state_of(value) for key, value in part.items()}
    if isinstance(part, (tuple, deque)):
        return [state_of(value) for value in part]
    if part is None or isinstance(part, (bool, int, float)):
        return part
    return {name: state_of(getattr(part, name)) for name in part.REMEMBERED}


def put_state(part: Any, state: Any) -> Any:
    """Put a part into a state that `state_of` gave of its like; returns what takes its place."""
    if isinstance(part, np.ndarray):
        new = np.array(state, part.dtype)
        if new.shape != part.shape:
            raise ValueError(f'the shape is {new.shape}, not {part.shape}')
        part[...] = new  # in place: compiled code and views have it too
        return part
    if isinstance(part, dict):
        return {key: put_state(value, state[key]) for key, value in part.items()}
    if isinstance(part, tuple):
        return tuple(put_state(*pair) for pair in zip(part, state, strict=True))
    if isinstance(part, deque):
        return deque((put_state(deepcopy(part[0]), item) for item in [state[0], *state[1:]]),
                     part.maxlen)
    if part is None or isinstance(part, (bool, int, float)):
        return part if part is None else type(part)(state)
    for name in part.REMEMBERED:
        setattr(part, name, put_state(getattr(part, name), state[name]))
    return part


class Memory:
    """States of a part every 5 s; ``of``: what a state has to be of to be recalled, as in JSON."""

    def __init__(self, part: Any, of: Any) -> None:
        self._part, self._of = part, of
        self._kept: deque[dict[str, Any]] = deque(maxlen=1 + round(MEMORY_OLDEST / MEMORY_EVERY))
        self._recalled: dict[int, Any] = {}
        state_of(part)  # an error now, and not at the first event

    def step(self, stamp: int) -> None:
        """Keep or recall the state after a sample, stamp [ns]."""
        since = stamp - self._kept[-1]['stamp'] if self._kept else -1
        if since < 0:  # the clock was set back: stamps of before come again
            self._kept.clear()
        if stamp in self._recalled:
            put_state(self._part, self._recalled.pop(stamp))
        elif 0 <= since < MEMORY_EVERY * 1e9:
            return
        self._kept.append({'stamp': stamp, 'of': self._of, 'state': state_of(self._part)})

    def recall(self, memories: Iterable[dict[str, Any]]) -> None:
        """Go on from memories, each at its sample, where they are of the same."""
        self._recalled = {int(item['stamp']): item['state'] for item in memories
                          if item['of'] == self._of}
        for state in self._recalled.values():
            put_state(deepcopy(self._part), state)  # one that does not fit is refused here

    def before(self, stamp: int) -> list[dict[str, Any]]:
        """
        Give two memories that a recording of an event holds, the later once filters settled.

        With the first one predictions are those of that time. Thresholds follow residuals, which
        are filtered: only the second one holds their state to the last bit.
        """
        kept = [item for item in self._kept if 0 <= stamp - item['stamp'] <= MEMORY_OLDEST * 1e9]
        later = [item for item in kept if item['stamp'] - kept[0]['stamp'] >= MEMORY_APART * 1e9]
        return kept[:1] + later[:1]
