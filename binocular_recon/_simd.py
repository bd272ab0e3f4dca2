# SPDX-License-Identifier: Apache-2.0
"""Vectors of 32 numbers for kernels whose inner loops LLVM does not vectorise well by itself.

A short inner loop over slices costs more in bounds and aliasing checks than in arithmetic. These
operations say directly what is wanted; LLVM maps a vector onto the registers that the machine
has (one of 32 bytes or two of 16 for ``uint8``). With ``NUMBA_DISABLE_JIT=1`` a vector is a NumPy
array and the same kernels run as plain Python.

``a + b``, ``a - b``, ``a * b`` work on vectors of one type, ``a / b`` on real ones; integers wrap
around.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.core.config import DISABLE_JIT  # type: ignore[attr-defined]
from numba.extending import intrinsic, models, overload, register_model

LANES = 32
_CONTRACT = ('contract',)


class VectorType(types.Type):
    """Numba's type of a vector."""

    def __init__(self, dtype: Any) -> None:
        self.dtype = dtype
        super().__init__(name=f'Vector({dtype}, {LANES})')


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager: Any, vector: VectorType) -> None:
        element = manager.lookup(vector.dtype).get_data_type()
        super().__init__(  # type: ignore[no-untyped-call]
            manager, vector, ir.VectorType(element, LANES)
        )


def _operation(plain: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Replace an operation's code generator by ``plain`` where nothing is compiled."""
    return lambda generator: plain if DISABLE_JIT else intrinsic(generator)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    element = builder.gep(data, [index])
    vector = ir.VectorType(context.get_data_type(array_type.dtype), LANES)
    return builder.bitcast(element, vector.as_pointer())


def _is_row(array: Any) -> bool:
    return isinstance(array, types.Array) and array.ndim == 1 and array.layout == 'C'


@_operation(lambda array, index: array[index : index + LANES].copy())
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


@_operation(_plain_store)
def store(_context: Any, array: Any, _index: Any, vector: Any) -> Any:
    """Write ``vector`` to ``array[index : index + LANES]``."""
    if not (_is_row(array) and isinstance(vector, VectorType) and vector.dtype == array.dtype):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], pointer, align=signature.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), generate


def _splat(builder: Any, vector: Any, number: Any) -> Any:
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


