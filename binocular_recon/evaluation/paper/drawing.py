# SPDX-License-Identifier: Apache-2.0
"""Images of a surveyed site as the paper's Fig. 13-15 show it."""

from __future__ import annotations

import cv2
import numpy as np

from binocular_recon.drawing.clouds import CloudView, draw_cloud
from binocular_recon.drawing.colormap import heat_map
from binocular_recon.drawing.labels import write_label
from binocular_recon.evaluation.paper.runs import CROP_M, PaperRun, Survey
from binocular_recon.evaluation.paper.sizes import BICYCLE, PEOPLE
from binocular_recon.images import ByteImage, to_bgr8
from binocular_recon.measurement.lengths import Length

LINE_BGR = (60, 230, 255)
# Left, right, above and below the things, as a share of the width of the picks' box.
MARGIN = 0.12
WIDTH_PX = 900


def draw_sizes(survey: Survey, run: PaperRun) -> ByteImage:
    """Return the image with what was measured, above the disparity map of the same part.

    Returns
    -------
    image : (h, 900, 3) uint8
        BGR.

    """
    window = _window(survey)
    scale = WIDTH_PX / (window[1].stop - window[1].start)
    photo = _enlarged(to_bgr8(survey.reconstruction.left)[window], scale)
    origin = np.array([window[1].start, window[0].start])
    true = survey.site.scene.lengths_m
    for name in (*PEOPLE, BICYCLE):
        ends = ('rear', 'front') if name == BICYCLE else ('top', 'sole')
        first, last = (
            np.rint(scale * (survey.picks_px[f'{name}_{end}'] - origin)).astype(int)
            for end in ends
        )
        cv2.line(photo, first.tolist(), last.tolist(), LINE_BGR, 1, cv2.LINE_AA)
        for end in (first, last):
            cv2.drawMarker(photo, end.tolist(), LINE_BGR, cv2.MARKER_CROSS, 11, 1, cv2.LINE_AA)
        metres = true[name] + run.errors_mm[name][0] / 1e3
        text = str(Length(metres, run.sigmas_mm[name][0] / 1e3))
        column, row = np.minimum(first, last).tolist()
        write_label(photo, text, (column, row - 12), 0.5)
    disparity = survey.reconstruction.filtered.disparity_px[window]
    return np.vstack([photo, _enlarged(heat_map(disparity), scale)])


def draw_crop(survey: Survey) -> ByteImage:
    """Return the cloud within the range of depths, from above: (h, 900, 3) uint8, BGR."""
    window = _window(survey)
    points = survey.reconstruction.cloud.points_xyz[window]
    depth = [survey.site.scene.points_xyz[name][2] for name in survey.picks_px]
    near, far = max(CROP_M[0], min(depth) - 1.0), min(CROP_M[1], max(depth) + 1.0)
    inside = (points[..., 2] > near) & (points[..., 2] < far)
    cropped = np.where(inside[..., None], points, np.float32(np.nan))
    colour = to_bgr8(survey.reconstruction.left)[window]
    return draw_cloud(cropped, colour, (WIDTH_PX, WIDTH_PX // 2), CloudView(15.0, 20.0, 1.0))


def _window(survey: Survey) -> tuple[slice, slice]:
    """Return the rows and columns that hold all picks with a margin."""
    picks = np.stack(list(survey.picks_px.values()))
    low, high = picks.min(axis=0), picks.max(axis=0)
    margin = MARGIN * (high[0] - low[0])
    height, width = survey.reconstruction.cloud.depth_m.shape
    left, top = np.maximum(low - margin, 0).astype(int)
    right, bottom = np.minimum(high + margin, [width, height]).astype(int)
    return slice(top, bottom), slice(left, right)


def _enlarged(image: ByteImage, scale: float) -> ByteImage:
    height = round(image.shape[0] * scale)
    return np.asarray(
        cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_CUBIC), np.uint8
    )
