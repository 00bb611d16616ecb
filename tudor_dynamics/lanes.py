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

"""
Several arms side by side in compiled code, and arrays that nobody counts references to.

A kernel of numbers, given arrays whose last axis are lanes, is compiled once more for vectors of
the processor, as it stands: one step then advances as many arms as there are lanes. Comparisons
say whether they hold in all lanes, so a kernel may branch only where its lanes agree.

Where numba is not as ``vectors.py`` expects it, or ``TUDOR_PLAIN_LANES`` is set, the lanes are
followed one after the other: the same numbers to rounding, several times slower.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import os
from typing import Any, cast, TypeVar

import numpy as np

from tudor_dynamics.compiled import compiled
from tudor_dynamics.typing import FloatArray

try:
    if os.environ.get('TUDOR_PLAIN_LANES'):
        raise ImportError('plain lanes are asked for')
    from tudor_dynamics.vectors import LANES as WIDTH, views, without_owner
    LANES, PLAIN = WIDTH, False
except (AttributeError, ImportError, TypeError):
    LANES, PLAIN = 8, True

Tables = TypeVar('Tables', bound=tuple)
Kernel = TypeVar('Kernel', bound=Callable[..., int])

if PLAIN:
    @compiled
    def unowned(tables: Tables) -> Tables:
        """Give the same arrays."""
        return tables

    @compiled
    def in_lanes(tables: Tables) -> Tables:
        """Give the same arrays: they are those of one lane."""
        return tables
else:
    @compiled
    def unowned(tables: Tables) -> Tables:
        """
        Give the same arrays, without their owner.

        Nobody counts references to them nor to their rows, each an atomic addition that numba does
        not leave out where there is a loop: a third of the time of a step. Only for the arguments
        of a function that is called from Python, which holds them until it returns.
        """
        return without_owner(tables)  # type: ignore[call-arg]

    @compiled
    def in_lanes(tables: Tables) -> Tables:
        """
        Take the last axis of all arrays of numbers for lanes; arrays of whole numbers are shared.

        Nobody counts references to what is given, see ``unowned``.
        """
        return views(unowned(tables))  # type: ignore[call-arg]


def side_by_side(several: Sequence[FloatArray]) -> FloatArray:
    """Put arrays of one shape side by side (..., LANES); the last one fills remaining lanes."""
    return np.stack([*several, *[several[-1]] * (LANES - len(several))], axis=-1)


def with_lanes(shared: int) -> Callable[[Kernel], Kernel]:
    """
    Compile a kernel that takes its arguments after the first ``shared`` ones by ``in_lanes``.

    It returns the number of steps done, which is that of the lane that fails first. In the plain
    way a lane that fails is NaN afterwards.
    """
    def decorate(kernel: Kernel) -> Kernel:
        fast = compiled(kernel)
        return cast(Kernel, one_by_one(fast, shared)) if PLAIN else fast
    return decorate


def one_by_one(kernel: Callable[..., int], shared: int) -> Callable[..., int]:
    """Let a kernel follow the lanes one after the other."""
    def follow(*arguments: Any) -> int:
        common, several = arguments[:shared], arguments[shared:]
        begun = [array.copy() for array in several]  # whole numbers are the same in all lanes
        done = []
        for lane in range(LANES):
            own = [np.ascontiguousarray(array[..., lane]) if array.dtype == float else array.copy()
                   for array in begun]
            done.append(kernel(*common, *own))
            for array, found in zip(several, own, strict=True):
                if array.dtype == float:
                    array[..., lane] = found
                else:
                    array[...] = found
        for lane, steps in enumerate(done):
            for array in several:
                if steps < max(done) and array.dtype == float:
                    array[..., lane] = np.nan
        return min(done)
    return follow
