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

"""Small arrays in compiled code: what numpy and the count of references cost beside the work."""

from __future__ import annotations

import math
from typing import Any, TypeVar

from numba import types
from numba.extending import intrinsic
import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

Tables = TypeVar('Tables', bound=tuple)


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        kinds: Any = kind
        return context.make_tuple(builder, kind, [
            _without_owner(context, builder, of, builder.extract_value(value, i))
            for i, of in enumerate(kinds)])
    if isinstance(kind, types.Array):
        array = context.make_array(kind)(context, builder, value)
        array.meminfo = array.meminfo.type(None)
        return array._getvalue()
    return value


@intrinsic
def _unowned(_: Any, tables: Any) -> Any:
    return tables(tables), lambda context, builder, signature, values: _without_owner(
        context, builder, signature.args[0], values[0])


@compiled
def unowned(tables: Tables) -> Tables:
    """
    Give the same arrays, without their owner.

    Nobody counts references to them nor to their rows, each an atomic addition that numba does
    not leave out where there is a loop: a third of the time of a step. Only for the arguments of
    a function that is called from Python, which holds them until it returns.

    Parameters
    ----------
    tables : tuple
        Arrays, and tuples of them.

    """
    return _unowned(tables)  # type: ignore[call-arg]


@compiled
def all_finite(x: NDArray[np.float64]) -> bool:
    """Say whether no value of a vector is NaN or infinite."""
    for value in x:
        if not math.isfinite(value):
            return False
    return True


@compiled
def largest(x: NDArray[np.float64]) -> float:
    """Give the largest value of a vector; NaN if one is NaN."""
    most = -math.inf
    for value in x:
        if not value <= most:
            most = value
        if math.isnan(most):
            return most
    return most


@compiled
def largest_size(x: NDArray[np.float64], begin: int, end: int) -> float:
    """Give the largest absolute value of a part of a vector, as ``largest`` does."""
    most = 0.0
    for i in range(begin, end):
        if not abs(x[i]) <= most:
            most = abs(x[i])
        if math.isnan(most):
            return most
    return most
