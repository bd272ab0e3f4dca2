# SPDX-License-Identifier: Apache-2.0
"""Notice rods whose dark and light bands are exchanged against what ``rods.yaml`` says.

With even spacing, the edges of such rods fit the board moved up or down by one mark: most marks
are found, all at wrong heights. Read with the other type of marks, each rod shows one mark more,
and the rod visibly goes on beyond it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from binocular_recon.calibration.detection._guided_search import Averaged, complete
from binocular_recon.calibration.detection._refinement import Refined, refine
from binocular_recon.calibration.target.board_plane import plane_marks, predict_marks
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.images import FloatImage, Mask

# Edges of two readings that are nearer to each other than this are the same one, px.
SAME_PX = 3.0
# A reading must explain this many marks more than another one, and this share of the number of
# rods. On 72 simulated boards the wrong type of marks never gained one.
MIN_GAIN, MIN_GAIN_SHARE = 2, 0.4


def moved_readings(
    image: FloatImage, averaged: Averaged, board: RodBoard, own: Refined
) -> Iterator[Refined]:
    """Read the same edges as marks one lower and one higher; yield readings that find more.

    ``own`` are the marks found with the type that ``rods.yaml`` states; ``board`` has the other
    type.
    """
    size = image.shape[1], image.shape[0]
    for shift in (-1, 1):
        moved = np.roll(own.marks_px, shift, axis=1)
        moved[:, 0 if shift > 0 else -1] = np.nan
        plane = plane_marks(board, moved, size)
        predicted = predict_marks(board, moved, plane)
        more = complete(averaged, board, moved, predicted)
        if (_found(more) & ~_found(moved)).sum() >= _least_gain(more):
            yield refine(image, board, more, predicted, plane)


def explains_more(other: Refined, own: Refined | None) -> bool:
    """Return whether a reading of an image explains markedly more of its edges than another."""
    gain = _extra_marks(other, own)
    if own is not None:
        gain -= _extra_marks(own, other)
    return gain >= _least_gain(other.marks_px)


def _found(marks_px: FloatArray) -> Mask:
    found: Mask = np.isfinite(marks_px[..., 0])
    return found


def _least_gain(marks_px: FloatArray) -> float:
    """Return how many marks more than another one a reading must explain."""
    rods = int(_found(marks_px).any(1).sum())
    return max(min(MIN_GAIN, len(marks_px)), MIN_GAIN_SHARE * rods)


def _extra_marks(reading: Refined, other: Refined | None) -> int:
    """Count the marks that another reading lacks, without those that may be ends of rods."""
    found = _found(reading.marks_px)
    extra = found & ~_outermost_without_rod(found, reading.goes_on)
    points = reading.marks_px[extra]
    if other is None:
        return len(points)
    known = other.marks_px[_found(other.marks_px)]
    gaps = np.linalg.norm(points[:, None] - known, axis=2)
    return int((gaps.min(1, initial=np.inf) > SAME_PX).sum())


def _outermost_without_rod(found: Mask, goes_on: Mask) -> Mask:
    """Return the lowest and highest marks of rods that do not visibly go on there, (R, M)."""
    lowest = found & (np.cumsum(found, axis=1) == 1)
    highest = found & (np.cumsum(found[:, ::-1], axis=1)[:, ::-1] == 1)
    ends: Mask = (lowest & ~goes_on[..., 0]) | (highest & ~goes_on[..., 1])
    return ends
