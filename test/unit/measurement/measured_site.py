# SPDX-License-Identifier: Apache-2.0
"""Exact frames of the simulated scene, with noise of known size, for measuring."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from binocular_recon.apps.output_folder import ResultFolder
from binocular_recon.calibration.model import StereoCalibration
from binocular_recon.calibration.rectification.metric_rectification import metric_rig
from binocular_recon.camera import FloatArray, RigCovariance, StereoRig
from binocular_recon.cloud_config import CloudConfig
from binocular_recon.evaluation.paper.sigmas import perfectly_matched_depths, true_points
from binocular_recon.evaluation.paper.site import Site
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.simulation.rig import RawRig, survey_rig
from binocular_recon.simulation.scene import build_scene
from binocular_recon.stereo.filtering.wls_filter import Filtered
from binocular_recon.stereo.matching import Match
from binocular_recon.stereo.pipeline import Reconstruction
from binocular_recon.stereo.rectification import Rectifier
from binocular_recon.stereo.search_range import RangeChoice, SearchRange
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity
from test.frame_results import add_frame

SCALE, NOISE_PX = 0.15, 0.05


# One standard deviation of each kind of parameter of an ordinary calibration, at full size.
SIGMAS = {'f': 1.0, 'c': 1.0, 'k': 5e-4, 'p': 1e-4, 't': 5e-5, 'T': 3e-4}


@lru_cache
def calibration() -> tuple[StereoRig, StereoCalibration]:
    """Return the rig of small images with a covariance whose parameters are correlated."""
    raw = survey_rig(SCALE)
    left, right = raw.left, raw.right
    nominal = StereoCalibration(
        left.size, left.K, left.D, right.K, right.D, raw.R, raw.T, left.distortion_model
    )
    names = nominal.parameters
    free = np.array([name[:2] not in {'k4', 'k5', 'k6'} for name in names])
    size = np.array([SCALE if name[0] in 'fc' else 1.0 for name in names])
    scale = free * size * np.array([SIGMAS[name[0]] for name in names])
    mixing = np.eye(len(names)) + 0.3 * np.random.default_rng(5).normal(size=(len(names),) * 2)
    root = scale[:, None] * mixing / np.linalg.norm(mixing, axis=1, keepdims=True)
    rig = metric_rig(nominal)
    known = RigCovariance(rig.left, rig.right, names, root @ root.T)
    return StereoRig(rig.left, rig.right, covariance=known), nominal


class MeasuredSite:
    """A site whose true rig differs from the calibration by what the covariance says.

    Attributes
    ----------
    frame : MeasuredFrame
    truth : (H, W, 3) float64
        What each pixel sees, true left rectified frame, m.
    clear : (H, W) bool
        Pixels away from outlines.
    picks : dict of str to (2,) float64
        Where the ends of things are seen, rectified px.

    """

    def __init__(self, seed: int, noise_px: float = NOISE_PX) -> None:
        calibrated, nominal = calibration()
        assert calibrated.covariance is not None
        rng = np.random.default_rng(seed)
        matrix = calibrated.covariance.matrix
        actual = nominal.moved(rng.multivariate_normal(np.zeros(len(matrix)), matrix))
        left, right = (
            replace(camera, K=actual.side(side)[0], D=actual.side(side)[1][:5])
            for side, camera in (('left', calibrated.left), ('right', calibrated.right))
        )
        self.scene = build_scene(rng)
        empty = np.empty((0, 0, 3), np.uint8)
        site = Site(seed, RawRig(left, right, actual.R, actual.T), self.scene, empty, empty, [])
        rig = Rectifier(calibrated).rig
        self.calibrated, self.rig = calibrated, rig
        self.truth, self.clear = true_points(site, calibrated)
        known = np.isfinite(self.truth).all(axis=-1)
        ideal = np.full(known.shape, np.nan)
        ideal[known] = perfectly_matched_depths(site, calibrated, self.truth[known])
        disparity = rig.focal_px * rig.baseline_m / ideal + rig.disparity_offset_px
        # neighbours share their errors, as those of one window do
        noise = rng.normal(0, noise_px, tuple(-(-n // 8) for n in known.shape))
        disparity += np.kron(noise, np.ones((8, 8)))[: known.shape[0], : known.shape[1]]
        validity = np.where(known, Validity.MEASURED, 0).astype(np.uint8)
        self.frame = MeasuredFrame(
            rig,
            disparity.astype(np.float32),
            np.full(known.shape, noise_px, np.float32),
            validity,
            rng.integers(0, 256, (*known.shape, 3), np.uint8),
            limits=CloudConfig(max_sigma='100%'),
        )
        self.clear &= known

    def random_pixels(
        self, rng: np.random.Generator, count: int, near_m: float = 8.0, far_m: float = 20.0
    ) -> tuple[FloatArray, FloatArray]:
        """Return pixels away from outlines (n, 2), px, and what they see (n, 3), m."""
        depth = self.truth[..., 2]
        inside = np.zeros(depth.shape, bool)
        inside[5:-5, 5:-5] = True
        rows, columns = np.nonzero(inside & self.clear & (depth > near_m) & (depth < far_m))
        chosen = rng.choice(len(rows), count, replace=False)
        pixels = np.stack([columns[chosen], rows[chosen]], axis=-1).astype(np.float64)
        return pixels, self.truth[rows[chosen], columns[chosen]]


def write_output(site: MeasuredSite, folder: Path, frames: int = 1) -> Path:
    """Write an output folder of `reconstruct` with some frames, all alike, and return it."""
    frame = site.frame
    found = Reconstruction(
        frame.left_bgr,
        frame.left_bgr,
        Match(frame.disparity_px, frame.sigma_px, frame.validity),
        Filtered(frame.disparity_px, frame.sigma_px, frame.validity, 1, 0.0),
        triangulate(frame.disparity_px, frame.sigma_px, frame.validity, site.rig, frame.limits),
        RangeChoice(SearchRange(0, 64)),
        thinning=frame.limits,
    )
    results = ResultFolder(folder, {'source': {'alpha': -1.0, 'rectified': False}})
    for number in range(frames):
        add_frame(results, number, site.calibrated, found)
    results.write_summary(finished=True)
    results.close()
    return folder


def write_rows(path: Path, rows: list[dict[str, object]]) -> Path:
    with path.open('w', newline='') as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path
