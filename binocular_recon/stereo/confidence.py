# SPDX-License-Identifier: Apache-2.0
"""Confidence of a match: the standard deviation of its disparity, mapped to [0, 1]."""

from __future__ import annotations

import numpy as np

from binocular_recon.images import FloatImage

# The standard deviation that has a confidence of one half.
SIGMA_UNIT_PX = 0.25


def confidence_from_sigma(sigma_px: FloatImage) -> FloatImage:
    """Return 1 / (1 + (sigma / SIGMA_UNIT_PX)^2), 0 where sigma is NaN or infinite."""
    ratio = np.asarray(sigma_px, np.float32) / np.float32(SIGMA_UNIT_PX)
    confidence: FloatImage = np.reciprocal(1 + ratio * ratio, dtype=np.float32)
    confidence[np.isnan(confidence)] = 0
    return confidence


def sigma_from_confidence(confidence: FloatImage) -> FloatImage:
    """Return the standard deviation of the disparity, px; infinite where confidence is 0."""
    level = np.asarray(confidence, np.float32)
    with np.errstate(divide='ignore', invalid='ignore'):
        variance = np.where(level > 0, 1 / level - 1, np.inf).astype(np.float32)
    sigma: FloatImage = np.float32(SIGMA_UNIT_PX) * np.sqrt(variance)
    return sigma
