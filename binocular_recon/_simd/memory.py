# SPDX-License-Identifier: Apache-2.0
"""Load and store vectors, and rearrange their numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types

from binocular_recon._simd.vectors import (
    LANES,
    VectorType,
    emit_shuffle,
    emit_splat,
    operation,
)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    element = builder.gep(data, [index])
    vector = ir.VectorType(context.get_data_type(array_type.dtype), LANES)
    return builder.bitcast(element, vector.as_pointer())


def _is_row(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == 'C'


@operation(lambda array, index: array[index : index + LANES].copy())
def load(_context: Any, array: Any, index: Any) -> Any:
    """Return the vector ``array[index : index + LANES]``."""
    if not (_is_row(array) and isinstance(index, types.Integer)):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments)
        return builder.load(pointer, align=signature.args[0].dtype.bitwidth // 8)

    return VectorType(array.dtype)(array, types.intp), generate


def _plain_store(array: Any, index: int, vector: Any) -> None:
    array[index : index + LANES] = vector


@operation(_plain_store)
def store(_context: Any, array: Any, _index: Any, vector: Any) -> Any:
    """Write ``vector`` to ``array[index : index + LANES]``."""
    if not (_is_row(array) and isinstance(vector, VectorType) and vector.dtype == array.dtype):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer, align=signature.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def _plain_copy_pair(array: Any, index: int, out: Any, at: int) -> None:
    out[at : at + 2] = array[index : index + 2]


@operation(_plain_copy_pair)
def copy_pair(_context: Any, array: Any, _index: Any, out: Any, _at: Any) -> Any:
    """Copy ``array[index : index + 2]``, of any alignment, to ``out[at : at + 2]``."""
    if not (_is_row(array) and _is_row(out) and array.dtype == out.dtype):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        pair = ir.VectorType(context.get_data_type(array.dtype), 2).as_pointer()
        places = [
            builder.bitcast(_pointer(context, builder, kinds[i], *arguments[i : i + 2]), pair)
            for i in (0, 2)
        ]
        align = array.dtype.bitwidth // 8
        builder.store(builder.load(places[0], align=align), places[1], align=align)
        return context.get_dummy_value()

    return types.void(array, types.intp, out, types.intp), generate


@operation(lambda value: np.full(LANES, value))
def splat(_context: Any, value: Any) -> Any:
    """Return a vector of copies of the scalar ``value``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return emit_splat(builder, context.get_value_type(signature.return_type), arguments[0])

    return VectorType(value)(value), generate


def _every_second(first: int) -> Callable[..., Any]:
    """Return a code generator for the vector ``array[index + first : ... : 2]``."""

    def generator(_context: Any, array: Any, index: Any) -> Any:
        if not (_is_row(array) and isinstance(index, types.Integer)):
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            halves = []
            for offset in (0, LANES):
                start = builder.add(arguments[1], ir.Constant(arguments[1].type, offset))
                pointer = _pointer(context, builder, signature.args[0], arguments[0], start)
                align = signature.args[0].dtype.bitwidth // 8
                halves.append(builder.load(pointer, align=align))
            return emit_shuffle(builder, halves, [2 * i + first for i in range(LANES)])

        return VectorType(array.dtype)(array, types.intp), generate

    return generator


# The first or the second of each pair of the 2 * LANES numbers from ``index`` on.
load_even = operation(lambda array, index: array[index : index + 2 * LANES : 2].copy())(
    _every_second(0)
)

load_odd = operation(lambda array, index: array[index + 1 : index + 2 * LANES : 2].copy())(
    _every_second(1)
)


def _plain_store_pairs(array: Any, index: int, even: Any, odd: Any) -> None:
    array[index : index + 2 * LANES : 2] = even
    array[index + 1 : index + 2 * LANES : 2] = odd


@operation(_plain_store_pairs)
def store_pairs(_context: Any, array: Any, _index: Any, even: Any, odd: Any) -> Any:
    """Write two vectors, interleaved, to ``array[index : index + 2 * LANES]``."""
    if not (_is_row(array) and isinstance(even, VectorType) and even == odd):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        half = LANES // 2
        for offset in (0, LANES):
            pairs = [(offset // 2 + i, LANES + offset // 2 + i) for i in range(half)]
            vector = emit_shuffle(
                builder, arguments[2:], [lane for pair in pairs for lane in pair]
            )
            start = builder.add(arguments[1], ir.Constant(arguments[1].type, offset))
            pointer = _pointer(context, builder, signature.args[0], arguments[0], start)
            builder.store(vector, pointer, align=signature.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, even, odd), generate


def _plain_slide(before: Any, vector: Any, count: int) -> Any:
    return np.concatenate([before, vector])[LANES - count : 2 * LANES - count]


@operation(_plain_slide)
def slide(_context: Any, before: Any, vector: Any, count: Any) -> Any:
    """Return the last ``count`` (a literal) numbers of ``before`` and the first of ``vector``."""
    if not (isinstance(before, VectorType) and before == vector):
        return None
    if not isinstance(count, types.IntegerLiteral):
        return None

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        first = LANES - count.literal_value
        return emit_shuffle(builder, arguments[:2], [first + i for i in range(LANES)])

    return before(before, vector, count), generate


def _element(lane: int) -> Callable[..., Any]:
    """Return a code generator for one number of a vector."""

    def generator(_context: Any, vector: Any) -> Any:
        if not isinstance(vector, VectorType):
            return None

        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return builder.extract_element(arguments[0], ir.Constant(ir.IntType(32), lane))

        return vector.dtype(vector), generate

    return generator


# The first and the last number of a vector.
first_of = operation(lambda vector: vector[0])(_element(0))

last_of = operation(lambda vector: vector[-1])(_element(LANES - 1))
