# SPDX-License-Identifier: Apache-2.0
"""Guided matching: the disparities of a coarse match are refined at full resolution."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage, Mask
from binocular_recon.stereo.matching._preparation_kernels import MID_GREY
from binocular_recon.stereo.matching.coarse_to_fine._guess_kernels import (
    Guesses,
    guess_strip,
    sum_steps,
)
from binocular_recon.stereo.matching.coarse_to_fine._guided_kernels import (
    MARGIN,
    RADIUS,
    SIDE,
    GuidedPair,
    refine_strip,
)
from binocular_recon.stereo.matching.coarse_to_fine._visibility_kernels import hidden_strip
from binocular_recon.stereo.matching.half_resolution import half_config

# Surfaces are told apart if their disparities differ by more than this, in px of half resolution.
EDGE_PX = 1.0
# Pixels this near to an edge, in px of half resolution, may be on the wrong side of it.
NEAR_EDGE_PX = 1
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
    sums = np.empty((4, *half.shape), np.float32)
    over_strips(sum_steps, len(half), image, half, sums)
    size = (2 * NOISE_WINDOW_PX + 1, 2 * NOISE_WINDOW_PX + 1)
    step, square, half_step, half_square = (cv2.boxFilter(part, -1, size) for part in sums)
    fine = square / 4 - step * step / 16  # of 4 steps each
    noise: Mask = half_square - half_step * half_step < NOISE_SHARE * fine
    return noise


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
    near_edges : ((H + 1) // 2, (W + 1) // 2) uint8
        1 where pixels may be on the wrong side of an edge of disparity.

    Notes
    -----
    A pixel has up to three guesses: the disparity of its own coarse pixel, and the largest and
    the smallest one of the coarse pixels around, which are those of the other surface at an edge.
    Each is tried with the next disparity on either side. A pixel without a guess of its own
    takes one of its neighbours' if its score is high. Of several pixels that see the same pixel of
    the right image, only the nearest can.

    """
    own, reasons = coarse
    shape, half = left.shape, own.shape
    limits = coarse_config(config).limits_px
    prior = Guesses(
        np.empty(half, np.float32),
        np.empty((3, *half), np.int32),
        np.empty(half, np.bool_),
        np.empty(half, np.bool_),
    )
    bordered = cv2.copyMakeBorder(own, 1, 1, 1, 1 + LANES, cv2.BORDER_CONSTANT, value=np.nan)
    over_strips(guess_strip, half[0], bordered, EDGE_PX, limits, prior)
    pair = GuidedPair(
        _bordered(left, RADIUS, RADIUS + LANES),
        _bordered(right, MARGIN, MARGIN),
        prior.guesses,
        prior.edges,
        (config.texture_threshold * SIDE * SIDE) ** 2,
    )
    disparity, validity = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    halves, results = (prior.known, prior.doubtful, reasons), (disparity, validity)
    over_strips(refine_strip, shape[0], pair, halves, CLEAR_SCORE, results, strip=32)
    if config.disp12_max_diff >= 0:
        # columns are rounded
        tolerance = config.disp12_max_diff + 0.5
        low, high = config.limits_px
        inside = low + 0.5, high - 0.5
        over_strips(hidden_strip, shape[0], disparity, tolerance, inside, validity)
    if not config.subpixel:
        np.rint(disparity, out=disparity)
    side = 2 * NEAR_EDGE_PX + 1
    near = cv2.dilate(prior.edges.view(np.uint8), np.ones((side, side), np.uint8))
    return disparity, validity, np.asarray(near, np.uint8)


def _bordered(image: FloatImage, before: int, behind: int) -> FloatImage:
    """Return an image, from mid grey, with columns and rows without data on all sides."""
    borders = RADIUS, RADIUS, before, behind
    bordered = cv2.copyMakeBorder(image, *borders, cv2.BORDER_CONSTANT, value=np.nan)
    bordered -= np.float32(MID_GREY)
    return np.asarray(bordered, np.float32)
