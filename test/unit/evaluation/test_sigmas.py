# SPDX-License-Identifier: Apache-2.0
"""Points and lengths of simulated sites against their stated sigma."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.solve import calibrate
from binocular_recon.camera import StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.evaluation.paper.runs import simulated_marks
from binocular_recon.evaluation.paper.sigmas import (
    BOARDS,
    LENGTHS,
    PLACEMENT_M,
    SiteSigmas,
    compare,
    length_figures,
    perfectly_matched_depths,
    report,
    true_points,
)
from binocular_recon.evaluation.paper.site import Site
from binocular_recon.simulation.rig import RawRig, survey_rig
from binocular_recon.simulation.rods import paper_board, with_placement
from binocular_recon.simulation.scene import build_scene
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

pytestmark = pytest.mark.long

NOISE_PX = 0.2
SCALE = 0.15


@lru_cache
def calibration() -> tuple[StereoCalibration, StereoRig]:
    """Return a calibration of small images, and its rig, known as well as of large ones."""
    raw = survey_rig(SCALE)
    board = with_placement(paper_board(), PLACEMENT_M)
    result = calibrate(simulated_marks(raw, board, BOARDS, 3), board, raw.left.size)
    known = result.rig.covariance
    assert known is not None
    # marks scatter by as many px in images of any size
    known = replace(known, matrix=SCALE**2 * known.matrix)
    return result.calibration, replace(result.rig, covariance=known)


def matched_site(seed: int, noise_px: float = NOISE_PX) -> SiteSigmas:
    """Compare a site whose disparities are those of the true rig, with noise of known size.

    The true rig differs from the calibration by as much as its covariance says.
    """
    nominal, calibrated = calibration()
    assert calibrated.covariance is not None
    rng = np.random.default_rng(seed)
    matrix = calibrated.covariance.matrix
    actual = nominal.moved(rng.multivariate_normal(np.zeros(len(matrix)), matrix))
    left, right = (
        replace(camera, K=actual.side(side)[0], D=actual.side(side)[1][:5])
        for side, camera in (('left', calibrated.left), ('right', calibrated.right))
    )
    rig = RawRig(left, right, actual.R, actual.T)
    empty = np.empty((0, 0, 3), np.uint8)
    site = Site(seed, rig, build_scene(rng), empty, empty, [])
    rectified = Rectifier(calibrated).rig
    truth, _ = true_points(site, calibrated)
    known = np.isfinite(truth).all(axis=-1)
    ideal = np.full(known.shape, np.nan)
    ideal[known] = perfectly_matched_depths(site, calibrated, truth[known])
    disparity = rectified.focal_px * rectified.baseline_m / ideal + rectified.disparity_offset_px
    disparity += rng.normal(0, noise_px, known.shape)
    sigma = np.full(known.shape, NOISE_PX, np.float32)
    validity = np.where(known, Validity.MEASURED, 0).astype(np.uint8)
    cloud = triangulate(
        disparity.astype(np.float32), sigma, validity, rectified, CloudConfig(max_sigma='100%')
    )
    found: Any = SimpleNamespace(
        cloud=cloud, filtered=SimpleNamespace(validity=validity, sigma_px=sigma)
    )
    return compare(site, calibrated, rectified, found)


def test_points_and_lengths_are_off_by_as_much_as_stated() -> None:
    """The errors are those of eight calibrations, and of matching as stated."""
    sites = [matched_site(seed) for seed in range(8)]
    for depth_m in (5.0, 10.0, 15.0, 20.0):
        near = [one for site in sites for one in site.depths if one.depth_m == depth_m]
        assert len(near) > 5
        ratios = np.sqrt(np.mean([np.square(one.ratios) for one in near], axis=0))
        # the errors of one calibration are common to a site: 8 draws of a few parameters
        assert ((ratios > 0.5) & (ratios < 1.6)).all(), (depth_m, ratios)
        assert np.mean([one.beyond for one in near]) < 0.03
    ratio, beyond, sigma_mm = length_figures(sites)
    assert 0.6 < ratio < 1.5 and beyond < 0.02 and 10 < sigma_mm < 150
    assert all(len(site.length_errors_mm) == LENGTHS for site in sites)
    text = report(sites)
    assert '8 simulated sites' in text and '200 lengths' in text


def test_matching_worse_than_stated_is_seen() -> None:
    as_stated, worse = (matched_site(1, factor * NOISE_PX).depths[-1] for factor in (1, 4))
    assert as_stated.depth_m == worse.depth_m == 20.0
    assert worse.ratios[2] > 1.4 * as_stated.ratios[2]
    assert worse.beyond > as_stated.beyond + 0.02
