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
Types with one name everywhere, and what arrays of one name hold where a docstring says no more.

Samples come first, channels last; a single sample has no axis of samples. ``t`` and ``dt`` are the
time and the time since the sample before [s], where 0 restarts a filter; ``stamp`` is the stamp of
a message [ns]. ``motion``, of one sample ``row``, is ``[q, dq, ddq]`` of the active joints in
columns, shape (samples, 3 joints) [rad, rad/s, rad/s^2 or m, m/s, m/s^2]. ``measured``,
``predicted``, ``residual`` and ``output`` have the shape (samples, channels) and the units of the
arm description, ``strain`` (samples, gauges), and ``moment`` the same [N m]. Of a motion, ``q``,
``dq``, ``ddq`` are its parts, and so are positions and speeds that joints are commanded or
``held`` at, each (joints,) for one sample; ``now`` is the time by the clock of this machine [s].
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tudor_dynamics.errors import SignalError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
IndexArray = NDArray[np.intp]
Progress = Callable[[str], None]  # told what is done next


def finite_array(values: ArrayLike, name: str, *shape: int | None) -> FloatArray:
    """Take finite numbers of a shape, in which None is any length; anything else is refused."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SignalError(f'{name} is {repr(values)[:60]}; expected numbers') from None
    if found.ndim != len(shape) or any(
            wanted not in (None, size) for wanted, size in zip(shape, found.shape, strict=True)):
        words = ', '.join('any' if size is None else str(size) for size in shape)
        raise SignalError(f'{name} has the shape {found.shape}; expected ({words})')
    if not np.isfinite(found).all():
        raise SignalError(f'{name} has NaN or infinite values', remedy='leave out such samples')
    return found
