# SPDX-License-Identifier: Apache-2.0
"""Find the rods of a board in an image and measure their marks to subpixel accuracy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.calibration.detection._board_layout import Layout, identify
from binocular_recon.calibration.detection._guided_search import (
    Averaged,
    complete,
    goes_on,
    stray_rods,
)
from binocular_recon.calibration.detection._identity import scattered, settle_identity
from binocular_recon.calibration.detection._refinement import Refined, refine
from binocular_recon.calibration.detection._reversed_bands import explains_more, moved_readings
from binocular_recon.calibration.detection._rod_search import Track, find_tracks
from binocular_recon.calibration.target.board_plane import plane_marks, predict_marks
from binocular_recon.calibration.target.mark_types import MarkType
from binocular_recon.calibration.target.missing_marks import describe_missing
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.errors import ImageError
from binocular_recon.images import FloatImage

# Least width and height of an image, px.
MIN_SIZE_PX = 32
# Grey levels between the darkest and the lightest part of an image after stretching.
FULL_RANGE = 255.0
# Least step of an edge, in levels of the stretched image and in standard deviations of its noise.
MIN_STEP, MIN_STEP_SIGMAS = 8.0, 4.0
# With this share of the marks found, no other channel or lean (dx / dy) of the rods is tried.
ENOUGH = 0.6
FURTHER_LEANS = (-0.22, 0.22)
# Share of the marks that the only rod of a board must show.
LONE_ROD_SHARE = 0.8
# Layouts of candidates tried before giving up.
MAX_LAYOUTS = 3
# Identities tried one after the other before giving up.
MAX_IDENTITIES = 3
NOTHING = 'no board found; check that the rods are in view and that rods.yaml describes them'
AMBIGUOUS = (
    'too little of the board is in view to tell which rods and heights these are; show one more'
    ' rod or the feet'
)
ENDLESS = (
    'what looks like the board goes on between its rods or beyond its ends, as facades and'
    ' lattices do; if these are the rods, list all that stand in the row, and all their marks, in'
    ' rods.yaml'
)


@dataclass(frozen=True, eq=False)
class Detection:
    """Marks of a board found in one image.

    Attributes
    ----------
    marks_px : (R, M, 2) float64
        Position x, y of each mark on the rod's visible middle line, px, pixel centres at integers;
        NaN = not found.
    sigma_px : (R, M) float64
        One standard deviation of each mark along its rod, px; NaN = not found.
    messages : tuple of str
        What is missing and what to do about it; empty if every mark was found.
    mark_type : MarkType or None
        The type of marks that the image shows instead of that of ``rods.yaml``.

    """

    marks_px: FloatArray
    sigma_px: FloatArray = field(repr=False)
    messages: tuple[str, ...] = ()
    mark_type: MarkType | None = None

    @property
    def found(self) -> npt.NDArray[np.bool_]:
        """Which marks were found, (R, M) bool."""
        present: npt.NDArray[np.bool_] = np.isfinite(self.marks_px[..., 0])
        return present


def detect_rods(image: npt.NDArray[Any], board: RodBoard) -> Detection:
    """Find the rods of a board in an image.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8 or uint16
        Grey or BGR, not rectified.
    board : RodBoard
        The rods.

    Returns
    -------
    Detection
        The marks; one in doubt is left out. Where the image contradicts ``rods.yaml`` or does not
        show which marks these are, none is found and ``messages`` says why.

    Raises
    ------
    ImageError
        If the image has another type or shape.

    """
    image = _checked(image)
    height, width = image.shape[:2]
    if min(height, width) < MIN_SIZE_PX:
        return _nothing(board, f'an image of {width}x{height} px is too small for rods')
    detection, measured = _search(image, board)
    mark_type = board.mark_type.reversed()
    if mark_type is not None:
        other = replace(board, mark_type=mark_type)
        if _shows(image, other, detection, measured):
            return replace(_nothing(board, mark_type.remedy), mark_type=mark_type)
    return detection


class _Measured(NamedTuple):
    """Marks measured in an image; ``detection`` is empty if they could not be identified."""

    detection: Detection
    refined: Refined
    image: FloatImage
    averaged: Averaged


def _search(
    image: npt.NDArray[Any], board: RodBoard, *, leaning: bool = True
) -> tuple[Detection, _Measured | None]:
    """Return the best detection and the largest set of marks measured, identified or not."""
    best, most = None, None
    for grey, tracks in _searches(image, board, leaning):
        measured = _measure_best(grey, board, tracks)
        detection = measured.detection if measured else _nothing(board, NOTHING)
        if best is None or detection.found.sum() > best.found.sum():
            best = detection
        if measured and (most is None or _count(measured) > _count(most)):
            most = measured
        if best.found.mean() >= ENOUGH:
            break
    assert best is not None
    return best, most


def _count(measured: _Measured) -> int:
    return int(np.isfinite(measured.refined.marks_px[..., 0]).sum())


def _shows(
    image: npt.NDArray[Any], other: RodBoard, detection: Detection, measured: _Measured | None
) -> bool:
    """Return whether an image shows another board markedly better than the detected one."""
    own = None if measured is None else measured.refined
    if measured is not None and detection.found.mean() >= ENOUGH:
        # no new search: the same edges, read as other marks
        readings = moved_readings(measured.image, measured.averaged, other, measured.refined)
        return any(explains_more(reading, own) for reading in readings)
    found, best = _search(image, other, leaning=False)
    # what is not compared with a board must be a good part of one
    enough = found.found.mean() >= ENOUGH if own is None else found.found.any()
    return bool(enough) and best is not None and explains_more(best.refined, own)


def _searches(
    image: npt.NDArray[Any], board: RodBoard, leaning: bool
) -> Iterator[tuple[FloatImage, list[Track]]]:
    """Yield stretched images with candidates for rods: upright ones, then leaning ones too."""
    upright = []
    for grey in _channels(image):
        stretched, threshold = _stretch(grey)
        tracks = find_tracks(stretched, board, threshold)
        yield stretched, tracks
        upright.append((stretched, threshold, tracks))
    for stretched, threshold, tracks in upright if leaning else ():
        yield stretched, find_tracks(stretched, board, threshold, FURTHER_LEANS, tracks)


def _measure_best(grey: FloatImage, board: RodBoard, tracks: list[Track]) -> _Measured | None:
    """Measure the most convincing layout of the tracks; None if there is none."""
    endless = None
    for _ in range(MAX_LAYOUTS):
        layout = identify(tracks, board, (grey.shape[1], grey.shape[0]))
        if layout is None:
            break
        measured = _settle(grey, board, layout)
        if measured is not None and ENDLESS not in measured.detection.messages:
            return measured
        endless = endless or measured
        # regular clutter, such as a chessboard, looked more like the board: try without it
        tracks = [track for t, track in enumerate(tracks) if t not in layout.tracks]
    return endless


def _settle(image: FloatImage, board: RodBoard, layout: Layout) -> _Measured | None:
    """Measure the marks of a layout and identify them; None if it is not a board."""
    rough, averaged = layout.marks_px, Averaged.of(image, layout.width_px)
    for _ in range(MAX_IDENTITIES):
        refined = _measure(image, averaged, board, rough)
        if not _convincing(board, refined.marks_px):
            return None
        identity = settle_identity(image, averaged, board, refined)
        if identity is refined.marks_px:
            marks, sigma, size = *refined[:2], (image.shape[1], image.shape[0])
            stray = stray_rods(board, marks, size)  # and those with a lone mark
            marks[stray], sigma[stray] = np.nan, np.nan
            if board.count > 1 and scattered(board, marks, size):
                return None
            if board.count > 1 and goes_on(image, averaged, board, refined):
                return _Measured(_nothing(board, ENDLESS), refined, image, averaged)
            detection = Detection(marks, sigma, describe_missing(marks))
            return _Measured(detection, refined, image, averaged)
        if identity is None:
            break
        rough = identity
    return _Measured(_nothing(board, AMBIGUOUS), refined, image, averaged)


def _nothing(board: RodBoard, message: str) -> Detection:
    marks = np.full((board.count, board.marks_per_rod, 2), np.nan)
    return Detection(marks, marks[..., 0], (message,))


def _measure(image: FloatImage, averaged: Averaged, board: RodBoard, rough: FloatArray) -> Refined:
    """Measure the rough marks, then the further ones that the board predicts."""
    size = image.shape[1], image.shape[0]
    plane = plane_marks(board, rough, size)
    refined = refine(image, board, rough, predict_marks(board, rough, plane), plane)
    for _ in range(2):
        # measured marks predict the others better than rough ones
        known = refined.marks_px
        plane = plane_marks(board, known, size)
        predicted = predict_marks(board, known, plane)
        more = complete(averaged, board, known, predicted)
        if np.isfinite(more).sum() == np.isfinite(known).sum():
            break
        refined = refine(image, board, more, predicted, plane)
    return refined


def _convincing(board: RodBoard, marks_px: FloatArray) -> bool:
    """Return whether there are enough marks for a board: three on each of two rods.

    Only its marks distinguish a single rod from a banded post: most must be there.
    """
    per_rod = np.isfinite(marks_px[..., 0]).sum(1)
    if board.count == 1:
        return bool(per_rod[0] >= LONE_ROD_SHARE * board.marks_per_rod)
    complete_rods = (per_rod >= min(3, board.marks_per_rod)).sum()
    return bool(complete_rods >= 2)


def _checked(image: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an image as (H, W) or (H, W, 3); raise an ImageError for any other."""
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3):
        raise ImageError(
            f'an image of rods must be (H, W) or (H, W, 3) uint8 or uint16, got'
            f' {image.shape} {image.dtype}'
        )
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim == 3 and image.shape[2] != 3:
        raise ImageError(f'a colour image must have 3 channels, got {image.shape[2]}')
    return image


