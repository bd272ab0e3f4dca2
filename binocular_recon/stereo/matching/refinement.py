# SPDX-License-Identifier: Apache-2.0
"""Refinement: speckles and flying pixels are dropped, disparities smoothed along planes."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon._simd import LANES
from binocular_recon.config import MatchConfig
from binocular_recon.images import ByteImage, FloatImage, window_range
from binocular_recon.stereo.holes.completion import fill_from_background
from binocular_recon.stereo.matching._preparation import exposure_gain
from binocular_recon.stereo.matching._refinement_kernels import (
    BORDER,
    MEDIAN_BORDER,
    drop_negative,
    find_between_strip,
    pad_strip,
    plane_strip,
    quantise,
    weighted_median_strip,
)

# Standard deviation of a smoothed disparity: a constant (interpolation, rectification), and a
# factor on the residuals of the plane (errors of neighbours are correlated). Measured on
# Motorcycle, cones and teddy, where errors rise from 0.15 to 0.45 px with the residuals.
COMMON_SIGMA_PX = 0.15
RESIDUAL_FACTOR = 1.5
# Samples whose disparity differs by more than this belong to another surface.
SAME_SURFACE_PX = 1.5
# Weighted median: difference of grey levels that halves a weight, and the difference from the
# median above which a disparity is replaced.
SAME_OBJECT_LEVELS = 16.0
WRONG_PX = 1.0
WRONG_SIDE_PX = 2.0
# Flying pixels: radius of the window, the least step of disparity within it that makes it an edge,
# and the largest difference of pixels on the same surface.
WINDOW_PX, EDGE_PX, ALIKE_PX = 3, 2.0, 1.5


def drop_speckles(disparity_px: FloatImage, config: MatchConfig) -> None:
    """Set connected regions of fewer than ``speckle_size`` pixels to NaN, in place."""
    if config.speckle_size == 0:
        return
    # cv2.filterSpeckles takes int16: as many steps per px as let every disparity fit
    steps = min(16, 32000 // config.disparity_range)
    whole = np.empty(disparity_px.shape, np.int16)
    over_strips(quantise, len(whole), disparity_px, config.min_disparity - 1.0, steps, whole)
    cv2.filterSpeckles(whole, -1, config.speckle_size, config.speckle_range * steps)
    over_strips(drop_negative, len(whole), whole, disparity_px)


def drop_flying(disparity_px: FloatImage, sigma_px: FloatImage, config: MatchConfig) -> None:
    """Set pixels between the two surfaces of an edge to NaN, in place.

    Where a window sees two surfaces, its best match may lie between them. Such pixels have fewer
    than ``edge_support`` others of similar disparity around, on an edge of disparity.
    """
    if config.edge_support == 0:
        return
    near = window_range(disparity_px, 2 * WINDOW_PX + 1)
    limits = WINDOW_PX, EDGE_PX, ALIKE_PX, config.edge_support
    flying = np.empty(disparity_px.shape, np.bool_)
    over_strips(find_between_strip, len(flying), disparity_px, near, limits, flying)
    disparity_px[flying], sigma_px[flying] = np.nan, np.nan


def smooth(
    disparity_px: FloatImage, left: FloatImage, near_edges: ByteImage | None = None
) -> tuple[FloatImage, FloatImage]:
    """Replace each disparity by the value of a plane through its neighbours on the same surface.

    Parameters
    ----------
    disparity_px : (H, W) float32
        Disparity; NaN = none.
    left : (H, W) float32
        Left image, grey levels.
    near_edges : (H, W) uint8, optional
        1 where disparities may be on the wrong side of an edge. Given, only these are replaced by
        the weighted median, and only if they differ from it by more than `WRONG_SIDE_PX`.

    Returns
    -------
    smooth_px : (H, W) float32
        NaN where ``disparity_px`` is.
    sigma_px : (H, W) float32
        Its standard deviation, from the residuals of the planes; NaN = none.

    Notes
    -----
    Two medians come first. One removes single errors. The other weights pixels by the similarity
    of their grey levels, which moves the edges of objects, widened by the correlation window, to
    where the image has them (Z. Ma et al., "Constant time weighted median filtering for stereo
    matching and beyond", ICCV 2013). Planes and not means, because surfaces are rarely parallel to
    the image plane.

    """
    height, width = disparity_px.shape
    filled = cv2.medianBlur(fill_from_background(disparity_px), 5 if near_edges is None else 3)
    wrong = WRONG_PX if near_edges is None else WRONG_SIDE_PX
    where = np.empty((0, 0), np.uint8)
    if near_edges is not None:
        where = cv2.copyMakeBorder(near_edges, 0, 0, 0, LANES, cv2.BORDER_CONSTANT, value=0)
    # relative to the contrast of the image, so that the exposure does not matter
    softness = SAME_OBJECT_LEVELS / exposure_gain(left)
    values = _padded(filled, filled, MEDIAN_BORDER)
    guide = _padded(left, left, MEDIAN_BORDER)
    median = np.empty((height, width + LANES), np.float32)
    over_strips(weighted_median_strip, height, values, guide, where, softness, wrong, median)
    samples = _padded(median[:, :width], disparity_px, BORDER)
    plane = np.empty((height, width + LANES), np.float32)
    sigma = np.empty((height, width + LANES), np.float32)

    def fit(start: int, stop: int) -> None:
        plane_strip(samples, SAME_SURFACE_PX, plane, sigma, start, stop)
        rows = sigma[start:stop, :width]
        rows *= np.float32(RESIDUAL_FACTOR**2)
        rows += np.float32(COMMON_SIGMA_PX**2)
        np.sqrt(rows, out=rows)

    over_strips(fit, height)
    return plane[:, :width].copy(), sigma[:, :width].copy()


def _padded(values: FloatImage, mask: FloatImage, border: int) -> FloatImage:
    """Return values, NaN where ``mask`` is NaN, with a border of NaN and spare lanes."""
    height, width = values.shape
    padded = np.empty((height + 2 * border, width + 2 * border + LANES), np.float32)
    over_strips(pad_strip, height, values, mask, border, padded)
    return padded
