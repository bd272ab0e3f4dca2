# SPDX-License-Identifier: Apache-2.0
"""The section of a frame: its images, and maps of disparity, standard deviation, validity."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from binocular_recon.apps.survey.report.images import photo
from binocular_recon.apps.survey.report.sources import ReportSources, text
from binocular_recon.drawing.colormap import heat_map, own_limits
from binocular_recon.drawing.page import colour_bar, legend, section, table
from binocular_recon.images import ByteImage, FloatImage, Mask, to_bgr8
from binocular_recon.io.image_files import read_image_file
from binocular_recon.measurement.frame import MeasuredFrame
from binocular_recon.number_text import significant
from binocular_recon.stereo.point_covariance import sigma_shares
from binocular_recon.stereo.triangulation import triangulate
from binocular_recon.stereo.validity import Validity

# CSS colours of measured and filled pixels, and of those without a point.
_MEASURED, _FILLED, _NONE = '#0b7a75', '#e0a13a', '#2b3138'
# Maps are drawn at this width, px.
_MAP_PX = 960
_BAR_COLOURS, _BAR_LABELS = 17, 5
_REASONS = {
    Validity.EXTRAPOLATED: 'beyond the last match: seen by one camera only, or sky',
    Validity.LOW_TEXTURE: 'too little texture',
    Validity.CONFLICT: 'left and right contradict each other: half occluded, mostly',
    Validity.AMBIGUOUS: 'another disparity fits as well',
    Validity.AT_LIMIT: 'at the limit of the searched range',
    Validity.NO_DATA: 'no data in one of the images',
}


def frame_maps(sources: ReportSources, number: int, frame: MeasuredFrame) -> str:
    """Return the section of a frame."""
    known: Mask = np.isfinite(frame.disparity_px)
    cloud = triangulate(
        frame.disparity_px, frame.sigma_px, frame.validity, frame.rig, frame.limits
    )
    has_point = np.asarray(np.isfinite(cloud.points_xyz).all(axis=-1))
    sigma_mm = np.where(has_point, 1e3 * cloud.sigma_z_m, np.float32(np.nan))
    typical = float(np.median(sigma_mm[has_point])) if has_point.any() else float('nan')
    depths = _Scale(frame.disparity_px, ' px', frame)
    spread = _Scale(sigma_mm, ' mm')
    spread_caption = (
        f'Standard deviation of depth ({sigma_shares(cloud.calibrated)}); black: no point. Median'
        f' {significant(typical)} mm.'
    )
    right = sources.folder.folder / f'{number:06d}_right.png'
    figures = [photo(frame.left_bgr, 'Left image, rectified.')]
    if right.exists():
        figures.append(photo(to_bgr8(read_image_file(right)), 'Right image, rectified.'))
    else:
        remedy = 'reconstruct --format right keeps it'
        figures.append(f'<p>Right image: {sources.lacks("right image", remedy)}</p>')
    figures += [
        photo(depths.image, f'Disparity and depth.{depths.bar}'),
        photo(spread.image, f'{spread_caption}{spread.bar}'),
    ]
    validity = photo(_validity_map(frame, has_point), 'Which pixels were measured.')
    key = legend(('measured', _MEASURED), ('filled', _FILLED), ('no point', _NONE))
    return section(
        f'Frame {number}: images and maps',
        'A point that was matched in both images is measured; one that was not is filled from'
        ' around it, with a larger sigma, or left out.',
        *figures,
        f'{validity.removesuffix("</figcaption></figure>")} {key}</figcaption></figure>',
        _shares(frame, known, has_point),
    )


class _Scale:
    """A map in colours, and the bar that says what they mean: ``image``, ``bar`` (HTML)."""

    def __init__(self, values: FloatImage, unit: str, frame: MeasuredFrame | None = None) -> None:
        low, high = own_limits(values)
        self.image = heat_map(_small(values), (low, high))
        ramp = np.linspace(low, high, _BAR_COLOURS, dtype=np.float32)[None]
        marks = np.linspace(low, high, _BAR_LABELS)
        labels = [f'{significant(float(mark))}{unit}' for mark in marks]
        if frame is not None:
            ahead = np.maximum(marks - frame.rig.disparity_offset_px, 1e-9)
            depths = (frame.focal_baseline / ahead).tolist()
            pairs = zip(labels, depths, strict=True)
            labels = [f'{label}\n{significant(depth)} m' for label, depth in pairs]
        self.bar = colour_bar(heat_map(ramp, (low, high))[0], labels)


def _shares(frame: MeasuredFrame, known: Mask, has_point: Mask) -> str:
    """Return the table of the shares of pixels by validity, and of those without a point."""
    count = frame.validity.size
    bits = frame.validity

    def share(mask: npt.NDArray[Any]) -> str:
        return f'{100 * np.count_nonzero(mask) / count:.2f} %'

    limit = frame.limits.max_sigma
    no_point = (
        f'disparity, but no point: sigma above {limit}{" of the depth" if "%" in limit else " m"},'
        ' outside of the depth limits, or extrapolated'
    )
    rows = [
        ('measured', share(bits & Validity.MEASURED)),
        ('filled between matches', share(bits & Validity.FILLED)),
        *(
            (f'not measured: {words}', share(bits & bit))
            for bit, words in _REASONS.items()
            if (bits & bit).any()
        ),
        ('no disparity', share(~known)),
        (text(no_point), share(known & ~has_point)),
        ('points before thinning', share(has_point)),
    ]
    return table(('pixels', 'share'), rows, kind='shares')


def _validity_map(frame: MeasuredFrame, has_point: Mask) -> ByteImage:
    """Return the map of measured and filled points, (H, W, 3) BGR."""
    colours = [[int(one[i : i + 2], 16) for i in (5, 3, 1)] for one in (_NONE, _FILLED, _MEASURED)]
    classes = has_point.astype(np.intp) * np.where(frame.measured, 2, 1)
    drawn: ByteImage = _small(np.array(colours, np.uint8)[classes])
    return drawn


def _small(image: npt.NDArray[Any]) -> Any:
    """Return an image no wider than it is drawn, without mixing pixels."""
    height, width = image.shape[:2]
    if width <= _MAP_PX:
        return image
    size = (_MAP_PX, max(1, round(height * _MAP_PX / width)))
    return cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
