# SPDX-License-Identifier: Apache-2.0
"""What test_matching and test_matching_robustness share."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binocular_recon.config import ChainConfig, MatchConfig
from binocular_recon.images import FloatImage
from binocular_recon.options import OptionValue


def config(**options: OptionValue) -> MatchConfig:
    """Return whole-range defaults for small images."""
    return ChainConfig.preset('default', **{'disparity_range': 16, **options}).match


def texture(height: int, width: int, seed: int = 0, blur: float = 1.0) -> FloatImage:
    """Return a random image in whole grey levels, at least 16 within 0..255."""
    noise = np.random.default_rng(seed).normal(size=(height, width))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur)
    levels: FloatImage = np.rint(128 + 40 * smooth / smooth.std()).clip(0, 255).astype(np.float32)
    return levels


def shifted_pair(
    height: int, width: int, disparity: float, seed: int = 0
) -> tuple[FloatImage, FloatImage]:
    """Return a pair of constant disparity; whole ones exact, others by a Fourier shift."""
    whole = texture(height, width + 128, seed, blur=1.5)
    frequency = np.fft.fftfreq(whole.shape[1])
    spectrum = np.fft.fft(whole, axis=1) * np.exp(2j * np.pi * frequency * disparity)
    moved = np.fft.ifft(spectrum, axis=1).real.astype(np.float32)
    return whole[:, 64:-64].copy(), moved[:, 64:-64].copy()


both_ways = pytest.mark.parametrize('semi_global', [False, True])
