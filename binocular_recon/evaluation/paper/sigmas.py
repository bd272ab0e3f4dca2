# SPDX-License-Identifier: Apache-2.0
"""Whether the standard deviations of points and lengths hold, on simulated sites.

A rig is calibrated with rods that stand as exactly as stated, a site is reconstructed with that
calibration, and each measured point is compared with what its pixel of the raw left image sees.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from binocular_recon.calibration.solve import calibrate
from binocular_recon.camera import FloatArray, StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.evaluation.paper.runs import simulated_marks
from binocular_recon.evaluation.paper.site import Site, simulate_site
from binocular_recon.evaluation.tables import markdown_table
from binocular_recon.images import Mask
from binocular_recon.measurement.lengths import length_between
from binocular_recon.number_text import counted, fixed
from binocular_recon.simulation.rig import RawRig
from binocular_recon.simulation.rods import paper_board, with_placement
from binocular_recon.simulation.scene import trace_scene
from binocular_recon.stereo.filtering.wls_filter import sigma_if_right
from binocular_recon.stereo.pipeline import Chain, Reconstruction
from binocular_recon.stereo.point_covariance import joint_covariance
from binocular_recon.stereo.rectification import rectification_maps
from binocular_recon.stereo.validity import Validity

PLACEMENT_M, BOARDS = 0.005, 22
# Points whose depth differs by at most this share from one of the depths belong to it.
DEPTHS_M, DEPTH_SHARE = (5.0, 10.0, 15.0, 20.0), 0.1
# A match that is off by more is a wrong one, which no standard deviation describes.
WELL_MATCHED_PX = 1.0
LENGTHS, LENGTHS_M = 25, (0.5, 10.0)
# Neighbours within this many pixels belong to the same thing: away from its outline, the depth
# between pixels is known.
_SAME_THING_PX = 5
_LEAST_POINTS = 500


@dataclass(frozen=True)
class DepthSigmas:
    """Points near one depth: errors against their standard deviations.

    Attributes
    ----------
    depth_m : float
    points : int
    ratios : tuple of float
        Root mean square of error / sigma of x, y and z.
    sigma_mm, calibration_mm : float
        Median standard deviation of z, and the calibration's share of it.
    beyond : float
        Share of points whose z is off by more than 3 sigma.

    """

    depth_m: float
    points: int
    ratios: tuple[float, ...]
    sigma_mm: float
    calibration_mm: float
    beyond: float


@dataclass(frozen=True)
class SiteSigmas:
    """One site.

    Attributes
    ----------
    seed : int
    well_matched : float
        Share of the measured points that are compared.
    depths : tuple of DepthSigmas
        Those of `DEPTHS_M` near which there are points.
    length_errors_mm, length_sigmas_mm : tuple of float
        Random lengths between well matched points: measured - true, and the stated sigma.

    """

    seed: int
    well_matched: float
    depths: tuple[DepthSigmas, ...]
    length_errors_mm: tuple[float, ...]
    length_sigmas_mm: tuple[float, ...]


def run_sites(rig: RawRig, seeds: Sequence[int]) -> Iterator[SiteSigmas]:
    """Simulate, calibrate, reconstruct and compare one site after the other.

    Raises
    ------
    CalibrationError
        If the simulated boards do not suffice.

    """
    for seed in seeds:
        site = simulate_site(seed, rig)
        board = with_placement(paper_board(), PLACEMENT_M)
        marks = simulated_marks(rig, board, BOARDS, seed)
        calibrated = calibrate(marks, board, rig.left.size).rig
        # the sigma of every point is compared, large ones too
        chain = Chain(calibrated, ChainConfig.preset('default', max_sigma='100%'))
        yield compare(site, calibrated, chain.rig, chain(site.left, site.right))


def compare(
    site: Site, calibrated: StereoRig, rectified: StereoRig, found: Reconstruction
) -> SiteSigmas:
    """Compare the measured points of a site with the truth.

    Parameters
    ----------
    site : Site
    calibrated, rectified : StereoRig
        Of the raw and of the rectified images, with the covariance of the calibration.
    found : Reconstruction

    """
    truth, comparable = true_points(site, calibrated)
    measured = (found.filtered.validity & Validity.MEASURED) > 0
    used = comparable & measured & np.isfinite(found.cloud.points_xyz).all(axis=-1)
    points, truth = found.cloud.points_xyz[used].astype(np.float64), truth[used]
    sigmas = found.cloud.sigma_m[used]
    depth_m = points[:, 2]
    per_px = depth_m**2 / (rectified.focal_px * rectified.baseline_m)
    matching = per_px * found.filtered.sigma_px[used]
    # an error of the calibration is not one of matching
    ideal_m = perfectly_matched_depths(site, calibrated, truth)
    well = np.abs(depth_m - ideal_m) < WELL_MATCHED_PX * per_px
    errors = points - truth
    depths = []
    for depth in DEPTHS_M:
        near = well & (np.abs(depth_m - depth) < DEPTH_SHARE * depth)
        if np.count_nonzero(near) < _LEAST_POINTS:
            continue
        ratios = errors[near] / sigmas[near]
        shared = np.sqrt(np.maximum(sigmas[near][:, 2] ** 2 - matching[near] ** 2, 0))
        depths.append(
            DepthSigmas(
                depth,
                int(np.count_nonzero(near)),
                tuple(np.sqrt(np.mean(ratios**2, axis=0)).tolist()),
                1e3 * float(np.median(sigmas[near][:, 2])),
                1e3 * float(np.median(shared)),
                float(np.mean(np.abs(ratios[:, 2]) > 3)),
            )
        )
    near = well & (depth_m < (1 + DEPTH_SHARE) * DEPTHS_M[-1])
    lengths = random_lengths(
        points[near],
        truth[near],
        # well matched: none of them is a mismatch
        sigma_if_right(found.filtered.sigma_px[used][near].astype(np.float64)),
        rectified,
        np.random.default_rng(site.seed),
    )
    return SiteSigmas(site.seed, float(well.mean()), tuple(depths), *lengths)


def true_points(site: Site, calibrated: StereoRig) -> tuple[FloatArray, Mask]:
    """Return what each rectified pixel sees, (H, W, 3) m, and which are away from outlines.

    In the rectified frame of the calibration that was found: the left camera's own frame, turned
    by its R.
    """
    view = site.rig.views()[0]
    depth_m, labels = trace_scene(site.scene, view)
    window = np.ones((_SAME_THING_PX, _SAME_THING_PX))
    numbers = labels.astype(np.float32)
    inside = cv2.dilate(numbers, window) == cv2.erode(numbers, window)
    columns, rows = rectification_maps(calibrated.left)
    # of planes the inverse depth is linear in the image
    inverse = cv2.remap(
        (1 / depth_m).astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderValue=(np.nan,)
    )
    comparable: Mask = cv2.remap(inside.astype(np.uint8), columns, rows, cv2.INTER_NEAREST) > 0
    comparable &= np.isfinite(inverse)
    raw = np.stack([columns, rows], axis=-1).astype(np.float64)
    points = view.rays(raw) / inverse[..., None]
    return points @ calibrated.left.R.T, comparable


def perfectly_matched_depths(site: Site, calibrated: StereoRig, points: FloatArray) -> FloatArray:
    """Return the depths that the calibration gives for points without an error of matching.

    Parameters
    ----------
    points : (N, 3) float64
        True points in the rectified frame of the calibration, m.

    Returns
    -------
    (N,) float64
        m.

    """
    local = points @ calibrated.left.R
    directions = []
    for view, camera in zip(site.rig.views(), (calibrated.left, calibrated.right), strict=True):
        plane = camera.lens.rays(view.project(local), camera.K, camera.D)
        rays = np.concatenate([plane, np.ones_like(plane[:, :1])], axis=-1) @ camera.R.T
        directions.append(rays[:, 0] / rays[:, 2])
    depths: FloatArray = calibrated.baseline_m / (directions[0] - directions[1])
    return depths


def random_lengths(
    points: FloatArray,
    truth: FloatArray,
    sigma_px: FloatArray,
    rectified: StereoRig,
    rng: np.random.Generator,
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return errors and standard deviations of random lengths between points, mm."""
    errors: list[float] = []
    sigmas: list[float] = []
    shortest, longest = LENGTHS_M
    while len(errors) < LENGTHS:
        ends = rng.choice(len(points), 2, replace=False)
        true = float(np.linalg.norm(truth[ends[1]] - truth[ends[0]]))
        if not shortest <= true <= longest:
            continue
        covariance = joint_covariance(points[ends], rectified, sigma_px[ends])
        length = length_between(points[ends], covariance)
        errors.append(1e3 * (length.length_m - true))
        sigmas.append(1e3 * length.sigma_m)
    return tuple(errors), tuple(sigmas)


