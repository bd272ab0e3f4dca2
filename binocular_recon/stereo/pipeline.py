# SPDX-License-Identifier: Apache-2.0
"""The chain on one page: rectify, match, filter, triangulate."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from binocular_recon.camera import Camera, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import ImageError
from binocular_recon.images import FloatImage, Image, mark_empty, to_bgr8, to_grey
from binocular_recon.inputs.image_faults import same_image
from binocular_recon.inputs.levels import EIGHT_BIT, Levels, LevelTracker
from binocular_recon.stereo.diagnosis import NOTHING, Findings, PairCheck
from binocular_recon.stereo.filtering.wls_filter import DisparityFilter, Filtered
from binocular_recon.stereo.matching import Match, match
from binocular_recon.stereo.orientation import turn, turn_back, turned_colours
from binocular_recon.stereo.rectification import Rectifier, check_size
from binocular_recon.stereo.search_range import RangeChoice, SearchRange, choose_range
from binocular_recon.stereo.thinning import PointSet, thin
from binocular_recon.stereo.triangulation import Cloud, triangulate

# A given search range is checked on the first frame and then on every tenth.
CHECK_EVERY = 10


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Results of the chain for one image pair.

    Attributes
    ----------
    left, right : (H, W) or (H, W, C)
        Rectified images, dtype of the input.
    matched : Match
        Disparity and confidence of each pixel that could be matched.
    filtered : Filtered
        Dense disparity with its standard deviation and validity.
    cloud : Cloud
        Metric points in the left rectified frame.
    range : RangeChoice
        The disparities that were searched, and the warning if a given range is too small.
    levels : Levels
        Black and white of the left image.
    findings : Findings
        What is wrong with the pair, or with the last one of the stream that was examined.
    thinning : CloudConfig
        Which points files and messages hold.

    """

    left: Image
    right: Image
    matched: Match
    filtered: Filtered
    cloud: Cloud
    range: RangeChoice
    levels: Levels = EIGHT_BIT
    findings: Findings = NOTHING
    thinning: CloudConfig = field(default_factory=CloudConfig)

    @cached_property
    def points(self) -> PointSet:
        """The points of files, with their colour: by the options decimation and voxel_size."""
        colour = to_bgr8(self.left, self.levels)
        return thin(PointSet(self.cloud, self.filtered.validity, colour), self.thinning)


class Chain:
    """Reconstruct image pairs of one rig; with ``wls_video`` call it in the order of the stamps.

    Parameters
    ----------
    rig : StereoRig
        Calibration of the input images.
    config : ChainConfig
        Options of every stage.
    rectify : bool
        False if the images are rectified already.
    alpha : float
        Passed to `Rectifier`.

    Attributes
    ----------
    rig : StereoRig
        Rectified rig; results are in the frame of its left camera.

    """

    def __init__(
        self, rig: StereoRig, config: ChainConfig, *, rectify: bool = True, alpha: float = -1.0
    ) -> None:
        self.config = config
        self._filter = DisparityFilter(config.filter)
        self._levels = LevelTracker(config.images)
        self._check = PairCheck()
        self._numbers, self._frames = itertools.count(), 0
        self._rectifier = Rectifier(rig, alpha) if rectify else None
        self.rig = self._rectifier.rig if self._rectifier else rig

    def __call__(self, left: Image, right: Image) -> Reconstruction:
        """Reconstruct one image pair.

        Parameters
        ----------
        left, right : (H, W) or (H, W, C), uint8, uint16 or float32
            Images of the calibrated size; colour as BGR.

        Raises
        ------
        ImageError
            If the sizes or dtypes do not fit.

        """
        same = same_image(left, right)
        left, right = self._rectify(left, right)
        number = next(self._numbers)
        self._frames = number + 1
        found = estimate_disparity(
            left,
            right,
            self.config,
            self._filter,
            infinity_px=self.rig.disparity_offset_px,
            turns=self.rig.turns,
            check_range=number % CHECK_EVERY == 0,
            levels=self._levels,
            check=self._check,
        )
        cloud = triangulate(  # eq. 16-18
            found.filtered.disparity_px,
            found.filtered.sigma_px,
            found.filtered.validity,
            self.rig,
            self.config.cloud,
        )
        return Reconstruction(
            left,
            right,
            found.matched,
            found.filtered,
            cloud,
            found.range,
            found.levels,
            found.findings.preceded(same),
            self.config.cloud,
        )

    def state(self) -> dict[str, Any]:
        """Return what later frames depend on, besides the last disparities, as a value for JSON.

        A chain with the same rig and options that `restore` it goes on as this one, to the bit.
        """
        return {
            'frames': self._frames,
            'levels': self._levels.state(),
            'check': self._check.state(),
            'starts_from_last': self._filter.last is not None,
        }

    def restore(self, state: dict[str, Any], last_px: FloatImage | None = None) -> None:
        """Go on from a `state`.

        Parameters
        ----------
        state : dict
            As `state` returned it.
        last_px : (H, W) float32, optional
            Filtered disparity of the last reconstructed frame; needed with ``wls_video``.

        """
        self._numbers, self._frames = itertools.count(state['frames']), state['frames']
        self._levels.restore(state['levels'])
        self._check.restore(state['check'])
        if state['starts_from_last'] and last_px is not None:
            self._filter.last = turn(last_px, self.rig.turns)

    def search(self, disparities: SearchRange) -> None:
        """Search these disparities from now on, instead of those in the options."""
        self.config = replace(self.config, match=disparities.applied_to(self.config.match))

    def _rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        if self._rectifier:
            return self._rectifier(left, right)
        check_size(left, self.rig.left.size, 'left')
        check_size(right, self.rig.right.size, 'right')
        return left, right