@_operation(lambda value: np.full(LANES, value))
def splat(_context: Any, value: Any) -> Any:
    """Return the vector whose numbers all are ``value``, of that scalar's type."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _splat(builder, context.get_value_type(signature.return_type), arguments[0])

    return VectorType(value)(value), generate


def _shuffled(builder: Any, pair: Any, lanes: list[int]) -> Any:
    """Return the vector of the given numbers of two vectors, counted through."""
    return builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(ir.IntType(32), LANES), lanes))


def _every_second(first: int) -> Callable[..., Any]:
    """Return a code generator for the vector ``array[index + first :: 2]``."""

    def generator(_context: Any, array: Any, index: Any) -> Any:
        if not (_is_row(array) and isinstance(index, types.Integer)):
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            halves = []
            for offset in (0, LANES):
                place = builder.add(arguments[1], ir.Constant(arguments[1].type, offset))
                pointer = _pointer(context, builder, signature.args[0], arguments[0], place)
                align = signature.args[0].dtype.bitwidth // 8
                halves.append(builder.load(pointer, align=align))
            return _shuffled(builder, halves, [2 * i + first for i in range(LANES)])

        return VectorType(array.dtype)(array, types.intp), generate

    return generator


# Every second of 2 * LANES numbers from ``index``, the first or the second of each two.
load_even = _operation(lambda array, index: array[index : index + 2 * LANES : 2].copy())(
    _every_second(0)
)
load_odd = _operation(lambda array, index: array[index + 1 : index + 2 * LANES : 2].copy())(
    _every_second(1)
)


def _plain_store_pairs(array: Any, index: int, even: Any, odd: Any) -> None:
    array[index : index + 2 * LANES : 2] = even
    array[index + 1 : index + 2 * LANES : 2] = odd


@_operation(_plain_store_pairs)
def store_pairs(_context: Any, array: Any, _index: Any, even: Any, odd: Any) -> Any:
    """Write two vectors by turns to ``array[index : index + 2 * LANES]``."""
    if not (_is_row(array) and isinstance(even, VectorType) and even == odd):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        half = LANES // 2
        for offset in (0, LANES):
            pairs = [(offset // 2 + i, LANES + offset // 2 + i) for i in range(half)]
            vector = _shuffled(builder, arguments[2:], [lane for pair in pairs for lane in pair])
            place = builder.add(arguments[1], ir.Constant(arguments[1].type, offset))
            pointer = _pointer(context, builder, signature.args[0], arguments[0], place)
            builder.store(vector, pointer, align=signature.args[0].dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, even, odd), generate


def _plain_slide(before: Any, vector: Any, count: int) -> Any:
    return np.concatenate([before, vector])[LANES - count : 2 * LANES - count]


@_operation(_plain_slide)
def slide(_context: Any, before: Any, vector: Any, count: Any) -> Any:
    """Return the last ``count`` (a literal) numbers of ``before`` and the first of ``vector``."""
    if not (isinstance(before, VectorType) and before == vector):
        return None
    if not isinstance(count, types.IntegerLiteral):
        return None

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        first = LANES - count.literal_value
        return _shuffled(builder, arguments[:2], [first + i for i in range(LANES)])

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


# A vector's first and last number.
first_of = _operation(lambda vector: vector[0])(_element(0))
last_of = _operation(lambda vector: vector[-1])(_element(LANES - 1))


def _call(builder: Any, name: str, result: Any, arguments: Any) -> Any:
    """Call LLVM's intrinsic ``name``."""
    function_type = ir.FunctionType(result, [argument.type for argument in arguments])
    function = builder.module.globals.get(name)
    if function is None:
        function = ir.Function(builder.module, function_type, name)
    return builder.call(function, arguments)


def _suffix(dtype: Any) -> str:
    return f'v{LANES}{"f" if isinstance(dtype, types.Float) else "i"}{dtype.bitwidth}'


def _pairwise(integer: str, unsigned: str, real: str) -> Any:
    """Return a code generator that calls LLVM's intrinsic for two vectors of one type."""

    def generator(_context: Any, a: Any, b: Any) -> Any:
        if not (isinstance(a, VectorType) and a == b):
            return None
        kind = (
            real if isinstance(a.dtype, types.Float) else integer if a.dtype.signed else unsigned
        )

        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            name = f'llvm.{kind}.{_suffix(a.dtype)}'
            return _call(builder, name, arguments[0].type, arguments)

        return a(a, b), generate

    return generator


def _plain_add_saturated(a: Any, b: Any) -> Any:
    return np.minimum(a.astype(np.int64) + b, np.iinfo(a.dtype).max).astype(a.dtype)


# Element-wise minimum and maximum (of NaN and a number the number), and the sum of unsigned
# integers that stops at the largest.
smaller = _operation(np.fmin)(_pairwise('smin', 'umin', 'minnum'))
larger = _operation(np.fmax)(_pairwise('smax', 'umax', 'maxnum'))
add_saturated = _operation(_plain_add_saturated)(_pairwise('sadd.sat', 'uadd.sat', ''))


@_operation(lambda value, limit, low, high: np.where(value <= limit, low, high))
def at_most(_context: Any, value: Any, limit: Any, low: Any, high: Any) -> Any:
    """Return the number of ``low`` where ``value <= limit``, else of ``high``; NaN is not."""
    if not (isinstance(value, VectorType) and value == limit and low == high):
        return None

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        condition = builder.fcmp_ordered('<=', arguments[0], arguments[1])
        return builder.select(condition, arguments[2], arguments[3])

    return low(value, limit, low, high), generate


