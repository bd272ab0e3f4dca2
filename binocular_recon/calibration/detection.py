# SPDX-License-Identifier: Apache-2.0
"""Find the rods of a board in a picture and measure their marks below a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.calibration._board_layout import (
    expected_in_picture,
    identify,
    other_identities,
    plane_marks,
)
from binocular_recon.calibration._guided_search import complete, predict_marks
from binocular_recon.calibration._refinement import Refined, refine
from binocular_recon.calibration._rod_search import find_tracks
from binocular_recon.calibration.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.errors import ImageError

FloatImage = npt.NDArray[np.float32]

# Grey levels between the darkest and the lightest part of a picture after stretching.
FULL_RANGE = 255.0
# Least step of a border, in levels of the stretched picture and in standard deviations of noise.
LEAST_STEP, LEAST_STEP_SIGMAS = 8.0, 4.0
# With this share of the marks found, no other channel or lean (dx / dy) of the rods is tried.
ENOUGH = 0.6
FURTHER_LEANS = (-0.22, 0.22)
# By how many marks (missing ones count half) an identity must beat every other one.
CLEAR_MARGIN = 1.5
# Identities adopted one after the other before giving up.
MOST_IDENTITIES = 3
# Marks nearer to the frame than this may be missed, px.
FRAME_MARGIN_PX = 4.0
NOTHING = 'no board found; check that the rods are in view and that rods.yaml describes them'
AMBIGUOUS = (
    'too little of the board is in view to tell which rods and heights these are; show one more'
    ' rod or the feet'
)


@dataclass(frozen=True, eq=False)
class Detection:
    """What was found of a board in one picture.

    Attributes
    ----------
    marks_px : (R, M, 2) float64
        Position x, y of each mark on the rod's visible middle line, px, pixel centres at integers;
        NaN = not found.
    sigma_px : (R, M) float64
        One standard deviation of each mark along its rod, px; NaN = not found.
    messages : tuple of str
        What is missing, in words a crew can act on; empty if every mark was found.

    """

    marks_px: FloatArray
    sigma_px: FloatArray = field(repr=False)
    messages: tuple[str, ...] = ()

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """Which marks were found, (R, M) bool."""
        present: npt.NDArray[np.bool_] = np.isfinite(self.marks_px[..., 0])
        return present


def detect_rods(image: npt.NDArray[Any], board: RodBoard) -> Detection:
    """Find the rods of a board in a picture.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8 or uint16
        Grey or BGR picture, not rectified.
    board : RodBoard
        The rods.

    Returns
    -------
    Detection
        Each mark with its rod and height, or left out if there is doubt.

    Raises
    ------
    ImageError
        If the picture's type or shape is another.

    """
    best: Detection | None = None
    for leans in ((0.0,), (0.0, *FURTHER_LEANS)):
        for grey in _channels(image):
            detection = _detect(grey, board, leans)
            if best is None or detection.found.sum() > best.found.sum():
                best = detection
            if best.found.mean() >= ENOUGH:
                return best
    assert best is not None
    return best


def _detect(grey: FloatImage, board: RodBoard, leans: tuple[float, ...]) -> Detection:
    stretched, threshold = _stretch(grey)
    size = grey.shape[1], grey.shape[0]
    rough, width = identify(find_tracks(stretched, board, threshold, leans), board, size)
    if not np.isfinite(rough).any():
        return Detection(rough, rough[..., 0], (NOTHING,))
    nothing = np.full_like(rough, np.nan)
    for _ in range(MOST_IDENTITIES):
        refined = _measure(stretched, board, rough, width)
        if not _convincing(board, refined.marks_px):
            return Detection(nothing, nothing[..., 0], (NOTHING,))
        identity = _identity(stretched, board, refined.marks_px, width)
        if identity is refined.marks_px:
            return Detection(refined.marks_px, refined.sigma_px, _messages(refined.marks_px))
        if identity is None:
            break
        rough = identity
    return Detection(nothing, nothing[..., 0], (AMBIGUOUS,))


def _measure(image: FloatImage, board: RodBoard, rough: FloatArray, width_px: float) -> Refined:
    """Measure the marks found roughly, then those that the board says must be there too."""
    plane = plane_marks(board, rough)
    refined = refine(image, board, rough, predict_marks(board, rough, plane), plane)
    for _ in range(2):
        # what is measured tells better where the rest must be
        known = refined.marks_px
        plane = plane_marks(board, known)
        predicted = predict_marks(board, known, plane)
        more = complete(image, board, known, predicted, width_px)
        if np.isfinite(more).sum() == np.isfinite(known).sum():
            break
        refined = refine(image, board, more, predicted, plane)
    return refined


def _convincing(board: RodBoard, marks_px: FloatArray) -> bool:
    """Return whether enough marks stand in line for a board: three on each of two rods."""
    per_rod = np.isfinite(marks_px[..., 0]).sum(1)
    complete_rods = (per_rod >= min(3, board.marks_per_rod)).sum()
    return bool(complete_rods >= min(2, board.count))


def _identity(
    image: FloatImage, board: RodBoard, marks_px: FloatArray, width_px: float
) -> FloatArray | None:
    """Return the marks with the identity that the picture supports best; None if two do.

    Every other identity that the spacings allow is tried: more marks must then be somewhere else,
    and they are there or not.
    """
    scores = [_support(image, board, marks_px, width_px)]
    ways = [marks_px]
    count = np.isfinite(marks_px[..., 0]).sum()
    for other in other_identities(board, marks_px):
        ways.append(other)
        # marks that the other identity has no place for speak against it
        dropped = count - np.isfinite(other[..., 0]).sum()
        scores.append(_support(image, board, other, width_px) - 0.5 * dropped)
    order = np.argsort(-np.array(scores), kind='stable')
    if scores[order[0]] <= 0:
        return None
    if len(ways) > 1 and scores[order[0]] - scores[order[1]] < CLEAR_MARGIN:
        return None
    best: FloatArray = ways[order[0]]
    return best


def _support(image: FloatImage, board: RodBoard, marks_px: FloatArray, width_px: float) -> float:
    """Return the number of marks found under an identity less half the number missing."""
    plane = plane_marks(board, marks_px)
    predicted = predict_marks(board, marks_px, plane)
    more = complete(image, board, marks_px, predicted, width_px)
    new = np.isfinite(more[..., 0]) & ~np.isfinite(marks_px[..., 0])
    added = 0
    if new.any():
        only_new = np.where(new[..., None], more, np.nan)
        added = int(np.isfinite(refine(image, board, only_new, predicted, plane).sigma_px).sum())
    found = int(np.isfinite(marks_px[..., 0]).sum()) + added
    size = image.shape[1], image.shape[0]
    expected = expected_in_picture(predicted, size, FRAME_MARGIN_PX)
    return found - 0.5 * max(0, int(expected.sum()) - found)


def _channels(image: npt.NDArray[Any]) -> Iterator[FloatImage]:
    """Yield the grey pictures to search, as float32: luminance, then what painted bands differ in.

    The smallest of blue, green and red is low on every strong colour and high on white.
    """
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3):
        raise ImageError(
            f'a picture of rods must be (H, W) or (H, W, 3) uint8 or uint16, got'
            f' {image.shape} {image.dtype}'
        )
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 2:
        yield image.astype(np.float32)
        return
    if image.shape[2] != 3:
        raise ImageError(f'a colour picture must have 3 channels, got {image.shape[2]}')
    color = image.astype(np.float32)
    yield np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY))
    yield color.min(2)


def _stretch(grey: FloatImage) -> tuple[FloatImage, float]:
    """Stretch a picture to the full range; return it and the least step of a border."""
    # rods may fill no more than a thousandth of a picture; the mean of pixels hides a bad one
    sample = cv2.resize(grey, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    low, high = np.percentile(sample, (0.01, 99.99))
    gain = FULL_RANGE / max(float(high - low), 1e-3)
    # black stays black: light on a round rod multiplies
    stretched = grey * np.float32(gain)
    # the median of absolute second differences tells the noise: flat places prevail
    rows = stretched[::4]
    second = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
    noise = float(np.median(second)) / 0.6745 / np.sqrt(6)
    return stretched, max(LEAST_STEP, LEAST_STEP_SIGMAS * min(noise, 10.0))


def _messages(marks_px: FloatArray) -> tuple[str, ...]:
    """Say what is missing."""
    found = np.isfinite(marks_px[..., 0])
    if found.all():
        return ()
    rods = [f'rod {r + 1} of {len(found)} not found' for r in np.nonzero(~found.any(1))[0]]
    return (*rods, f'{found.sum()} of {found.size} marks')
