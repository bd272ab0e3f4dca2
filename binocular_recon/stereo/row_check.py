# SPDX-License-Identifier: Apache-2.0
"""By how many rows matched points of a rectified pair differ: 0 if the calibration still holds."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.images import FloatImage

# A larger offset (median of the matches, px) is worth a warning.
MOST_ROWS_PX = 0.5
# Points are the best corners of the cells of a grid; with fewer of them nothing is said.
_CELLS, LEAST_POINTS = (18, 12), 30
# Half sides of the window that is compared, and of the shifts that are tried, px.
_HALF, _SHIFT_X, _SHIFT_Y = 6, 2, 6
# Least correlation of a match.
_LEAST_SCORE = 0.8
# Of the matches of features, this share and this many agree about how far rows are off.
_AGREE_SHARE, _AGREE_LEAST, _AGREE_PX, _FEATURES = 0.4, 20, 1.5, 1500
# A turn, degrees, or another scale explains them if this many times as many agree.
_TURNS, _SCALES, _MORE_AGREE = np.arange(-15, 15.1, 0.25), np.arange(0.7, 1.41, 0.0025), 1.5
# With fewer features that look alike nothing is said about what the images show. Of those of other
# scenes less than this share lies, by chance, within so many px of epipolar lines of any pose.
_FEW_FEATURES, _CHANCE_SHARE, _ON_LINE_PX, _TRIES = 100, 0.15, 2.0, 2000


class RowOffset(NamedTuple):
    """By how much the rows of matched points differ.

    Attributes
    ----------
    median_px : float
        Median of row right minus row left, px; NaN with too few points.
    spread_px : float
        Median of its absolute value, px, which also shows a turn about the optical axis.
    points : int
        Number of points.

    """

    median_px: float = np.nan
    spread_px: float = np.nan
    points: int = 0

    @property
    def warning(self) -> str:
        """Why the rows do not correspond; empty if they do or too few points were found."""
        if not self.spread_px > MOST_ROWS_PX:
            return ''
        turned = abs(self.median_px) < self.spread_px / 2
        what = (
            f'differ by {self.spread_px:.2f} px, up in one part of the image and down in another:'
            ' a camera has turned'
            if turned
            else f'differ by {abs(self.median_px):.2f} px: the right image is'
            f' {"lower" if self.median_px > 0 else "higher"}'
        )
        return (
            f'rows of left and right {what} (median of {self.points} matches, at most'
            f' {MOST_ROWS_PX:g} px); calibrate again, or use the calibration of these images'
        )


def measure_rows(left: FloatImage, right: FloatImage, disparity_px: FloatImage) -> RowOffset:
    """Measure by how many rows matched points differ, on corners all over the image.

    Parameters
    ----------
    left, right : (H, W) float32
        Rectified grey images; NaN = no data.
    disparity_px : (H, W) float32
        Measured disparities; NaN = none.

    """
    points = _corners(left, disparity_px)
    right = np.nan_to_num(right)
    side = 2 * _HALF + 1
    around = (side + 2 * _SHIFT_X, side + 2 * _SHIFT_Y)
    height, width = left.shape
    offsets = []
    for x, y in points:
        x_right = float(x - disparity_px[y, x])
        if not (
            _HALF <= x < width - _HALF
            and _HALF + _SHIFT_X < x_right < width - _HALF - _SHIFT_X - 1
            and _HALF + _SHIFT_Y <= y < height - _HALF - _SHIFT_Y
        ):
            continue
        window = left[y - _HALF : y + _HALF + 1, x - _HALF : x + _HALF + 1]
        if np.isnan(window).any():
            continue
        place = cv2.getRectSubPix(right, around, (x_right, float(y)))
        offset = _best_shift(cv2.matchTemplate(place, window, cv2.TM_CCOEFF_NORMED))
        if offset is not None:
            offsets.append(offset)
    if len(offsets) < LEAST_POINTS:
        return RowOffset(points=len(offsets))
    found = np.array(offsets)
    return RowOffset(float(np.median(found)), float(np.median(np.abs(found))), len(offsets))


def _corners(left: FloatImage, disparity_px: FloatImage) -> list[tuple[int, int]]:
    """Return column and row of the best corner of each cell that has a disparity."""
    strength = cv2.cornerMinEigenVal(np.nan_to_num(left), 5)
    strength[~np.isfinite(disparity_px)] = 0
    height, width = left.shape
    columns = np.linspace(0, width, _CELLS[0] + 1).astype(int)
    rows = np.linspace(0, height, _CELLS[1] + 1).astype(int)
    points = []
    for top, bottom in itertools.pairwise(rows):
        for start, stop in itertools.pairwise(columns):
            cell = strength[top:bottom, start:stop]
            if cell.size and cell.max() > 0:
                row, column = np.unravel_index(int(cell.argmax()), cell.shape)
                points.append((start + int(column), top + int(row)))
    return points


def _best_shift(scores: npt.NDArray[np.float32]) -> float | None:
    """Return the row of the best score from the middle, px, None if there is no clear one."""
    row, column = np.unravel_index(int(scores.argmax()), scores.shape)
    if not (0 < row < len(scores) - 1 and scores[row, column] >= _LEAST_SCORE):
        return None
    above, best, below = (float(scores[row + step, column]) for step in (-1, 0, 1))
    curvature = above - 2 * best + below
    if curvature >= 0:
        return None
    return float(row) - _SHIFT_Y + (above - below) / (2 * curvature)


def matched_features(left: FloatImage, right: FloatImage) -> FloatImage:
    """Return x and y of features that look alike, in the left and the right image: (n, 2, 2).

    The images (H, W) have grey levels; NaN = no data.
    """
    detector = cv2.ORB_create(nfeatures=_FEATURES)
    (left_points, left_descriptors), (right_points, right_descriptors) = (
        detector.detectAndCompute(_bytes(image), None) for image in (left, right)
    )
    if left_descriptors is None or right_descriptors is None:
        return np.empty((0, 2, 2), np.float32)
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(
        left_descriptors, right_descriptors
    )
    points = [(left_points[one.queryIdx].pt, right_points[one.trainIdx].pt) for one in pairs]
    return np.array(points, np.float32).reshape(-1, 2, 2)


def rows_apart(features: FloatImage, shape: tuple[int, ...]) -> str:
    """Say that rows are off by more than matching bridges, from features anywhere.

    Parameters
    ----------
    features : (n, 2, 2) float32
        As `matched_features` returns them.
    shape : tuple of int
        Rows and columns of the images.

    Returns
    -------
    str
        By how far, or how the right image is turned or larger; empty if most features do not
        agree about any of these.

    """
    if len(features) < _AGREE_LEAST:
        return ''
    middle = (np.array(shape[::-1]) - 1) / 2
    rows = features[:, 0, 1] - middle[1]
    x, y = (features[:, 1] - middle).T
    agreeing, off_px = _shared(y - rows)
    turned, turn_deg = _most_agreeing(
        (float(turn), y * np.cos(np.radians(turn)) - x * np.sin(np.radians(turn)) - rows)
        for turn in _TURNS
    )
    scaled, scale = _most_agreeing((float(scale), y / scale - rows) for scale in _SCALES)
    text = ''
    if agreeing >= _AGREE_SHARE * rows.size and abs(off_px) >= MOST_ROWS_PX:
        text = (
            f'rows of left and right differ by about {abs(off_px):.1f} px: the right image is'
            f' {"lower" if off_px > 0 else "higher"}'
        )
    if turned > max(_MORE_AGREE * agreeing, scaled):
        agreeing = turned
        way = 'clockwise' if turn_deg > 0 else 'counter-clockwise'
        text = f'the right image is turned by about {abs(turn_deg):.1f} degrees {way}'
    elif scaled > _MORE_AGREE * agreeing:
        agreeing = scaled
        text = f'the right image shows everything {scale:.2f} times as large as the left one'
    if not text or agreeing < max(_AGREE_LEAST, _AGREE_SHARE * rows.size):
        return ''
    return f'{text} ({agreeing} of {rows.size} features); rectify, or calibrate again'


def seen_by_both(features: FloatImage) -> str:
    """Say that the images show different things, or the same on other rows.

    Empty if there are few features (n, 2, 2), as of `matched_features`, or the two images are as
    unlike as a good pair may be.
    """
    if len(features) < _FEW_FEATURES:
        return ''
    features = features.astype(np.float64)
    cv2.setRNGSeed(0)
    _, mask = cv2.findFundamentalMat(
        features[:, 0], features[:, 1], cv2.FM_RANSAC, _ON_LINE_PX, 0.99, _TRIES
    )
    inliers = np.zeros(len(features), np.bool_) if mask is None else mask.ravel() > 0
    share = float(inliers.mean())
    if share < _CHANCE_SHARE:
        return (
            f'left and right show different things: {share:.0%} of {len(features)} features that'
            ' look alike fit any pose of two cameras, as by chance; check that both images are of'
            ' this rig and of the same moment'
        )
    apart_px = float(np.median(np.abs(np.diff(features[inliers, :, 1], axis=1))))
    if share < _AGREE_SHARE or apart_px < _AGREE_PX:
        return ''
    return (
        f'left and right show the same, but not on the same rows: {share:.0%} of'
        f' {len(features)} features fit two cameras, and their rows differ by {apart_px:.1f} px'
        ' (median); rectify the images, with the calibration of this rig'
    )


def _most_agreeing(
    candidates: Iterable[tuple[float, npt.NDArray[np.float64]]],
) -> tuple[int, float]:
    """Return how many steps agree for the best of values and their steps, and that value."""
    return max((_shared(steps)[0], value) for value, steps in candidates)


def _shared(steps: npt.NDArray[np.float64]) -> tuple[int, float]:
    """Return how many of the steps (n,) px agree, and their median."""
    steps = np.sort(steps)
    counts = np.searchsorted(steps, steps + _AGREE_PX) - np.arange(steps.size)
    first = int(counts.argmax())
    return int(counts[first]), float(np.median(steps[first : first + counts[first]]))


def _bytes(image: FloatImage) -> FloatImage:
    known = np.nan_to_num(image, nan=float(np.nanmean(image)))
    return np.asarray(cv2.normalize(known, None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U))
