# SPDX-License-Identifier: Apache-2.0
"""The charts of the calibration report, one function each."""

from __future__ import annotations

import numpy as np

from binocular_recon.calibration.adjustment.uncertainty import (
    depth_sigma_m,
    matching_sigma_m,
    points_at,
)
from binocular_recon.calibration.report.mark_errors import mark_errors_m
from binocular_recon.calibration.result import DISPARITY_SIGMA_PX, CalibrationResult
from binocular_recon.camera import FloatArray
from binocular_recon.drawing.svg import FAINT, INK, Chart, shade
from binocular_recon.number_text import counted, plain, significant

# The three methods, with the colours they have throughout the report.
UNCORRECTED = '#c8553d'
METHODS = {'planar': '#9aa7b4', 'corrected': '#e0a13a', 'adjusted': '#0b7a75'}
DISTANCE = 'distance, m'
# Columns and rows of the map of the depth sigma.
_MAP = 24, 15
# Columns and rows of the grid over an image whose coverage is counted.
FIELDS = 8, 5
# Bars of the chart of marks by distance.
_DISTANCE_BINS = 12


def board_errors(result: CalibrationResult) -> str:
    """Draw the reprojection error of each board by all three methods (Fig. 12)."""
    errors = {name: getattr(result, name).board_error_px for name in METHODS}
    top = 1.1 * max(values.max() for values in errors.values())
    count = len(result.names)
    chart = Chart((-0.5, count - 0.5), (-0.08 * top, top), (960, 300), ('', 'error, px'))
    for board, name in enumerate(result.names):
        if board % (1 + count // 24) == 0:
            chart.text((board, -0.06 * top), name, FAINT)
    for slot, (name, color) in enumerate(METHODS.items()):
        for board, error in enumerate(errors[name]):
            left = board - 0.36 + 0.24 * slot
            chart.box(
                np.array([[left, 0], [left + 0.22, error]]),
                color,
                f'{result.names[board]}, {name}: {error:.3f} px',
            )
    return chart.svg('Reprojection error of each board by three methods')


def row_differences(result: CalibrationResult) -> str:
    """Draw the row differences of all marks before and after correction (Table 1)."""
    groups = (
        (result.planar.row_difference_px, UNCORRECTED),
        (result.corrected.row_difference_px, METHODS['corrected']),
        (result.adjusted.row_difference_px, METHODS['adjusted']),
    )
    distance = result.marks_m[..., 2]
    extent = np.nanmax(np.abs(result.planar.row_difference_px))
    extent = 1.1 * max(extent, np.nanmax(np.abs(result.corrected.row_difference_px)))
    line = result.line
    labels = DISTANCE, f'left {line} - right {line}, px'
    chart = Chart(_limits(distance), (-extent, extent), labels=labels)
    for rows, color in groups:
        chart.dots(np.column_stack([distance.ravel(), rows.ravel()]), color, 2)
    return chart.svg(f'{line.capitalize()} differences of the marks before and after correction')


def known_heights(result: CalibrationResult) -> str:
    """Draw errors of reconstructed marks against their known places (Fig. 10 and 11)."""
    target = result.estimate.problem.target
    distance = result.marks_m[..., 2]
    errors = {name: 1e3 * mark_errors_m(getattr(result, name).marks_m, target) for name in METHODS}
    extent = 1.1 * max(
        np.nanquantile(np.abs(values), 0.995) for values in errors.values() if values.size
    )
    chart = Chart(
        _limits(distance), (-extent, extent), labels=(DISTANCE, 'error along the rod, mm')
    )
    for shift, (name, color) in enumerate(METHODS.items()):
        beside = distance + (shift - 1) * 0.004 * np.ptp(distance)
        inside = np.abs(errors[name]) <= extent
        chart.dots(np.column_stack([beside[inside], errors[name][inside]]), color, 1.8, 0.7)
    return chart.svg('Errors of reconstructed marks by distance')


def heights_of_marks(result: CalibrationResult) -> str:
    """Draw the mean error of each mark of a rod against its known height (Fig. 10)."""
    target = result.estimate.problem.target
    means, spreads = {}, {}
    for name in METHODS:
        errors = 1e3 * mark_errors_m(getattr(result, name).marks_m, target)
        errors = errors.reshape(-1, len(target.heights_m))
        means[name], spreads[name] = np.nanmean(errors, axis=0), np.nanstd(errors, axis=0)
    extent = 1.1 * max(np.nanmax(np.abs(means[name]) + spreads[name]) for name in METHODS)
    heights = target.heights_m
    margin = 0.08 * float(np.ptp(heights))
    chart = Chart(
        (float(heights[0]) - margin, float(heights[-1]) + margin),
        (-extent, extent),
        labels=('known height, m', 'reconstructed - known, mm'),
    )
    for shift, (name, color) in enumerate(METHODS.items()):
        places = heights + (shift - 1) * 0.15 * margin
        low, high = (
            np.column_stack([places, means[name] + sign * spreads[name]]) for sign in (-1, 1)
        )
        chart.strokes(low, high, color, 2)
        chart.dots(np.column_stack([places, means[name]]), color, 3.5, 1)
    return chart.svg('Reconstructed marks against their known heights')


def depth_coverage(result: CalibrationResult) -> str:
    """Draw how many marks were seen by both cameras at each distance."""
    seen = np.isfinite(result.adjusted.residuals_px).all(axis=-1)
    counts, edges = np.histogram(result.marks_m[..., 2][seen], bins=_DISTANCE_BINS)
    chart = Chart(
        (float(edges[0]), float(edges[-1])),
        (0, 1.08 * float(counts.max())),
        labels=(DISTANCE, 'marks'),
    )
    gap = 0.04 * (edges[1] - edges[0])
    for count, low, high in zip(counts, edges, edges[1:], strict=False):
        corners = np.array([[low + gap, 0], [high - gap, count]])
        chart.box(
            corners,
            METHODS['adjusted'],
            f'{counted(count, "mark")} at {significant(low)} to {significant(high)} m',
        )
    return chart.svg('Marks at each distance')


def plan(result: CalibrationResult) -> str:
    """Draw where the boards stood, seen from above."""
    marks = result.marks_m
    far, wide = 1.08 * marks[..., 2].max(), 1.1 * np.abs(marks[..., 0]).max()
    wide = max(wide, 0.4 * far)
    chart = Chart((-wide, wide), (-0.03 * far, far), (480, 420), ('x, m', DISTANCE))
    width = result.calibration.image_size[0]
    for side, color in (('left', METHODS['planar']), ('right', METHODS['corrected'])):
        K, _, R, T = result.calibration.side(side)
        edges = np.array([[-K[0, 2] / K[0, 0], 0, 1], [(width - K[0, 2]) / K[0, 0], 0, 1]])
        centre = -R.T @ T
        reach = [centre + far * edge @ R for edge in edges]
        wedge = np.array([reach[0], centre, reach[1]])[:, [0, 2]]
        wedge = np.clip(wedge, [-wide, -0.03 * far], [wide, far])
        chart.area(wedge, color, 0.12)
        chart.dots(centre[None, [0, 2]], INK, 4, 1)
    for board, name in zip(marks, result.names, strict=True):
        feet = board.mean(axis=1)[:, [0, 2]]
        chart.line(feet[np.argsort(feet[:, 0])], METHODS['adjusted'], 1)
        chart.dots(feet, METHODS['adjusted'], 2.5, 1)
        chart.text(feet[feet[:, 0].argmax()] + [0.03 * wide, 0], name, FAINT, 'start')
    return chart.svg('Boards seen from above')


def coverage(result: CalibrationResult, side: str) -> str:
    """Draw the marks in one image, dark = far."""
    chart = _image_chart(result)
    pixels = of_side(result.estimate.problem.observed_px, side)
    depth = result.marks_m[..., 2]
    near, span = depth.min(), max(np.ptp(depth), 1e-9)
    bands = 6
    for band in range(bands):
        chosen = np.clip(((depth - near) / span * bands).astype(int), 0, bands - 1) == band
        chart.dots(pixels[chosen], shade(0.25 + 0.75 * band / (bands - 1)), 2.5, 0.9)
    return chart.svg(f'Marks in the {side} image')


def covered(result: CalibrationResult, side: str) -> float:
    """Return the share of the fields of an image that hold a mark."""
    pixels = of_side(result.estimate.problem.observed_px, side).reshape(-1, 2)
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    width, height = result.calibration.image_size
    columns, rows = (pixels / [width / FIELDS[0], height / FIELDS[1]]).astype(int).T
    return len(set(zip(columns, rows, strict=True))) / (FIELDS[0] * FIELDS[1])


def residual_vectors(result: CalibrationResult, side: str) -> tuple[str, float]:
    """Draw the residuals of one image, magnified; returns the chart and the factor."""
    chart = _image_chart(result)
    pixels = of_side(result.estimate.problem.observed_px, side).reshape(-1, 2)
    residuals = of_side(result.adjusted.residuals_px, side).reshape(-1, 2)
    seen = np.isfinite(residuals).all(axis=1)
    typical = np.sqrt(np.mean(residuals[seen] ** 2))
    factor = float(10 ** np.round(np.log10(0.02 * result.calibration.image_size[0] / typical)))
    starts = pixels[seen]
    chart.strokes(starts, starts + factor * residuals[seen], UNCORRECTED)
    chart.dots(starts, INK, 1.2, 0.8)
    return chart.svg(f'Residuals in the {side} image, {plain(factor)} times enlarged'), factor


def depth_sigma(result: CalibrationResult) -> str:
    """Draw the predicted depth sigma against distance."""
    depth = result.marks_m[..., 2]
    near, far = float(depth.min()), float(depth.max())
    distances = np.linspace(0.5 * near, 1.5 * far, 25)
    own = 1e3 * np.array([result.depth_sigma_m(z, 0.0) for z in distances])
    distances, own = distances[np.isfinite(own)], own[np.isfinite(own)]
    noise = 1e3 * matching_sigma_m(
        result.rig.focal_px, result.rig.baseline_m, distances, DISPARITY_SIGMA_PX
    )
    total = np.hypot(own, noise)
    chart = Chart((0, 1.5 * far), (0, 1.05 * total.max()), labels=(DISTANCE, 'depth sigma, mm'))
    top = 1.05 * total.max()
    chart.area(np.array([[near, 0], [far, 0], [far, top], [near, top]]), METHODS['adjusted'], 0.07)
    chart.text(((near + far) / 2, 0.95 * top), 'boards', FAINT)
    chart.line(np.column_stack([distances, noise]), METHODS['corrected'], 2, '5 4')
    chart.line(np.column_stack([distances, own]), METHODS['planar'], 2, '2 3')
    chart.line(np.column_stack([distances, total]), METHODS['adjusted'], 2.5)
    return chart.svg('Predicted depth sigma against distance')


def depth_sigma_map(result: CalibrationResult, depth_m: float) -> tuple[str, float, float]:
    """Draw the calibration's depth sigma over the left image; returns chart and range, m."""
    chart = _image_chart(result)
    width, height = result.calibration.image_size
    columns, rows = (
        np.linspace(0, n - 1, k + 1) for n, k in zip((width, height), _MAP, strict=True)
    )
    centres = np.stack(np.meshgrid(*((a[1:] + a[:-1]) / 2 for a in (columns, rows))), -1)
    points = points_at(result.calibration, centres.reshape(-1, 2), depth_m)
    seen = result.calibration.project(points, 'right')
    shared = ((seen >= 0) & (seen <= [width - 1, height - 1])).all(axis=-1)
    sigmas = np.full(len(points), np.nan)
    found = result.estimate
    if shared.any():
        sigmas[shared] = depth_sigma_m(
            result.calibration, found.problem.free, found.covariance, points[shared]
        )
    low, high = (float(f(sigmas)) for f in (np.nanmin, np.nanmax))
    for index, sigma in enumerate(sigmas):
        row, column = divmod(index, _MAP[0])
        corners = np.array([[columns[column], rows[row]], [columns[column + 1], rows[row + 1]]])
        if np.isfinite(sigma):
            color = shade((sigma - low) / max(high - low, 1e-12))
            chart.box(corners, color, f'{1e3 * sigma:.1f} mm')
    chart.frame()
    return chart.svg(f'Depth sigma at {plain(depth_m)} m over the left image'), low, high


def of_side(marks_px: FloatArray, side: str) -> FloatArray:
    """Return the columns (..., 2) of ``'left'`` or ``'right'`` of marks (..., 4)."""
    return marks_px[..., :2] if side == 'left' else marks_px[..., 2:]


def _image_chart(result: CalibrationResult) -> Chart:
    """Return an empty chart with the proportions of the image, rows downwards."""
    width, height = result.calibration.image_size
    # the drawing area is 456 px wide: 18 and 16 px of it are margins
    chart = Chart((0, width - 1), (height - 1, 0), (474, round(16 + 456 * height / width)))
    chart.frame()
    return chart


def _limits(distance: FloatArray) -> tuple[float, float]:
    margin = 0.04 * float(np.ptp(distance)) + 1e-6
    return float(distance.min()) - margin, float(distance.max()) + margin
