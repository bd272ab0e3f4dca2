# SPDX-License-Identifier: Apache-2.0
"""Vectors of 32 numbers, for kernels whose inner loops LLVM does not vectorise well by itself.

In a short inner loop over slices, bounds and aliasing checks cost more than the arithmetic. With
these operations a kernel states the vectors itself; LLVM maps each onto the registers of the
machine (one of 32 bytes or two of 16 for ``uint8``). With ``NUMBA_DISABLE_JIT=1`` a vector is a
NumPy array and the same kernels run as plain Python.

``a + b``, ``a - b`` and ``a * b`` take vectors of one type, ``a / b`` real ones; integers wrap
around. `vectors` declares the type, `memory` loads, stores and rearranges, `arithmetic` computes.
"""

from binocular_recon._simd.arithmetic import (
    add_saturated,
    at_most,
    first_equal,
    larger,
    largest,
    narrow,
    shift_left,
    shift_right,
    smaller,
    smallest,
    to_float32,
    to_int32,
    to_uint8,
    to_uint16,
    widen,
)
from binocular_recon._simd.memory import (
    copy_pair,
    first_of,
    last_of,
    load,
    load_even,
    load_odd,
    slide,
    splat,
    store,
    store_pairs,
)
from binocular_recon._simd.vectors import LANES

__all__ = [
    'LANES',
    'add_saturated',
    'at_most',
    'copy_pair',
    'first_equal',
    'first_of',
    'larger',
    'largest',
    'last_of',
    'load',
    'load_even',
    'load_odd',
    'narrow',
    'shift_left',
    'shift_right',
    'slide',
    'smaller',
    'smallest',
    'splat',
    'store',
    'store_pairs',
    'to_float32',
    'to_int32',
    'to_uint8',
    'to_uint16',
    'widen',
]