def warm_up(config: ChainConfig) -> None:
    """Compile, or load, every kernel that a chain with these options calls.

    The first call after an installation takes up to half a minute, later ones a second.
    """
    grain = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
    texture = cv2.GaussianBlur(grain, (0, 0), 1.5)
    P = np.array([[100.0, 0, 48, 0], [0, 100, 32, 0], [0, 0, 1, 0]])
    right = P + np.array([[0, 0, 0, -50.0], [0, 0, 0, 0], [0, 0, 0, 0]])
    rig = StereoRig(*(Camera(96, 64, P[:, :3], np.zeros(5), np.eye(3), p) for p in (P, right)))
    config = replace(config, match=SearchRange(-4, 16).applied_to(config.match))
    for image in (texture[..., 0], texture):
        Chain(rig, config, rectify=False)(image, image)  # of disparity 0


@dataclass(frozen=True, eq=False)
class DisparityEstimate:
    """Results of matching and filtering for a rectified pair.

    Attributes
    ----------
    matched : Match
        Disparity and confidence of each pixel that could be matched.
    filtered : Filtered
        Dense disparity with its standard deviation and validity.
    range : RangeChoice
        The disparities that were searched, and the warning if a given range is too small.
    levels : Levels
        Black and white of the left image.
    findings : Findings
        What is wrong with the pair, or with the last one of the stream that was examined.

    """

    matched: Match
    filtered: Filtered
    range: RangeChoice
    levels: Levels = EIGHT_BIT
    findings: Findings = NOTHING


def estimate_disparity(
    left: Image,
    right: Image,
    config: ChainConfig,
    wls: DisparityFilter | None = None,
    *,
    infinity_px: float | None = None,
    turns: int = 0,
    check_range: bool = True,
    levels: LevelTracker | None = None,
    check: PairCheck | None = None,
) -> DisparityEstimate:
    """Match a rectified pair, and filter its disparities into a dense map.

    Parameters
    ----------
    left, right : (H, W) or (H, W, C), uint8, uint16 or float32
        Rectified images of equal size; colour as BGR.
    config : ChainConfig
        Options of matching and of the filter.
    wls : DisparityFilter, optional
        The filter of a stream; its own options apply, not those in ``config``.
    infinity_px : float, optional
        Disparity of a point at infinity, if the rig is known.
    turns : int
        `StereoRig.turns`: the pair is matched turned, results are those of the images as given.
    check_range : bool
        Whether to check a given search range and, without ``check``, to examine the pair.
    levels : LevelTracker, optional
        Black and white of a stream; its own options apply, not those in ``config``.
    check : PairCheck, optional
        What is wrong with the pairs of a stream, in place of this pair alone.

    Raises
    ------
    ImageError
        If the sizes or dtypes do not fit, or no pixel can be matched.

    """
    found = (levels or LevelTracker(config.images)).update(left, right)
    left_grey = turn(to_grey(left, found[0]), turns)
    right_grey = turn(to_grey(right, found[1]), turns)
    mark_empty(left_grey)
    mark_empty(right_grey)
    chosen = choose_range(left_grey, right_grey, config.match, infinity_px, check=check_range)
    searched = chosen.search.applied_to(config.match)
    colours = turned_colours((left, right), found, turns)
    matched = match(left_grey, right_grey, searched, colours)  # eq. 10
    examined = check or (PairCheck() if check_range else None)
    findings = NOTHING
    if examined:
        findings = examined.update(left_grey, right_grey, matched, config.match, infinity_px)
    if findings.cause and not matched.matched_share:
        raise ImageError(f'no pixel could be matched; {findings.cause}')
    filtered = (wls or DisparityFilter(config.filter))(  # eq. 11-15
        matched.disparity_px,
        matched.confidence,
        left_grey,
        limits_px=searched.limits_px,
        reasons=matched.validity,
    )
    matched, filtered = turn_back(matched, turns), turn_back(filtered, turns)
    return DisparityEstimate(matched, filtered, chosen, found[0], findings)
