# SPDX-License-Identifier: Apache-2.0
"""The normal equations of the filter: data, weights and links (eq. 12 and 13)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from binocular_recon._jit import over_strips
from binocular_recon.config import FilterConfig
from binocular_recon.images import FloatImage, Mask
from binocular_recon.stereo.filtering import _filter_kernels as kernels
from binocular_recon.stereo.holes.completion import complete, fill_from_nearest


class Equations(NamedTuple):
    """The normal equations (C + lambda L_g) f = C b of eq. 13.

    Attributes
    ----------
    data : (H, W) float32
        b, without holes.
    weight : (H, W) float32
        c, the diagonal of C.
    link_east : (H, W - 1) float32
        lambda a_x, between a pixel and its eastern neighbour.
    link_south : (H - 1, W) float32
        lambda a_y, between a pixel and its southern neighbour (the next row; y points down).

    """

    data: FloatImage
    weight: FloatImage
    link_east: FloatImage
    link_south: FloatImage


def normal_equations(
    measured_px: FloatImage,
    confidence: FloatImage,
    guide: FloatImage,
    config: FilterConfig,
    unexplained: Mask | None = None,
) -> Equations:
    """Return the equations that the filter solves.

    Parameters
    ----------
    measured_px : (H, W) float32
        Raw disparity; NaN = none.
    confidence, guide : (H, W) float32
        As for `filter_disparity`.
    config : FilterConfig
        Options of the filter.
    unexplained : (H, W) bool, optional
        `unexplained_holes` of the disparity, if it is known.

    """
    data, weight = _data_term(measured_px, confidence, guide, config, unexplained)
    return Equations(data, weight, *_links(data, guide, config))


def _data_term(
    measured: FloatImage,
    confidence: FloatImage,
    guide: FloatImage,
    config: FilterConfig,
    unexplained: Mask | None,
) -> tuple[FloatImage, FloatImage]:
    """Return b without holes and c of eq. 13."""
    if not config.wls_use_confidence:
        return fill_from_nearest(measured), np.ones_like(measured)
    confidence = np.asarray(confidence, np.float32)
    data, weight = complete(
        measured,
        confidence,
        guide,
        extrapolate=config.wls_extrapolate,
        unexplained=unexplained,
    )
    return data, weight if config.wls_complete else np.where(np.isnan(measured), 0, weight)


def _luminance(data: FloatImage, guide: FloatImage, config: FilterConfig) -> FloatImage:
    """Return the luminance Y of the guide in [0, 1]; NaN where it has no data."""
    if config.wls_guide == 'left':
        return np.asarray(guide, np.float32) / np.float32(255)
    low, high = data.min(), data.max()
    unit_range: FloatImage = (data - low) / max(high - low, np.finfo(np.float32).tiny)
    return unit_range


def _links(
    data: FloatImage, guide: FloatImage, config: FilterConfig
) -> tuple[FloatImage, FloatImage]:
    """Return lambda a_x (H, W - 1) and lambda a_y (H - 1, W) of eq. 12."""
    luminance = _luminance(data, guide, config)
    height, width = data.shape
    east = np.empty((height, width - 1), np.float32)
    south = np.empty((height - 1, width), np.float32)
    alpha = config.wls_alpha
    # with exponent 0 every gradient term is 1
    flat = 1.001 * float(kernels.LEAST_DIFFERENCE) ** alpha if alpha else 0.0
    options = config.wls_lambda, config.wls_disparity_steps, config.wls_epsilon, flat

    def fill(start: int, stop: int) -> None:
        log = np.log(np.maximum(luminance[start : stop + 1], 0) + np.float32(1 / 255))
        # where the guide has no data there is no edge
        kernels.absolute_differences(log, east, south, start, stop)
        for gradient in (east[start:stop], south[start:stop]):
            if gradient.size:  # OpenCV refuses an empty array
                cv2.pow(gradient, alpha, gradient)
        kernels.gradients_to_links(data, east, south, options, start, stop)

    over_strips(fill, height)
    return east, south
