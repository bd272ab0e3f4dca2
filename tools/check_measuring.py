# SPDX-License-Identifier: Apache-2.0
"""Errors of measurements over their stated sigma, on simulated sites.

check_measuring.py [SITES [FIRST_SEED]]

On each site a rig is calibrated with rods placed to 5 mm and the scene is reconstructed with that
calibration. 25 random lengths of 0.5 to 10 m at 8 to 20 m are measured between pixels picked with
0.3 px of noise, and 25 check points after georeferencing by four control points of 5 mm near 15 m.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

from binocular_recon.calibration.solve import calibrate
from binocular_recon.camera import FloatArray
from binocular_recon.config import ChainConfig
from binocular_recon.errors import MeasurementError
from binocular_recon.evaluation.paper.runs import simulated_marks
from binocular_recon.evaluation.paper.sigmas import BOARDS, PLACEMENT_M, true_points
from binocular_recon.evaluation.paper.site import simulate_site
from binocular_recon.images import Mask
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.measurement.picks import Pick
from binocular_recon.measurement.site.adjustment import adjust
from binocular_recon.measurement.site.control_points import ControlPoint
from binocular_recon.measurement.snapping import PICK_SIGMA_PX, locate
from binocular_recon.measurement.uncertain import Uncertain, propagate
from binocular_recon.simulation.rig import survey_rig
from binocular_recon.simulation.rods import paper_board, with_placement
from binocular_recon.stereo.pipeline import Chain

COUNT, CONTROL_M = 25, 0.005
Picker = Callable[[float, float], tuple[Uncertain, FloatArray, Pick]]


def main() -> None:
    """Print the figures of all sites."""
    sites = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    first_seed = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    lengths, checks = [], []
    for seed in range(first_seed, first_seed + sites):
        site = simulate_site(seed, survey_rig())
        board = with_placement(paper_board(), PLACEMENT_M)
        marks = simulated_marks(site.rig, board, BOARDS, seed)
        rig = calibrate(marks, board, site.rig.left.size).rig
        chain = Chain(rig, ChainConfig.preset('default'))
        frame = MeasuredFrame.of(chain(site.left, site.right), chain.rig)
        pick = picker(frame, *true_points(site, rig), np.random.default_rng(seed))
        lengths += random_lengths(pick)
        checks += check_points(pick, frame, np.random.default_rng(seed))
        print(
            f'to seed {seed}: lengths {figures(lengths)}; check points {figures(checks)}',
            flush=True,
        )


def picker(
    frame: MeasuredFrame, truth: FloatArray, clear: Mask, rng: np.random.Generator
) -> Picker:
    """Return what picks a random point between two depths: measured, true, and the pick."""
    depth = truth[..., 2]

    def pick(near_m: float, far_m: float) -> tuple[Uncertain, FloatArray, Pick]:
        rows, columns = np.nonzero(clear & (depth > near_m) & (depth < far_m))
        while True:
            index = rng.integers(len(rows))
            row, column = rows[index], columns[index]
            noise = rng.normal(0, PICK_SIGMA_PX, 2)
            one = Pick(f'{row} {column}', np.array([column, row]) + noise)
            try:
                return locate(frame, one), truth[row, column].astype(np.float64), one
            except MeasurementError:  # a hole: pick elsewhere
                continue

    return pick


def random_lengths(pick: Picker) -> list[float]:
    """Return errors over sigma of random lengths."""
    ratios: list[float] = []
    while len(ratios) < COUNT:
        (first, a, _), (last, b, _) = pick(8.0, 20.0), pick(8.0, 20.0)
        true = float(np.linalg.norm(b - a))
        if 0.5 <= true <= 10:
            found = propagate(lambda p, q: np.linalg.norm(q - p), first, last)
            ratios.append(float((found.values[0] - true) / found.sigma[0]))
    return ratios


def check_points(pick: Picker, frame: MeasuredFrame, rng: np.random.Generator) -> list[float]:
    """Return errors over sigma of the coordinates of check points."""
    while True:
        picked = [pick(13.0, 17.0) for _ in range(4)]
        picked += [pick(8.0, 20.0) for _ in range(COUNT)]
        sigma = np.full(3, CONTROL_M)
        control = [
            ControlPoint(f'{i}', true + rng.normal(0, CONTROL_M, 3), sigma, one, i >= 4)
            for i, (_, true, one) in enumerate(picked)
        ]
        try:
            found = adjust([point for point, _, _ in picked], control, frame)
        except MeasurementError:  # a wrong match, or points on one line: a crew picks others
            continue
        errors = found.checks.values()
        return [float(ratio) for one in errors for ratio in one.off_m / one.sigma_m]


def figures(ratios: list[float]) -> str:
    """Return RMS and share beyond 3."""
    off = np.abs(ratios)
    return f'RMS {np.sqrt(np.mean(off**2)):.2f}, beyond 3 sigma {100 * np.mean(off > 3):.1f} %'


if __name__ == '__main__':
    main()
