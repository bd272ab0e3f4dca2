# SPDX-License-Identifier: Apache-2.0
"""Bits that say where a disparity comes from, and why a pixel has no match."""

from __future__ import annotations

import numpy as np

# As `validity.Validity` names them; here so that kernels that contain them are compiled again
# when they change.
MEASURED = np.uint8(1)
FILLED = np.uint8(2)
EXTRAPOLATED = np.uint8(4)
LOW_TEXTURE = np.uint8(8)
CONFLICT = np.uint8(16)
AMBIGUOUS = np.uint8(32)
AT_LIMIT = np.uint8(64)
NO_DATA = np.uint8(128)
