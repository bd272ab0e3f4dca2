# SPDX-License-Identifier: Apache-2.0
"""The type of a vector of 32 numbers and how its operations are declared."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.extending import intrinsic, models, register_model

LANES = 32

CONTRACT = ('contract',)


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


def operation(plain: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Return a decorator that compiles a code generator, or with JIT disabled takes ``plain``."""
    return lambda generator: plain if config.DISABLE_JIT else intrinsic(generator)  # type: ignore[attr-defined]


def emit_splat(builder: Any, vector: Any, number: Any) -> Any:
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, number, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(first, undefined, zeros)


def emit_shuffle(builder: Any, pair: Any, lanes: list[int]) -> Any:
    """Return a vector of the given lanes of a pair of vectors, counted through both."""
    return builder.shuffle_vector(*pair, ir.Constant(ir.VectorType(ir.IntType(32), LANES), lanes))
