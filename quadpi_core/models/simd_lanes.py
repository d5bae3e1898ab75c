# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sixteen numbers that compiled code handles as one, by vector instructions.

Numba leaves it to the compiler which loops become vector instructions and which sums stay in registers. Where
that decides the speed, these functions say it. Each lane is rounded as a scalar is, nothing is fused or
reordered unasked: the layout of samples does not change the result.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from llvmlite import ir
from numba import extending, types
from numba.core import cgutils

LANES = 16

_NUMBER = ir.DoubleType()
_VECTOR = ir.VectorType(_NUMBER, LANES)
_ZEROS = ir.Constant(_VECTOR, [0.0] * LANES)
_FIRST = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)


# What an intrinsic gives: the types that it takes and gives, and what writes its instructions.
_Code: TypeAlias = tuple[Any, Callable[..., Any]]


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name=f"Lanes{LANES}")


@extending.register_model(_Lanes)
class _LanesModel(extending.models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Any) -> None:
        super().__init__(manager, type_, _VECTOR)  # type: ignore[no-untyped-call]


_lanes = _Lanes()


def intrinsic(function: Callable[..., _Code]) -> Any:
    """A function of kernels that writes its instructions; numba calls it with a context and types."""
    return extending.intrinsic(function)


@intrinsic
def fused(_: Any, a: Any, b: Any, c: Any) -> _Code:
    """Product of a scalar and a scalar or lanes, plus a scalar or lanes, rounded once."""

    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        if b is not _lanes:
            return builder.fma(*values)
        kind = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        name = f"llvm.fma.v{LANES}f64"
        function = cgutils.get_or_insert_function(builder.module, kind, name)  # type: ignore[no-untyped-call]
        return builder.call(function, [_fill(builder, values[0]), *values[1:]])

    return c(a, b, c), generate


@intrinsic
def rectified(_: Any, value: Any) -> _Code:
    """The larger of 0 and a scalar or lanes; NaN stays NaN."""

    def generate(_: Any, builder: Any, __: Any, values: Any) -> Any:
        zero = _ZEROS if value is _lanes else ir.Constant(_NUMBER, 0.0)
        return builder.select(builder.fcmp_ordered("<", values[0], zero), zero, values[0])

    return value(value), generate


@intrinsic
def filled(_: Any, number: Any) -> _Code:
    """Lanes that all hold one number."""
    return _lanes(number), lambda _, builder, __, values: _fill(builder, values[0])


@intrinsic
def element(_: Any, array: Any, row: Any, column: Any) -> _Code:  # noqa: ARG001
    """An element of a table; unlike array[row, column], no index is taken for negative in inner loops."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load(_address(context, builder, signature, values))

    return array.dtype(array, types.intp, types.intp), generate


@intrinsic
def load(_: Any, array: Any, row: Any, column: Any) -> _Code:  # noqa: ARG001
    """Lanes array[row, column : column + LANES] of float64; nothing checks the bounds."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature, values)
        lanes = builder.load(builder.bitcast(address, _VECTOR.as_pointer()))
        lanes.align = 8
        return lanes

    return _lanes(array, types.intp, types.intp), generate


@intrinsic
def store(_: Any, array: Any, row: Any, column: Any, lanes: Any) -> _Code:  # noqa: ARG001
    """Write lanes to where :func:`load` reads them."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        address = _address(context, builder, signature, values)
        builder.store(values[3], builder.bitcast(address, _VECTOR.as_pointer())).align = 8
        return context.get_dummy_value()

    return types.void(array, types.intp, types.intp, lanes), generate


def _fill(builder: Any, number: Any) -> Any:
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, undefined, _FIRST)


def _address(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Of an element of an array of two dimensions, its row and its column the next two values."""
    kind = signature.args[0]
    array = context.make_array(kind)(context, builder, values[0])
    return cgutils.get_item_pointer(  # type: ignore[no-untyped-call]
        context, builder, kind, array, list(values[1:3]), wraparound=False
    )
