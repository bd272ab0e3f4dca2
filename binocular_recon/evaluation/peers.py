# SPDX-License-Identifier: Apache-2.0
"""OpenCV's matchers, each at its best: the peers that the chain is measured against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from binocular_recon.images import FloatImage, Image, to_bgr8, to_grey

# The DisparityWLSFilter's usual setting, that of OpenCV's own sample, and a weaker smoothing
# that turned out better.
WLS_LAMBDA = 8000.0
WLS_LAMBDA_WEAK = 800.0
WLS_SIGMA_COLOR = 1.5

_SUBPIXEL = 16.0


@dataclass(frozen=True)
class OpenCvMatcher:
    """One of OpenCV's matchers, alone or followed by ximgproc's DisparityWLSFilter.

    Attributes
    ----------
    algorithm : str
        ``bm``, ``sgbm`` (5 paths), ``sgbm_3way`` or ``sgbm_hh`` (8 paths).
    wls_lambda : float
        Smoothness of the WLS filter; 0 = no filter.

    Notes
    -----
    StereoBM takes 15 x 15 windows; StereoSGBM 5 x 5, P1 = 8 * 25, P2 = 32 * 25, a uniqueness of
    10 %, a left-right tolerance of 1 px and removes speckles of up to 100 px. Before the WLS
    filter OpenCV itself turns the checks off: the filter checks left against right.

    """

    algorithm: str
    wls_lambda: float = 0.0

    @property
    def name(self) -> str:
        """Name in tables."""
        names = {
            'bm': 'StereoBM 15',
            'sgbm': 'StereoSGBM 5',
            'sgbm_3way': 'StereoSGBM 5 (3WAY)',
            'sgbm_hh': 'StereoSGBM 5 (HH)',
        }
        if not self.wls_lambda:
            return names[self.algorithm]
        return f'{names[self.algorithm]} + WLS' + (
            '' if self.wls_lambda == WLS_LAMBDA else f' {self.wls_lambda:g}'
        )

    def matcher(self, disparity_range: int) -> Any:
        """Return the cv2 matcher for ``disparity_range`` disparities from 0."""
        if self.algorithm == 'bm':
            return cv2.StereoBM.create(disparity_range, 15)
        modes = {
            'sgbm': cv2.StereoSGBM_MODE_SGBM,
            'sgbm_3way': cv2.StereoSGBM_MODE_SGBM_3WAY,
            'sgbm_hh': cv2.StereoSGBM_MODE_HH,
        }
        return cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=disparity_range,
            blockSize=5,
            P1=8 * 5 * 5,
            P2=32 * 5 * 5,
            disp12MaxDiff=1,
            preFilterCap=63,
            uniquenessRatio=10,
            speckleWindowSize=100,
            speckleRange=2,
            mode=modes[self.algorithm],
        )

    def prepare(self, disparity_range: int) -> Callable[[Image, Image, Image], Image]:
        """Make the matcher and its filter, which keep their memory from call to call.

        Parameters
        ----------
        disparity_range : int
            Number of disparities, a multiple of 16.

        Returns
        -------
        function
            Takes the left and the right image, (H, W) uint8 grey, and the left one as the
            filter's guide, (H, W, 3) uint8; returns the disparity in 1/16 px, (H, W) int16,
            negative = none.

        """
        matcher = self.matcher(disparity_range)
        if not self.wls_lambda:
            return lambda left, right, _guide: matcher.compute(left, right)
        # in this order: making the filter turns off the matcher's own checks
        wls = wls_filter(matcher, self.wls_lambda)
        right_matcher = cv2.ximgproc.createRightMatcher(matcher)

        def compute(left: Image, right: Image, guide: Image) -> Image:
            disparity = matcher.compute(left, right)
            mirrored = right_matcher.compute(right, left)
            return wls.filter(disparity, guide, disparity_map_right=mirrored)  # type: ignore[no-any-return]

        return compute


def has_ximgproc() -> bool:
    """Tell whether this OpenCV has the contrib module with the WLS filter."""
    return hasattr(cv2, 'ximgproc')


def opencv_matchers() -> list[OpenCvMatcher]:
    """Return the matchers that this OpenCV has."""
    matchers = []
    for algorithm in ('bm', 'sgbm_3way', 'sgbm_hh'):
        matchers.append(OpenCvMatcher(algorithm))
        if has_ximgproc():
            matchers.append(OpenCvMatcher(algorithm, WLS_LAMBDA))
            if algorithm == 'sgbm_3way':
                matchers.append(OpenCvMatcher(algorithm, WLS_LAMBDA_WEAK))
    return matchers


def wls_filter(matcher: Any, wls_lambda: float = WLS_LAMBDA) -> Any:
    """Return ximgproc's DisparityWLSFilter for ``matcher``."""
    wls = cv2.ximgproc.createDisparityWLSFilter(matcher)
    wls.setLambda(wls_lambda)
    wls.setSigmaColor(WLS_SIGMA_COLOR)
    return wls


def to_bytes(image: Image) -> Image:
    """Return an image as OpenCV's matchers need it: (H, W) grey, uint8."""
    if image.dtype == np.uint8:  # without the detour of `to_grey`: its time would be the peer's
        return cv2.cvtColor(to_bgr8(image), cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    grey = np.nan_to_num(to_grey(image))
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def to_guide(image: Image) -> Image:
    """Return an image as the WLS filter works best with it: (H, W, 3) uint8, grey or colour.

    Of a grey image it makes three equal channels, as ``cv2.imread`` does: differences then count
    more, and the filter is much better (bad-2.0 8.5 instead of 11.4 % over eight scenes).
    """
    return to_bgr8(image)


def padded(image: Image, columns: int) -> Image:
    """Return the image with its first column repeated ``columns`` times to the left.

    OpenCV's matchers leave the first columns of the left image empty; so padded they can fill
    them.
    """
    return cv2.copyMakeBorder(  # type: ignore[no-any-return]
        image, 0, 0, columns, 0, cv2.BORDER_REPLICATE
    )


def from_fixed_point(disparity: Image, padding: int) -> FloatImage:
    """Return (H, W) float32 disparities, px, NaN = none, of OpenCV's 1/16 px with padding."""
    values = disparity[:, padding:].astype(np.float32) / _SUBPIXEL
    return np.where(values >= 0, values, np.nan).astype(np.float32)
