# SPDX-License-Identifier: Apache-2.0
"""Say which marks of a board an image does not show."""

from __future__ import annotations

import numpy as np

from binocular_recon.camera import FloatArray
from binocular_recon.images import Mask


def describe_missing(marks_px: FloatArray) -> tuple[str, ...]:
    """Describe which marks (R, M, 2) of a board were not found, NaN; nothing if all were."""
    found: Mask = np.isfinite(marks_px[..., 0])
    if found.all():
        return ()
    rods: Mask = np.any(found, axis=1)
    messages = []
    for rod, marks in enumerate(found):
        if not rods[rod]:
            # the rods beside it are in view, so the image border is not the cause
            between = rods[:rod].any() and rods[rod + 1 :].any()
            cause = '; people or things before it?' if between else ''
            messages.append(f'rod {rod + 1} of {len(found)} not found{cause}')
            continue
        low, high = np.flatnonzero(marks)[[0, -1]]
        gaps = [str(mark + 1) for mark in range(low, high) if not marks[mark]]
        if gaps:
            what = f'mark {gaps[0]}' if len(gaps) == 1 else f'marks {", ".join(gaps)}'
            messages.append(f'rod {rod + 1}: {what} hidden; people or things before it?')
    return (*messages, f'{found.sum()} of {found.size} marks')
