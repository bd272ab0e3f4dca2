# SPDX-License-Identifier: Apache-2.0
"""One camera as the joint adjustment starts with it."""

from __future__ import annotations

from dataclasses import dataclass

from binocular_recon.camera import FloatArray


@dataclass(frozen=True, eq=False)
class CameraEstimate:
    """One camera and the boards it saw."""

    K: FloatArray
    D: FloatArray
    rotations: FloatArray
    translations_m: FloatArray
