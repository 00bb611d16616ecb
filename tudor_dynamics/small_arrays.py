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

from collections.abc import Callable, Sequence
import math
from typing import Any, cast, TypeVar

from numba import types
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array
import numpy as np
from numpy.typing import NDArray

from tudor_dynamics.compiled import compiled

Tables = TypeVar('Tables', bound=tuple)
REAL, WHOLE, TRUTH = range(3)
KINDS = types.float64, types.int64, types.boolean
"""What an array may hold that is handed over by its place."""


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
    """
    return _unowned(tables)  # type: ignore[call-arg]


def places_of(arrays: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
    """
    Write down where arrays lie, for compiled functions that are called often with many of them.

    To hand an array over takes 0.15 us, two thirds of what a step of a small mechanism takes where
    there are twenty. Who keeps the result has to keep the arrays, too.

    Returns (arrays, 4).
    """
    places = np.ones((len(arrays), 4), dtype=np.int64)
    for place, array in zip(places, arrays, strict=True):
        if not (array.flags.c_contiguous and array.dtype in (np.float64, np.int64, np.bool_)):
            msg = f'an array of {array.dtype}, {array.strides} cannot be handed over by its place'
            raise ValueError(msg)
        place[0], place[1:1 + array.ndim] = array.ctypes.data, array.shape
    return places


@intrinsic(prefer_literal=True)
def _array_at(_: Any, places: Any, number: Any, kind: Any, axes: Any) -> Any:
    dtype = KINDS[kind.literal_value]
    array = types.Array(dtype, axes.literal_value, 'C')

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        table = context.make_array(places)(context, builder, values[0])
        numbers = [builder.load(builder.gep(table.data, [context.get_constant(
            types.intp, 4 * number.literal_value + i)])) for i in range(1 + array.ndim)]
        size = context.get_abi_sizeof(context.get_data_type(dtype))
        strides = [context.get_constant(types.intp, size)]
        for extent in reversed(numbers[2:]):
            strides.insert(0, builder.mul(strides[0], extent))
        made = context.make_array(array)(context, builder)
        data = builder.inttoptr(numbers[0], made.data.type)
        populate_array(made, data, numbers[1:], strides,  # type: ignore[no-untyped-call]
                       context.get_constant(types.intp, size), None)
        return made._getvalue()
    return array(places, number, kind, axes), lower


array_at = cast(Callable[[NDArray[np.int64], int, int, int], NDArray[Any]], _array_at)
"""
Give, in compiled code, an array of which ``places_of`` has written down where it lies.

The result has no owner, see ``unowned``. Arguments: places, which of them, what it holds (REAL,
WHOLE or TRUTH) and its number of axes; all but the first are constants.
"""


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
