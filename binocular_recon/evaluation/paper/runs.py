# SPDX-License-Identifier: Apache-2.0
"""The paper end to end on simulated sites: rods, calibration, scene, reconstruction, sizes.

Everything from the marks in the images to the sizes is what users run; only the images (and,
unless rods are rendered, the marks) are simulated. The truth is used to place the picks and to
compare.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.rectification.epipolar import free_pair
from binocular_recon.calibration.rectification.metric_rectification import (
    correction_of,
    metric_rig,
)
from binocular_recon.calibration.rectification.recalibration import corrected_marks
from binocular_recon.calibration.result import CalibrationResult, row_statistics
from binocular_recon.calibration.screening import observations
from binocular_recon.calibration.solve import calibrate
from binocular_recon.calibration.target.capture import Capture
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import StereoRig
from binocular_recon.config import ChainConfig
from binocular_recon.errors import BinocularReconError
from binocular_recon.evaluation.calibration.self_check import simulated_boards, simulated_captures
from binocular_recon.evaluation.paper.site import PICK_NOISE_PX, Pixels, Site, simulate_site
from binocular_recon.evaluation.paper.sizes import (
    errors_mm,
    heights,
    ideal_sizes,
    measured_sizes,
    rectified,
    sigmas_mm,
)
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.ruler import Ruler
from binocular_recon.simulation.capture import CaptureOptions, simulate_capture
from binocular_recon.simulation.rig import RawRig
from binocular_recon.simulation.rods import paper_board, with_placement
from binocular_recon.stereo.pipeline import Chain, Reconstruction

BOARDS = 22
MARK_NOISE_PX = 0.12
# The cloud is cropped to the first range; matching searches the second, so that walls behind and
# ground before are found where they are.
CROP_M, SEARCH_M = (9.0, 21.5), (8.0, 40.0)


@dataclass(frozen=True)
class PaperRun:
    """What one site yields with rods that stand as exactly as ``placement_m``.

    Attributes
    ----------
    seed : int
    placement_m : float
    rendered : bool
        Whether rods were detected in images; else marks were simulated with noise.
    boards_px : list of dict
        Table 2: mean reprojection error of each board, all methods.
    rows : list of list of float
        Table 1: of six marks of one rod the row in the left and right image as taken, after
        epipolar correction, and rectified with the adjusted calibration, px; NaN = not found.
    rows_px : dict of str to float
        Mean row difference of all marks on the held-out board: uncorrected, corrected, adjusted.
    errors_mm : dict of str to list of float
        Table 3: measured minus true size for each pick.
    sigmas_mm : dict of str to list of float
        One standard deviation of each, as it is stated.
    on_ground_mm, automatic_mm : dict of str to list of float
        The same with the sole put on the ground plane; of the automatic height (one value).
    floor_mm : dict of str to list of float
        The same picks with perfect calibration and depth.

    """

    seed: int
    placement_m: float
    rendered: bool
    boards_px: list[dict[str, float]]
    rows: list[list[float]]
    rows_px: dict[str, float]
    errors_mm: dict[str, list[float]]
    sigmas_mm: dict[str, list[float]]
    on_ground_mm: dict[str, list[float]]
    automatic_mm: dict[str, list[float]]
    floor_mm: dict[str, list[float]]


@dataclass(frozen=True)
class FailedRun:
    """A site that yielded nothing with rods placed like this, and why."""

    seed: int
    placement_m: float
    reason: str


@dataclass(frozen=True, eq=False)
class Survey:
    """A reconstructed site, to be drawn.

    Attributes
    ----------
    site : Site
    rig : StereoRig
        Rectified rig of the reconstruction.
    reconstruction : Reconstruction
    picks_px : dict of str to (2,) float64
        First picks in the rectified left image.

    """

    site: Site
    rig: StereoRig
    reconstruction: Reconstruction
    picks_px: Pixels


def run_site(
    site: Site, placement_m: float, *, boards: int = BOARDS, rendered: bool = False
) -> tuple[PaperRun, Survey]:
    """Calibrate with rods, reconstruct the site with that calibration, and measure.

    Parameters
    ----------
    site : Site
    placement_m : float
        One standard deviation of where rods stand; feet are twice as uneven.
    boards : int
        Boards to calibrate with; one more is held out.
    rendered : bool
        Render images of the boards and detect the rods, instead of simulating marks.

    Raises
    ------
    CalibrationError
        If the boards do not suffice.

    """
    board = with_placement(paper_board(), placement_m)
    see = detected_captures if rendered else simulated_marks
    captures = see(site.rig, board, boards + 1, site.seed)
    result = calibrate(captures[:-1], board, site.rig.left.size)
    chain = survey_chain(result.rig)
    reconstruction = chain(site.left, site.right)
    ruler = Ruler(MeasuredFrame.of(reconstruction, chain.rig), PICK_NOISE_PX)
    picks = [rectified(pick, result.rig.left) for pick in site.picks]
    sizes = [measured_sizes(ruler, pick) for pick in picks]
    rows, means = _table_1(result, captures[-1])
    run = PaperRun(
        seed=site.seed,
        placement_m=placement_m,
        rendered=rendered,
        boards_px=[
            {key: value for key, value in row.items() if key.endswith('_px')}
            for row in result.to_mapping()['boards']
        ],
        rows=rows,
        rows_px=means,
        errors_mm=errors_mm(site, sizes),
        sigmas_mm=sigmas_mm(sizes),
        on_ground_mm=errors_mm(site, [heights(ruler.height_above_ground, p) for p in picks]),
        automatic_mm=errors_mm(site, [heights(ruler.automatic_height_m, picks[0])]),
        floor_mm=errors_mm(site, [ideal_sizes(site, pick) for pick in site.picks]),
    )
    pixels = {name: pick.pixel for name, pick in picks[0].items()}
    return run, Survey(site, chain.rig, reconstruction, pixels)


def run_paper(
    rig: RawRig,
    seeds: Sequence[int],
    placements_m: Sequence[float],
    *,
    boards: int = BOARDS,
    rendered: int = 1,
) -> Iterator[tuple[PaperRun, Survey] | FailedRun]:
    """Run every seed at every placement; the first ``rendered`` seeds with rendered rods."""
    for index, seed in enumerate(seeds):
        site = simulate_site(seed, rig)
        for placement in placements_m:
            yield _attempt(site, placement, boards=boards, rendered=index < rendered)


def _attempt(
    site: Site, placement_m: float, *, boards: int, rendered: bool
) -> tuple[PaperRun, Survey] | FailedRun:
    try:
        return run_site(site, placement_m, boards=boards, rendered=rendered)
    except BinocularReconError as error:
        return FailedRun(site.seed, placement_m, str(error))


def survey_chain(rig: StereoRig) -> Chain:
    """Return the chain of the default preset for things at 10-20 m."""
    focal_baseline, offset = rig.focal_px * rig.baseline_m, rig.disparity_offset_px
    near, far = (focal_baseline / depth + offset for depth in SEARCH_M)
    config = ChainConfig.preset(
        'default',
        min_disparity=int(far),
        disparity_range=int(near) - int(far) + 1,
        min_depth=CROP_M[0],
        max_depth=CROP_M[1],
    )
    return Chain(rig, config)


def simulated_marks(rig: RawRig, board: RodBoard, count: int, seed: int) -> list[Capture]:
    """Return ``count`` boards' marks as both cameras see them, with noise."""
    placed = simulated_boards(rig, board.placement_sigma_m, count, seed, 0)
    return simulated_captures(rig, placed, MARK_NOISE_PX, (seed, 0))


