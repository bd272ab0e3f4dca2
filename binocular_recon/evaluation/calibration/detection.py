# SPDX-License-Identifier: Apache-2.0
"""How well rods are detected: simulated captures against their truth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from binocular_recon.calibration.detection.detect import detect_rods
from binocular_recon.calibration.target.rods import RodBoard
from binocular_recon.camera import FloatArray
from binocular_recon.simulation.capture import SimulatedCapture


@dataclass(frozen=True, eq=False)
class BoardScore:
    """How well the rods of one capture were detected.

    Attributes
    ----------
    expected : int
        Marks visible in both images.
    missed : int
        Those of them not found in one image or the other.
    wrong : int
        Marks of either image off by more than half a spacing, or of another rod.
    errors_px : (N, 2) float64
        Errors x, y of all other marks found.
    seconds : tuple of float
        Time for the left and the right image.

    """

    expected: int
    missed: int
    wrong: int
    errors_px: FloatArray
    seconds: tuple[float, float]


def score_capture(board: RodBoard, capture: SimulatedCapture) -> BoardScore:
    """Detect the rods in both images and compare with the truth."""
    found, errors, seconds, wrong = [], [], [], 0
    for image, truth in ((capture.left, capture.left_px), (capture.right, capture.right_px)):
        start = time.perf_counter()
        detection = detect_rods(image, board)
        seconds.append(time.perf_counter() - start)
        error = detection.marks_px - truth
        spacing = np.linalg.norm(np.diff(truth, axis=1), axis=-1)
        # half of the smaller gap to a neighbour on the rod
        limit = 0.5 * np.minimum(
            np.pad(spacing, ((0, 0), (1, 0)), constant_values=np.inf),
            np.pad(spacing, ((0, 0), (0, 1)), constant_values=np.inf),
        )
        off = np.linalg.norm(error, axis=-1) > limit
        wrong += int(off.sum())
        errors.append(error[detection.found & ~off])
        found.append(detection.found & ~off)
    expected = capture.left_visible & capture.right_visible
    missed = int((expected & ~(found[0] & found[1])).sum())
    return BoardScore(
        int(expected.sum()), missed, wrong, np.concatenate(errors), (seconds[0], seconds[1])
    )


def summarise_scores(scores: list[BoardScore]) -> dict[str, Any]:
    """Return the figures of a detection evaluation under the keys of ``detection.json``."""
    errors = np.concatenate([score.errors_px for score in scores])
    seconds = np.array([score.seconds for score in scores]).ravel()
    rms = np.sqrt(np.mean(errors**2, axis=0)) if len(errors) else (np.nan, np.nan)
    return {
        'boards': len(scores),
        'boards_complete': sum(score.missed == 0 for score in scores),
        'marks_expected': sum(score.expected for score in scores),
        'marks_missed': sum(score.missed for score in scores),
        'marks_measured': len(errors),
        'wrong_identities': sum(score.wrong for score in scores),
        'rms_px': {'x': float(rms[0]), 'y': float(rms[1])},
        'seconds_per_image': {
            'median': float(np.median(seconds)),
            'p90': float(np.percentile(seconds, 90)),
        },
    }
