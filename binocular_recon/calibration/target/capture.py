# SPDX-License-Identifier: Apache-2.0
"""The marks of one board in both images."""

from __future__ import annotations

from dataclasses import dataclass

from binocular_recon.camera import FloatArray


@dataclass(frozen=True, eq=False)
class Capture:
    """The marks of one board in both images.

    Attributes
    ----------
    name : str
        Name of the board, for messages and reports.
    left_px, right_px : (R, M, 2) float64
        Image positions x, y of the marks, pixel centres at integers; NaN = not found.

    """

    name: str
    left_px: FloatArray
    right_px: FloatArray
