# SPDX-License-Identifier: Apache-2.0
"""The calibration report: one HTML file with its images inside, nothing from the network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

import numpy as np

from binocular_recon.calibration.report import _charts as charts
from binocular_recon.calibration.report._charts import METHODS, UNCORRECTED
from binocular_recon.calibration.report._parameters import parameters
from binocular_recon.calibration.report.mark_errors import mark_errors_m
from binocular_recon.calibration.result import (
    DISPARITY_SIGMA_PX,
    CalibrationResult,
    row_statistics,
)
from binocular_recon.drawing.page import (
    cards,
    embedded_image,
    figure,
    legend,
    page,
    section,
    table,
)
from binocular_recon.number_text import counted, day_text, plain, significant

# Distances listed in the table of depth sigmas.
_DEPTH_ROWS = 6


class BoardImage(NamedTuple):
    """A board's two images side by side as a JPEG, with the marks drawn in.

    ``reason`` says why the board was left out; empty if it was used.
    """

    name: str
    jpeg: bytes
    reason: str = ''


def render_report(
    result: CalibrationResult, images: Sequence[BoardImage] = (), date: str = ''
) -> str:
    """Return the report as an HTML page, with the images given and the date (ISO 8601)."""
    sections = (
        _summary(result),
        _notes(result),
        _depth(result),
        _methods(result),
        _rows(result),
        _heights(result),
        _coverage(result),
        _residuals(result),
        _next_boards(result),
        _images(images),
        parameters(result),
    )
    subtitle = f'{day_text(date)} · ' if date else ''
    subtitle += f'{counted(len(result.names), "board")}, {result.sizes}'
    footer = 'Uncertainties are one standard deviation.'
    return page('Stereo calibration', sections, footer, subtitle=subtitle)


def _summary(result: CalibrationResult) -> str:
    calibration, sigma = result.calibration, result.sigma
    depth = _working_depth(result)
    marks = int(np.isfinite(result.adjusted.residuals_px).all(axis=-1).sum())
    noise = float(np.sqrt(np.mean(result.mark_sigma_px**2)))
    figures = (
        (
            f'{significant(1e3 * result.depth_sigma_m(depth))} mm',
            f'depth sigma at {plain(depth)} m',
        ),
        (
            f'{1e3 * calibration.baseline_m:.2f} mm',
            f'baseline, ± {significant(1e3 * sigma["baseline_m"], 2)} mm',
        ),
        (
            f'{result.rig.left.K[0, 0]:.0f} / {result.rig.right.K[0, 0]:.0f} px',
            f'focal length left / right, ± {significant(sigma["fx_left_px"], 2)} px',
        ),
        (
            f'{result.adjusted.error_px:.3f} px',
            f'reprojection error; noise of a mark {noise:.3f} px',
        ),
        (
            f'{len(result.names)}',
            f'boards used, {counted(marks, "mark")} in both images, {result.sizes}',
        ),
    )
    return cards(figures)


def _notes(result: CalibrationResult) -> str:
    notes = [escape(warning) for warning in result.warnings]
    notes += [
        f'Board <b>{escape(board.name)}</b> was left out: {escape(board.reason)}.'
        for board in result.rejected
    ]
    if count := int(result.estimate.outliers.sum()):
        notes.append(
            counted(count, 'single mark was', 'single marks were')
            + ' left out: off by more than noise allows.'
        )
    if not notes:
        return '<p class="good">Every board and every mark was used.</p>'
    return f'<ul class="notes">{"".join(f"<li>{note}</li>" for note in notes)}</ul>'


def _depth(result: CalibrationResult) -> str:
    depth = _working_depth(result)
    image, low, high = charts.depth_sigma_map(result, depth)
    rows = []
    for z in np.linspace(0.5, 1.5, _DEPTH_ROWS) * depth:
        sigmas = (1e3 * result.depth_sigma_m(z, noise) for noise in (0.0, DISPARITY_SIGMA_PX))
        rows.append((f'{significant(z)} m', *(f'{significant(sigma)} mm' for sigma in sigmas)))
    return section(
        'Expected accuracy of depth',
        f'One standard deviation over the middle half of the images, from the covariance of the'
        f' calibration and {DISPARITY_SIGMA_PX:g} px of disparity noise.',
        figure(
            charts.depth_sigma(result),
            legend(
                ('total', METHODS['adjusted']),
                ('calibration alone', METHODS['planar']),
                ('disparity noise alone', METHODS['corrected']),
            ),
        ),
        figure(
            image,
            f'Share of the calibration alone at {plain(depth)} m, over the left image:'
            f' {significant(1e3 * low)} mm (light) to {significant(1e3 * high)} mm (dark).',
        ),
        table(('distance', 'calibration alone', 'with disparity noise'), rows),
    )


def _methods(result: CalibrationResult) -> str:
    stages = [getattr(result, name) for name in METHODS]
    rows = [
        (
            escape(name),
            *(f'{stage.board_error_px[i]:.3f}' for stage in stages),
            _change(stages[2].board_error_px[i], stages[0].board_error_px[i]),
        )
        for i, name in enumerate(result.names)
    ]
    means = [float(stage.board_error_px.mean()) for stage in stages]
    rows.append(('average', *(f'{mean:.3f}' for mean in means), _change(means[2], means[0])))
    return section(
        'Three methods on the same marks: reprojection error',
        'Planar: every rod is taken as exactly placed (Zhang). Corrected: calibrated again after'
        ' epipolar correction. Adjusted: both cameras and every rod are estimated together; this'
        ' is the calibration that was saved. Errors are root mean squares per image axis in the'
        ' original images; those of a perfect calibration are the noise of the marks.',
        figure(charts.board_errors(result), legend(*METHODS.items()), kind='wide'),
        table(
            ('board', 'planar, px', 'corrected, px', 'adjusted, px', 'adjusted against planar'),
            rows,
            kind='total wide',
        ),
    )


def _rows(result: CalibrationResult) -> str:
    rows = []
    for name, differences in (
        ('uncorrected', result.planar.row_difference_px),
        ('corrected (planar calibration)', result.corrected.row_difference_px),
        ('adjusted calibration', result.adjusted.row_difference_px),
    ):
        statistics = row_statistics(differences)
        rows.append((name, f'{statistics["mean"]:.3f}', f'{statistics["max"]:.3f}'))
    line = result.line
    return section(
        f'{line.capitalize()}s of the two images',
        f'A mark must appear in the same {line} of both rectified images. What remains here is'
        ' mostly the noise of the marks themselves.',
        figure(
            charts.row_differences(result),
            legend(
                ('uncorrected', UNCORRECTED),
                ('corrected', METHODS['corrected']),
                ('adjusted', METHODS['adjusted']),
            ),
        ),
        table((f'{line} difference', 'mean, px', 'largest, px'), rows),
    )


def _heights(result: CalibrationResult) -> str:
    target = result.estimate.problem.target
    rows = []
    for name in METHODS:
        errors = 1e3 * mark_errors_m(getattr(result, name).marks_m, target)
        errors = errors[np.isfinite(errors)]
        if errors.size:
            rms = np.sqrt(np.mean(errors**2))
            rows.append((name, f'{rms:.2f}', f'{np.abs(errors).max():.2f}'))
    if not rows:
        return ''
    known = [figure(charts.known_heights(result), legend(*METHODS.items()))]
    if target.has_rods:
        known.append(
            figure(
                charts.heights_of_marks(result),
                'Mean of each mark over all rods, with its standard deviation.',
            )
        )
    what = (
        'Marks reconstructed from both images, against the known heights on their rod'
        if target.has_rods
        else 'Points reconstructed from both images, against the known target'
    )
    return section(
        'Reconstructed marks against their known places',
        f'{what}. The plan shows where the boards stood and what both cameras see.',
        figure(charts.plan(result), 'Boards from above.'),
        *known,
        table(('method', 'root mean square, mm', 'largest, mm'), rows),
    )


def _coverage(result: CalibrationResult) -> str:
    depth = result.marks_m[..., 2]
    figures = []
    for side in ('left', 'right'):
        share = 100 * charts.covered(result, side)
        fields = '{} x {}'.format(*charts.FIELDS)
        caption = (
            f'{side.capitalize()} image: marks in {share:.0f} % of {fields} fields; dark = far.'
        )
        figures.append(figure(charts.coverage(result, side), caption))
    return section(
        'Coverage',
        f'Distortion and depth are known only where marks were seen: {significant(depth.min())}'
        f' to {significant(depth.max())} m.',
        *figures,
        figure(charts.depth_coverage(result), 'Marks seen by both cameras at each distance.'),
    )


def _residuals(result: CalibrationResult) -> str:
    figures = []
    for side in ('left', 'right'):
        image, factor = charts.residual_vectors(result, side)
        figures.append(
            figure(image, f'{side.capitalize()} image, {plain(factor)} times enlarged.')
        )
    return section(
        'Residuals after adjustment',
        'Arrows in all directions are noise; a pattern would be distortion that the model lacks.',
        *figures,
    )


def _next_boards(result: CalibrationResult) -> str:
    if not result.advice:
        return ''
    items = ''.join(f'<li>{escape(str(advice))}</li>' for advice in result.advice)
    return section(
        'What to capture next',
        'Of all places in view, boards here would lower the depth sigma most; each one assumes'
        ' that those before it have been captured.',
        f'<ol class="advice">{items}</ol>',
    )


def _images(images: Sequence[BoardImage]) -> str:
    if not images:
        return ''
    figures = []
    for name, jpeg, reason in images:
        text = f'Board {escape(name)}' + (f' was left out: {escape(reason)}' if reason else '')
        image = embedded_image(jpeg, 'jpeg', f'Board {escape(name)}')
        figures.append(figure(image, f'{text}.', kind='left-out' if reason else ''))
    return section(
        'Images',
        'Left and right image of each board. Green: marks that were used; red: marks that were'
        ' found and left out.',
        f'<div class="images">{"".join(figures)}</div>',
    )


def _working_depth(result: CalibrationResult) -> float:
    """Return a round distance near the far end of the boards, m."""
    return float(f'{np.quantile(result.marks_m[..., 2], 0.9):.2g}')


def _change(value: float, reference: float) -> str:
    return f'{round(100 * (value / reference - 1)):+d} %'
