# SPDX-License-Identifier: Apache-2.0
"""Drawings of detections."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.detection.detect import Detection
from binocular_recon.drawing.detections import draw_detections


def test_marks_are_drawn_where_they_were_found() -> None:
    image = np.zeros((240, 320, 3), np.uint8)
    marks = np.full((2, 3, 2), np.nan)
    marks[0] = [[200, 180], [200, 150], [200, 120]]
    found = Detection(marks, np.full((2, 3), 0.1), ('rod 2 of 2 not found',))
    nothing = Detection(np.full((2, 3, 2), np.nan), np.full((2, 3), np.nan), ('no rod found',))
    drawn = draw_detections((image, image), (found, nothing))
    assert drawn.shape == (240, 640, 3)
    assert not image.any()
    green = drawn[..., 1].astype(int) > drawn[..., 2].astype(int) + 50
    rows, columns = np.nonzero(green)
    assert abs(columns.mean() - 200) < 2
    assert rows.min() > 115 and rows.max() < 185
    assert not green[:, 320:].any()
    # words in both halves
    assert (drawn[:40, :320] > 200).any()
    assert (drawn[:40, 320:] > 200).any()
