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

"""The one way in which the package compiles its inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast, TypeVar

import numba

Function = TypeVar('Function', bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """
    Compile a function of scalars and arrays; the result is kept on disk between runs.

    NaN keep their meaning (a run that diverges must be seen), the order of sums may change.

    Parameters
    ----------
    function : callable
        Function that numba can compile.

    Returns
    -------
    callable
        The same function, compiled at its first call.

    """
    jit = numba.njit(cache=True, nogil=True, error_model='numpy',
                     fastmath={'contract', 'reassoc', 'nsz'})
    return cast(Function, jit(function))