def report(sites: Sequence[SiteSigmas]) -> str:
    """Return the table of error / sigma over all sites, and what it holds."""
    header = ('', 'sites', 'RMS of error / sigma: x', 'y', 'z', 'sigma of z mm', '> 3 sigma %')
    rows = []
    for depth in DEPTHS_M:
        found = [near for site in sites for near in site.depths if near.depth_m == depth]
        if found:
            ratios = np.sqrt(np.mean([np.square(near.ratios) for near in found], axis=0))
            rows.append(
                (
                    f'points at {depth:g} m',
                    str(len(found)),
                    *(fixed(ratio, 2) for ratio in ratios),
                    fixed(float(np.mean([near.sigma_mm for near in found])), 0),
                    fixed(100 * float(np.mean([near.beyond for near in found])), 2),
                )
            )
    ratio, beyond, sigma_mm = length_figures(sites)
    lengths = str(sum(len(site.length_errors_mm) for site in sites))
    rows.append(
        (f'{lengths} lengths', str(len(sites)), '', '', fixed(ratio, 2), fixed(sigma_mm, 0),
         fixed(100 * beyond, 2))
    )  # fmt: skip
    shares = [site.well_matched for site in sites]
    return (
        f'{counted(len(sites), "simulated site")}, {BOARDS} boards with rods placed to'
        f' {1e3 * PLACEMENT_M:g} mm: points matched to {WELL_MATCHED_PX:g} px'
        f' ({np.mean(shares):.0%} of those away from outlines), and'
        f' lengths of {LENGTHS_M[0]:g} to {LENGTHS_M[1]:g} m between them.\n\n'
        + markdown_table(header, rows)
    )


def length_figures(sites: Sequence[SiteSigmas]) -> tuple[float, float, float]:
    """Return RMS(error / sigma), the share beyond 3 sigma and the median sigma (mm) of lengths."""
    errors = np.concatenate([site.length_errors_mm for site in sites])
    sigmas = np.concatenate([site.length_sigmas_mm for site in sites])
    ratios = errors / sigmas
    return (
        float(np.sqrt(np.mean(ratios**2))),
        float(np.mean(np.abs(ratios) > 3)),
        float(np.median(sigmas)),
    )
