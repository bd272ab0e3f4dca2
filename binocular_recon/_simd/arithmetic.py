# SPDX-License-Identifier: Apache-2.0
"""Arithmetic, comparisons, reductions and conversions of vectors."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic, overload

from binocular_recon._simd.vectors import CONTRACT, LANES, VectorType, emit_splat, operation


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


# Element-wise minimum and maximum (of NaN and a number: the number), and the sum of integers,
# saturated at the largest one of the type.
smaller = operation(np.fmin)(_pairwise('smin', 'umin', 'minnum'))
larger = operation(np.fmax)(_pairwise('smax', 'umax', 'maxnum'))
add_saturated = operation(_plain_add_saturated)(_pairwise('sadd.sat', 'uadd.sat', ''))


@operation(lambda value, limit, low, high: np.where(value <= limit, low, high))
def at_most(_context: Any, value: Any, limit: Any, low: Any, high: Any) -> Any:
    """Return ``low`` where ``value <= limit``, else ``high``, also where either is NaN."""
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


# The smallest and the largest number of a vector of integers.
smallest = operation(np.min)(_reduction('smin', 'umin'))
largest = operation(np.max)(_reduction('smax', 'umax'))


def _plain_first_equal(vector: Any, number: Any) -> int:
    lanes = np.flatnonzero(vector == number)
    return int(lanes[0]) if lanes.size else LANES


@operation(_plain_first_equal)
def first_equal(_context: Any, vector: Any, number: Any) -> Any:
    """Return the first lane of ``vector`` that holds ``number``; `LANES` if none does."""
    if not (isinstance(vector, VectorType) and vector.dtype == number):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        numbers = emit_splat(builder, arguments[0].type, arguments[1])
        equal = builder.icmp_unsigned('==', arguments[0], numbers)
        mask = builder.bitcast(equal, ir.IntType(LANES))
        lane = builder.cttz(mask, ir.Constant(ir.IntType(1), 0))
        return builder.zext(lane, context.get_value_type(signature.return_type))

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


# Integers shifted by a literal number of bits; the free bits are zero.
shift_left = operation(lambda vector, bits: vector << vector.dtype.type(bits))(_shift('shl'))
shift_right = operation(lambda vector, bits: vector >> vector.dtype.type(bits))(_shift('lshr'))


def _conversion(dtype: Any) -> Any:
    """Return a code generator that converts to ``dtype``; reals are truncated, integers wrap."""

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


to_uint8 = operation(lambda vector: vector.astype(np.uint8))(_conversion(types.uint8))
to_uint16 = operation(lambda vector: vector.astype(np.uint16))(_conversion(types.uint16))
to_int32 = operation(lambda vector: vector.astype(np.int32))(_conversion(types.int32))
to_float32 = operation(lambda vector: vector.astype(np.float32))(_conversion(types.float32))


def _plain_narrow(vector: Any) -> Any:
    return (vector.view(np.uint32) >> 16).astype(np.uint16)


@operation(_plain_narrow)
def narrow(_context: Any, vector: Any) -> Any:
    """Return the upper 16 bits of float32: sign, exponent and 7 bits, rounded towards zero."""
    if not (isinstance(vector, VectorType) and vector.dtype == types.float32):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        words = ir.VectorType(ir.IntType(32), LANES)
        bits = builder.bitcast(arguments[0], words)
        upper = builder.lshr(bits, ir.Constant(words, [16] * LANES))
        return builder.trunc(upper, context.get_value_type(signature.return_type))

    return VectorType(types.uint16)(vector), generate


def _plain_widen(vector: Any) -> Any:
    if vector.dtype == np.float32:
        return vector
    return (vector.astype(np.uint32) << 16).view(np.float32)


@operation(_plain_widen)
def widen(_context: Any, vector: Any) -> Any:
    """Return the float32 of which `narrow` kept the upper bits; float32 as it is."""
    if not (isinstance(vector, VectorType) and vector.dtype in (types.float32, types.uint16)):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if isinstance(vector.dtype, types.Float):
            return arguments[0]
        words = ir.VectorType(ir.IntType(32), LANES)
        bits = builder.zext(arguments[0], words)
        upper = builder.shl(bits, ir.Constant(words, [16] * LANES))
        return builder.bitcast(upper, context.get_value_type(signature.return_type))

    return VectorType(types.float32)(vector), generate


def _operator(operation: Any, integer: str, real: str) -> None:
    """Implement an operator for two vectors of one type."""

    def operate(_context: Any, a: Any, b: Any) -> Any:
        def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            if isinstance(a.dtype, types.Float):
                return getattr(builder, real)(*arguments, flags=CONTRACT)
            return getattr(builder, integer)(*arguments)

        return a(a, b), generate

    emit: Any = intrinsic(operate)

    @overload(operation, strict=False)
    def implement(a: Any, b: Any) -> Any:
        if isinstance(a, VectorType) and a == b:
            return lambda a, b: emit(a, b)  # noqa: PLW0108 (numba checks the arguments' names)
        return None


_operator(operator.add, 'add', 'fadd')
_operator(operator.sub, 'sub', 'fsub')
_operator(operator.mul, 'mul', 'fmul')
_operator(operator.truediv, 'sdiv', 'fdiv')
