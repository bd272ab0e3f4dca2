# SPDX-License-Identifier: Apache-2.0
"""Bits of a validity image; `validity.Validity` describes them."""

from __future__ import annotations

import numpy as np

# In a kernel module, so that kernels that contain these numbers are compiled again if they change.
MEASURED = np.uint8(1)
FILLED = np.uint8(2)
EXTRAPOLATED = np.uint8(4)
LOW_TEXTURE = np.uint8(8)
CONFLICT = np.uint8(16)
AMBIGUOUS = np.uint8(32)
AT_LIMIT = np.uint8(64)
NO_DATA = np.uint8(128)