def detected_captures(rig: RawRig, board: RodBoard, count: int, seed: int) -> list[Capture]:
    """Return the marks found in rendered images of ``count`` boards."""
    captures = []
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        pair = simulate_capture(board, rig, rng, CaptureOptions())
        left, right = (detect_rods(image, board).marks_px for image in (pair.left, pair.right))
        captures.append(Capture(f'{index + 1:02d}', left, right))
    return captures


def _table_1(
    result: CalibrationResult, held_out: Capture
) -> tuple[list[list[float]], dict[str, float]]:
    """Return the rows of the middle rod's marks, and the mean row difference of all marks."""
    seen = observations([held_out])
    planar, adjusted = result.planar.calibration, result.calibration
    stages = {
        'uncorrected': seen,
        'corrected': corrected_marks(seen, planar, free_pair(planar)),
        'adjusted': corrected_marks(seen, adjusted, correction_of(adjusted, metric_rig(adjusted))),
    }
    # from the top down, as the paper counts
    rod = [marks[0, marks.shape[1] // 2, ::-1] for marks in stages.values()]
    rows = np.concatenate([marks[:, [1, 3]] for marks in rod], -1)
    means = {
        name: row_statistics(marks[..., 1] - marks[..., 3])['mean']
        for name, marks in stages.items()
    }
    return rows.tolist(), means
