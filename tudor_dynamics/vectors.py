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
Numbers side by side as a type of numba, and arrays without owner: internals of numba and llvmlite.

Nothing else reaches into them, and only ``compiled.py`` uses this module; where the internals of
another version are not these, importing it fails, and ``compiled.py`` has a plain way.
"""

from __future__ import annotations

from collections.abc import Callable
import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.boxing import box_unsupported, unbox_unsupported
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import box, intrinsic, register_model, unbox
from numba.np.arrayobj import populate_array

LANES = 8
"""Numbers side by side: a vector of AVX-512, two of AVX2 (bench/elastic_search.py compares)."""
TERMS = 11
"""Of the series of sine and cosine: exact to rounding up to a quarter turn (test_lanes.py)."""

_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


class _Many(types.Type):
    """Type of so many numbers side by side."""

    def __init__(self) -> None:
        super().__init__(name='many')

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """Take any number, in all lanes."""
        del typingctx
        return Conversion.safe if isinstance(other, types.Number) else None

    def unify(self, typingctx: Any, other: Any) -> Any:
        """Become this where a variable is a number at first."""
        del typingctx
        return self if isinstance(other, types.Number) else None


many = _Many()


@register_model(_Many)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


class _ManyArray(types.Array):
    """Type of an array of them, which never comes from Python nor goes there."""

    def __init__(self, ndim: int, layout: Any) -> None:
        super().__init__(many, ndim, layout, aligned=False)

    def copy(  # type: ignore[override]
            self, dtype: Any = None, ndim: Any = None, layout: Any = None,
            readonly: Any = None) -> _ManyArray:
        """Give the type of a part."""
        del dtype, readonly
        return _ManyArray(ndim or self.ndim, layout or self.layout)


register_model(_ManyArray)(models.ArrayModel)
unbox(_ManyArray)(unbox_unsupported)
box(_ManyArray)(box_unsupported)


def _alike(value: float) -> ir.Constant:
    return ir.Constant(_VECTOR, [float(value)] * LANES)


@lower_cast(types.Float, _Many)
@lower_cast(types.Integer, _Many)
@lower_cast(types.IntegerLiteral, _Many)
def _from_number(context: Any, builder: Any, kind: Any, _: Any, value: Any) -> Any:
    first = builder.insert_element(
        ir.Constant(_VECTOR, ir.Undefined), context.cast(builder, value, kind, types.float64),
        ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(
        ir.VectorType(ir.IntType(32), LANES), [0] * LANES))


def _known(*functions: Any, result: Any, count: int) -> None:
    """Say what functions give that are called with one or more of this type."""
    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if not kws and len(args) == count and many in args and all(
                    arg == many or isinstance(arg, types.Number) for arg in args):
                return signature(result, *[many] * count)
            return None

    for function in functions:
        infer_global(function)(Template)


def _lowered(function: Any, make: Callable[..., Any], count: int) -> None:
    @lower_builtin(function, *[many] * count)
    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        del context, signature
        return make(builder, *values)


_OPERATIONS = {
    'fadd': (operator.add, operator.iadd), 'fsub': (operator.sub, operator.isub),
    'fmul': (operator.mul, operator.imul), 'fdiv': (operator.truediv, operator.itruediv)}
for _name, _pair in _OPERATIONS.items():
    _known(*_pair, result=many, count=2)
    for _each in _pair:
        _lowered(_each, lambda builder, a, b, name=_name: getattr(builder, name)(a, b), 2)
_ORDERS = {'<': operator.lt, '<=': operator.le, '>': operator.gt, '>=': operator.ge}
_known(*_ORDERS.values(), result=types.boolean, count=2)
for _sign, _order in _ORDERS.items():
    _lowered(_order, lambda builder, a, b, sign=_sign: builder.icmp_unsigned(
        '==', builder.bitcast(builder.fcmp_ordered(sign, a, b), ir.IntType(LANES)),
        ir.Constant(ir.IntType(LANES), 2**LANES - 1)), 2)


def _call(builder: Any, name: str, *values: Any) -> Any:
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(values))
    return builder.call(cgutils.get_or_insert_function(
        builder.module, kind, f'{name}.v{LANES}f64'), values)


def _sine(builder: Any, x: Any, first: int) -> Any:
    """Give the sine (first power 1) or cosine (0) by the series about the next half turn."""
    turns = _call(builder, 'llvm.rint', builder.fmul(x, _alike(1.0 / math.pi)))
    rest = builder.fsub(x, builder.fmul(turns, _alike(math.pi)))
    square = builder.fmul(rest, rest)
    result = _alike(0.0)
    for k in range(TERMS, -1, -1):
        result = builder.fadd(builder.fmul(result, square), _alike(
            (-1.0)**k / math.factorial(2 * k + first)))
    half = builder.fmul(turns, _alike(0.5))
    odd = builder.fsub(half, _call(builder, 'llvm.floor', half))  # a half after an odd one
    flip = builder.fsub(_alike(1.0), builder.fmul(odd, _alike(4.0)))
    return builder.fmul(flip, builder.fmul(result, rest) if first else result)


# Of lanes that agree: where something is, not what is there.
_known(int, result=types.intp, count=1)
_lowered(int, lambda builder, a: builder.fptosi(builder.extract_element(
    a, ir.Constant(ir.IntType(32), 0)), ir.IntType(64)), 1)
_known(operator.neg, abs, math.sqrt, math.sin, math.cos, result=many, count=1)
_lowered(operator.neg, lambda builder, a: builder.fsub(_alike(-0.0), a), 1)
_lowered(abs, lambda builder, a: _call(builder, 'llvm.fabs', a), 1)
_lowered(math.sqrt, lambda builder, a: _call(builder, 'llvm.sqrt', a), 1)
_lowered(math.sin, lambda builder, a: _sine(builder, a, 1), 1)
_lowered(math.cos, lambda builder, a: _sine(builder, a, 0), 1)


def _kind_of(kind: Any) -> Any:
    if isinstance(kind, types.Array) and kind.dtype == types.float64:
        return _ManyArray(kind.ndim - 1, 'C')
    return kind


def _viewed(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if _kind_of(kind) == kind:
        return value
    numbers = context.make_array(kind)(context, builder, value)
    vectors = context.make_array(_kind_of(kind))(context, builder)
    size = LANES * 8
    shape = [builder.extract_value(numbers.shape, i) for i in range(kind.ndim - 1)]
    strides = [builder.extract_value(numbers.strides, i) for i in range(kind.ndim - 1)]
    populate_array(vectors, builder.bitcast(numbers.data, vectors.data.type), shape, strides, size,
                   None)
    return vectors._getvalue()


@intrinsic
def views(_: Any, tables: Any) -> Any:
    """View the numbers of tables as vectors of lanes."""
    kinds = types.Tuple([_kind_of(kind) for kind in tables])

    def lower(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return context.make_tuple(builder, signature.return_type, [
            _viewed(context, builder, kind, builder.extract_value(values[0], i))
            for i, kind in enumerate(signature.args[0])])
    return kinds(tables), lower


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
def without_owner(_: Any, tables: Any) -> Any:
    """Give tables of which no reference is counted."""
    return tables(tables), lambda context, builder, signature, values: _without_owner(
        context, builder, signature.args[0], values[0])
