# SPDX-License-Identifier: Apache-2.0
"""Guided matching: the disparities of a coarse match are refined at full resolution."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage, Mask, window_range
from binocular_recon.stereo.matching._preparation_kernels import MID_GREY
from binocular_recon.stereo.matching.coarse_to_fine._guided_kernels import (
    MARGIN,
    NO_GUESS,
    RADIUS,
    SIDE,
    GuidedPair,
    hidden_strip,
    refine_strip,
)
from binocular_recon.stereo.matching.half_resolution import half_config
from binocular_recon.stereo.validity import Validity

# Surfaces are told apart if their disparities differ by more than this, in px of half resolution.
EDGE_PX = 1.0
# Pixels this near to an edge, in px of half resolution, may be on the wrong side of it.
NEAR_EDGE_PX = 3
# Halving leaves 4.5 % of the variance of the steps of white noise; below twice that share, in
# windows of this many px of half resolution on each side, there is no texture.
NOISE_SHARE = 0.09
NOISE_WINDOW_PX = 4
# Least square of the NCC where the coarse match has no disparity, or the first or the last one.
CLEAR_SCORE = 0.8


def coarse_config(config: MatchConfig) -> MatchConfig:
    """Return the options of the coarse match; its range covers that of ``config``."""
    first = config.min_disparity // 2
    last = max((config.min_disparity + config.disparity_range - 1) // 2, first + 1)
    return dataclasses.replace(
        half_config(config), min_disparity=first, disparity_range=last - first + 1
    )


def is_noise(image: FloatImage, half: FloatImage) -> Mask:
    """Return where an image has no texture along its rows, only noise.

    Parameters
    ----------
    image, half : (H, W) and ((H + 1) // 2, (W + 1) // 2) float32
        Grey levels, and the same image at half resolution.

    Returns
    -------
    noise : ((H + 1) // 2, (W + 1) // 2) bool

    Notes
    -----
    Halving averages noise away, so the steps between neighbours shrink to a few per cent of their
    variance; steps of texture do not. In noise the best of many scores is as good at half
    resolution as where there is texture across the rows, such as in a sky that is brighter
    further down.

    """
    fine = _variance_of_steps(image, 2 * NOISE_WINDOW_PX)[::2, ::2]
    noise: Mask = _variance_of_steps(half, NOISE_WINDOW_PX) < NOISE_SHARE * fine
    return noise


def _variance_of_steps(image: FloatImage, reach_px: int) -> FloatImage:
    """Return the variance, in windows, of the differences of neighbours in a row."""
    steps = np.zeros_like(image)
    np.subtract(image[:, 1:], image[:, :-1], out=steps[:, 1:])
    steps[np.isnan(steps)] = 0
    size = (2 * reach_px + 1, 2 * reach_px + 1)
    mean = cv2.boxFilter(steps, -1, size)
    return np.asarray(cv2.sqrBoxFilter(steps, -1, size) - mean * mean, np.float32)


def refine_coarse(
    left: FloatImage,
    right: FloatImage,
    coarse: tuple[FloatImage, ByteImage],
    config: MatchConfig,
) -> tuple[FloatImage, ByteImage, ByteImage]:
    """Refine the disparities of half resolution by NCC at full resolution.

    Parameters
    ----------
    left, right : (H, W) float32
        Rectified images, grey levels; NaN = no data.
    coarse : (float32, uint8), each ((H + 1) // 2, (W + 1) // 2)
        Disparity at half resolution, in its pixels, NaN = none, and its validity. The first and
        the last disparity count as matches.
    config : MatchConfig
        Options of the match at full resolution.

    Returns
    -------
    disparity_px : (H, W) float32
        NaN = none.
    validity : (H, W) uint8
        `Validity.MEASURED`, or why there is no disparity.
    near_edges : (H, W) uint8
        1 where pixels may be on the wrong side of an edge of disparity.

    Notes
    -----
    A pixel has up to three guesses: the disparity of its own coarse pixel, and the largest and
    the smallest one of the coarse pixels around, which are those of the other surface at an edge.
    Each is tried with the two next disparities on either side. A pixel without a guess of its own
    takes one of its neighbours' if its score is high. Of several pixels that see the same pixel of
    the right image, only the nearest can.

    """
    shape = left.shape
    own, reasons = coarse
    farthest, nearest = window_range(own, 3)
    none = farthest > nearest
    farthest[none], nearest[none] = np.nan, np.nan
    edges = nearest - farthest > EDGE_PX
    known = np.where(np.isnan(own), farthest, own)
    pair = GuidedPair(
        _bordered(left, RADIUS, RADIUS + LANES),
        _bordered(right, MARGIN, MARGIN),
        np.stack([_guess(surface) for surface in (known, nearest, farthest)]),
        edges,
        (config.texture_threshold * SIDE * SIDE) ** 2,
    )
    limits = coarse_config(config).limits_px
    doubtful = np.isnan(own) | (np.rint(own) <= limits[0]) | (np.rint(own) >= limits[1])
    disparity, validity = np.empty(shape, np.float32), _enlarged(reasons, shape)
    images = known, doubtful, disparity
    over_strips(refine_strip, shape[0], pair, images, CLEAR_SCORE, strip=32)
    if config.disp12_max_diff >= 0:
        # columns are rounded
        tolerance = config.disp12_max_diff + 0.5
        over_strips(hidden_strip, shape[0], disparity, tolerance, validity)
        low, high = config.limits_px
        outside = (disparity < low + 0.5) | (disparity > high - 0.5)
        validity[outside] = Validity.AT_LIMIT
        disparity[outside] = np.nan
    if not config.subpixel:
        np.rint(disparity, out=disparity)
    side = 2 * NEAR_EDGE_PX + 1
    near = cv2.dilate(edges.view(np.uint8), np.ones((side, side), np.uint8))
    return disparity, validity, _enlarged(near, shape)


def _bordered(image: FloatImage, before: int, behind: int) -> FloatImage:
    """Return an image, from mid grey, with columns and rows without data on all sides."""
    borders = RADIUS, RADIUS, before, behind
    centred = image - np.float32(MID_GREY)
    bordered = cv2.copyMakeBorder(centred, *borders, cv2.BORDER_CONSTANT, value=np.nan)
    return np.asarray(bordered, np.float32)


def _guess(half_px: FloatImage) -> npt.NDArray[np.int32]:
    """Return disparities of half resolution in whole pixels of the full one, int32."""
    return np.where(np.isnan(half_px), NO_GUESS, np.rint(2 * half_px)).astype(np.int32)


def _enlarged(half: ByteImage, shape: tuple[int, ...]) -> ByteImage:
    """Return an image of half resolution at full resolution."""
    return np.ascontiguousarray(half.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]])