def _reduction(signed: str, unsigned: str) -> Any:
    def generator(_context: Any, vector: Any) -> Any:
        if not (isinstance(vector, VectorType) and isinstance(vector.dtype, types.Integer)):
            return None

        def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            kind = signed if vector.dtype.signed else unsigned
            name = f'llvm.vector.reduce.{kind}.{_suffix(vector.dtype)}'
            return _call(builder, name, context.get_value_type(vector.dtype), arguments)

        return vector.dtype(vector), generate

    return generator


# Smallest and largest number of a vector of integers.
smallest = _operation(np.min)(_reduction('smin', 'umin'))
largest = _operation(np.max)(_reduction('smax', 'umax'))


def _plain_first_equal(vector: Any, number: Any) -> int:
    places = np.flatnonzero(vector == number)
    return int(places[0]) if places.size else LANES


@_operation(_plain_first_equal)
def first_equal(_context: Any, vector: Any, number: Any) -> Any:
    """Return the first place at which ``vector`` holds ``number``; `LANES` if there is none."""
    if not (isinstance(vector, VectorType) and vector.dtype == number):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers = _splat(builder, arguments[0].type, arguments[1])
        equal = builder.icmp_unsigned('==', arguments[0], numbers)
        mask = builder.bitcast(equal, ir.IntType(LANES))
        place = builder.cttz(mask, ir.Constant(ir.IntType(1), 0))
        return builder.zext(place, context.get_value_type(signature.return_type))

    return types.intp(vector, number), generate


def _shift(direction: str) -> Any:
    """Return a code generator that shifts integers by a literal number of bits."""

    def generator(_context: Any, vector: Any, bits: Any) -> Any:
        if not isinstance(bits, types.IntegerLiteral):
            return None

        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            amount = ir.Constant(arguments[0].type, [bits.literal_value] * LANES)
            return getattr(builder, direction)(arguments[0], amount)

        return vector(vector, bits), generate

    return generator


# Integers shifted by a literal number of bits; to the right zeros enter.
shift_left = _operation(lambda vector, bits: vector << vector.dtype.type(bits))(_shift('shl'))
shift_right = _operation(lambda vector, bits: vector >> vector.dtype.type(bits))(_shift('lshr'))


def _conversion(dtype: Any) -> Any:
    """Return a code generator that converts to ``dtype``: truncates reals, wraps integers."""

    def generator(_context: Any, vector: Any) -> Any:
        if not isinstance(vector, VectorType):
            return None

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            target = context.get_value_type(signature.return_type)
            from_real = isinstance(vector.dtype, types.Float)
            if isinstance(dtype, types.Float):
                convert = builder.sitofp if vector.dtype.signed else builder.uitofp
            elif from_real:
                convert = builder.fptosi
            elif vector.dtype.bitwidth > dtype.bitwidth:
                convert = builder.trunc
            else:
                convert = builder.sext if vector.dtype.signed else builder.zext
            return convert(arguments[0], target)

        return VectorType(dtype)(vector), generate

    return generator


to_uint8 = _operation(lambda vector: vector.astype(np.uint8))(_conversion(types.uint8))
to_int32 = _operation(lambda vector: vector.astype(np.int32))(_conversion(types.int32))


def _operator(operation: Any, integer: str, real: str) -> None:
    """Let ``operation`` work on two vectors of one type."""

    def operate(_context: Any, a: Any, b: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            if isinstance(a.dtype, types.Float):
                return getattr(builder, real)(*arguments, flags=_CONTRACT)
            return getattr(builder, integer)(*arguments)

        return a(a, b), generate

    emit: Any = intrinsic(operate)

    @overload(operation, strict=False)
    def implement(a: Any, b: Any) -> Any:
        if isinstance(a, VectorType) and a == b:
            return lambda a, b: emit(a, b)  # noqa: PLW0108 (numba compares the arguments' names)
        return None


_operator(operator.add, 'add', 'fadd')
_operator(operator.sub, 'sub', 'fsub')
_operator(operator.mul, 'mul', 'fmul')
_operator(operator.truediv, 'sdiv', 'fdiv')
