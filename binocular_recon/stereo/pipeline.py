# SPDX-License-Identifier: Apache-2.0
"""The chain on one page: rectify, match, filter, triangulate."""

from __future__ import annotations

from dataclasses import dataclass

from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.images import Image, to_grey
from binocular_recon.stereo.filtering.wls_filter import DisparityFilter, Filtered
from binocular_recon.stereo.matching.matcher import Match, match
from binocular_recon.stereo.rectification import Rectifier, check_size
from binocular_recon.stereo.triangulation import Cloud, triangulate


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What the chain makes of one picture pair.

    Attributes
    ----------
    left, right : (H, W) or (H, W, C)
        Rectified pictures, dtype of the input.
    matched : Match
        Disparity and confidence of each pixel that could be matched.
    filtered : Filtered
        Dense disparity with its standard deviation.
    cloud : Cloud
        Metric points in the left rectified frame.

    """

    left: Image
    right: Image
    matched: Match
    filtered: Filtered
    cloud: Cloud


class Chain:
    """Reconstruct picture pairs of one rig, in the order of their stamps if ``wls_video`` is on.

    Parameters
    ----------
    rig : StereoRig
        Calibration of the incoming pictures.
    config : ChainConfig
        Options of every stage.
    rectify : bool
        False if the pictures are rectified already.
    alpha : float
        Passed to `Rectifier`.

    Attributes
    ----------
    rig : StereoRig
        Rectified rig: the frame of the results.

    """

    def __init__(
        self, rig: StereoRig, config: ChainConfig, *, rectify: bool = True, alpha: float = -1.0
    ) -> None:
        self.config = config
        self._filter = DisparityFilter(config.filter)
        self._rectifier = Rectifier(rig, alpha) if rectify else None
        self.rig = self._rectifier.rig if self._rectifier else rig

    def __call__(self, left: Image, right: Image) -> Reconstruction:
        """Reconstruct one pair.

        Parameters
        ----------
        left, right : (H, W) or (H, W, C), uint8, uint16 or float32
            Pictures of the calibrated size; colour as BGR.

        Raises
        ------
        ImageError
            If the sizes or dtypes do not fit.

        """
        left, right = self._rectify(left, right)
        matched, filtered = estimate_disparity(left, right, self.config, self._filter)
        cloud = triangulate(  # eq. 16-18
            filtered.disparity_px, filtered.sigma_px, self.rig, self.config.cloud
        )
        return Reconstruction(left, right, matched, filtered, cloud)

    def _rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        if self._rectifier:
            return self._rectifier(left, right)
        check_size(left, self.rig.left.size, 'left')
        check_size(right, self.rig.right.size, 'right')
        return left, right


def estimate_disparity(
    left: Image, right: Image, config: ChainConfig, wls: DisparityFilter | None = None
) -> tuple[Match, Filtered]:
    """Match a rectified pair and complete its disparity.

    Parameters
    ----------
    left, right : (H, W) or (H, W, C), uint8, uint16 or float32
        Rectified pictures of equal size; colour as BGR.
    config : ChainConfig
        Options of matching and filter.
    wls : DisparityFilter, optional
        The filter, if frame follows frame; its options win.

    Returns
    -------
    matched : Match
        Disparity and confidence of each pixel that could be matched.
    filtered : Filtered
        Dense disparity with its standard deviation.

    Raises
    ------
    ImageError
        If the sizes or dtypes do not fit.

    """
    left_grey, right_grey = to_grey(left), to_grey(right)
    matched = match(left_grey, right_grey, config.match)  # eq. 10
    wls = wls or DisparityFilter(config.filter)
    filtered = wls(  # eq. 11-15
        matched.disparity_px, matched.confidence, left_grey, limits_px=config.match.limits_px
    )
    return matched, filtered