def _channels(image: npt.NDArray[Any]) -> Iterator[FloatImage]:
    """Yield the grey images to search, as float32: luminance, then the smallest channel.

    The smallest of blue, green and red is low on every strong colour and high on white.
    """
    if image.ndim == 2:
        yield image.astype(np.float32)
        return
    color = image.astype(np.float32)
    yield np.asarray(cv2.cvtColor(color, cv2.COLOR_BGR2GRAY))
    yield color.min(2)


def _stretch(grey: FloatImage) -> tuple[FloatImage, float]:
    """Stretch an image to the full range; return it and the least step of an edge."""
    # rods may fill only a thousandth of an image; averaging hides single bad pixels
    sample = cv2.resize(grey, None, fx=1 / 3, fy=1 / 3, interpolation=cv2.INTER_AREA)
    low, high = np.percentile(sample, (0.01, 99.99))
    gain = FULL_RANGE / max(float(high - low), 1e-3)
    # a gain only: shading on a round rod is a factor, so black must stay black
    stretched = grey * np.float32(gain)
    # noise from the median of absolute second differences: most of an image is smooth
    rows = stretched[::4]
    second = np.abs(rows[:, :-2] - 2 * rows[:, 1:-1] + rows[:, 2:])
    noise = float(np.median(second)) / 0.6745 / np.sqrt(6)
    return stretched, max(MIN_STEP, MIN_STEP_SIGMAS * min(noise, 10.0))
