# SPDX-License-Identifier: Apache-2.0
"""The calibration report: one HTML file with its pictures inside, nothing from the network."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from string import Template

import numpy as np

from binocular_recon import __version__
from binocular_recon.calibration import _report_charts as charts
from binocular_recon.calibration._report_charts import METHODS
from binocular_recon.calibration.mark_errors import mark_errors_m
from binocular_recon.calibration.result import (
    DISPARITY_SIGMA_PX,
    CalibrationResult,
    row_statistics,
)

_UNCORRECTED = '#c8553d'
# Distances listed in the table of depth sigmas.
_DEPTH_ROWS = 6
# Fields of a picture whose coverage is counted.
_FIELDS = 8, 5


def render_report(result: CalibrationResult) -> str:
    """Return the report as an HTML page."""
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
        _numbers(result),
    )
    return _PAGE.substitute(
        style=_STYLE, sections='\n'.join(sections), version=escape(__version__)
    )


def _summary(result: CalibrationResult) -> str:
    calibration, sigma = result.calibration, result.sigma
    depth = _working_depth(result)
    marks = int(np.isfinite(result.adjusted.residuals_px).sum()) // 2
    width, height = calibration.image_size
    noise = float(np.sqrt(np.mean(result.mark_sigma_px**2)))
    cards = (
        (f'{1e3 * result.depth_sigma_m(depth):.3g} mm', f'depth sigma at {depth:g} m'),
        (
            f'{1e3 * calibration.baseline_m:.2f} mm',
            f'baseline, ± {1e3 * sigma["baseline_m"]:.2g} mm',
        ),
        (
            f'{calibration.K_left[0, 0]:.0f} / {calibration.K_right[0, 0]:.0f} px',
            f'focal length left / right, ± {sigma["fx_left_px"]:.2g} px',
        ),
        (f'{result.adjusted.error_px:.3f} px', f'reprojection error; marks scatter {noise:.3f}'),
        (f'{len(result.names)}', f'boards used, {marks} marks, {width}x{height} px'),
    )
    items = ''.join(f'<li><b>{value}</b><span>{label}</span></li>' for value, label in cards)
    return f'<ul class="cards">{items}</ul>'


def _notes(result: CalibrationResult) -> str:
    notes = [escape(warning) for warning in result.warnings]
    notes += [
        f'Board <b>{escape(board.name)}</b> was left out: {escape(board.reason)}.'
        for board in result.rejected
    ]
    if count := int(result.estimate.outliers.sum()):
        notes.append(f'{count} single marks were left out, beyond what their noise allows.')
    if not notes:
        return '<p class="good">Every board and every mark was used.</p>'
    return f'<ul class="notes">{"".join(f"<li>{note}</li>" for note in notes)}</ul>'


def _depth(result: CalibrationResult) -> str:
    depth = _working_depth(result)
    picture, low, high = charts.depth_sigma_map(result, depth)
    rows = []
    for z in np.linspace(0.5, 1.5, _DEPTH_ROWS) * depth:
        sigmas = (1e3 * result.depth_sigma_m(z, noise) for noise in (0.0, DISPARITY_SIGMA_PX))
        rows.append((f'{z:.3g} m', *(f'{sigma:.3g} mm' for sigma in sigmas)))
    return _section(
        'How well depth will be known',
        f'One standard deviation over the middle half of the pictures, from the covariance of the'
        f' calibration and {DISPARITY_SIGMA_PX:g} px of disparity noise.',
        _figure(
            charts.depth_sigma(result),
            _legend(
                ('total', METHODS['adjusted']),
                ('calibration alone', METHODS['planar']),
                ('disparity noise alone', METHODS['corrected']),
            ),
        ),
        _figure(
            picture,
            f"The calibration's own share at {depth:g} m over the left picture:"
            f' {1e3 * low:.3g} mm (light) to {1e3 * high:.3g} mm (dark).',
        ),
        _table(('distance', 'calibration alone', 'with disparity noise'), rows),
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
    return _section(
        'Three methods on the same marks: reprojection error',
        'Planar: every rod taken as exactly placed (Zhang). Corrected: calibrated again after'
        ' polar-line correction. Adjusted: both cameras and every rod estimated together; this is'
        ' the calibration that was saved. Root mean square per image axis in the original'
        ' pictures, so that a perfect calibration shows the noise of the marks.',
        _figure(charts.board_errors(result), _legend(*METHODS.items()), wide=True),
        _table(
            ('board', 'planar, px', 'corrected, px', 'adjusted, px', 'adjusted - planar'),
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
    return _section(
        'Rows of the two pictures',
        'A mark must appear in the same row of both rectified pictures. What remains here is'
        ' mostly the noise of the marks themselves.',
        _figure(
            charts.row_differences(result),
            _legend(
                ('uncorrected', _UNCORRECTED),
                ('corrected', METHODS['corrected']),
                ('adjusted', METHODS['adjusted']),
            ),
        ),
        _table(('row difference', 'mean, px', 'largest, px'), rows),
    )


def _heights(result: CalibrationResult) -> str:
    target = result.estimate.problem.target
    rows = []
    for name in METHODS:
        errors = 1e3 * mark_errors_m(getattr(result, name).marks_m, target)
        errors = errors[np.isfinite(errors)]
        rows.append((name, f'{np.sqrt(np.mean(errors**2)):.2f}', f'{np.abs(errors).max():.2f}'))
    what = (
        'Marks reconstructed from both pictures, laid over the known heights of their rod'
        if target.has_rods
        else 'Points reconstructed from both pictures, laid over the known target'
    )
    return _section(
        'Reconstructed marks against what is known',
        f'{what}. The plan shows where the boards stood and what both cameras see.',
        _figure(charts.plan(result), 'Boards from above.'),
        _figure(charts.known_heights(result), _legend(*METHODS.items())),
        _table(('method', 'root mean square, mm', 'largest, mm'), rows),
    )


def _coverage(result: CalibrationResult) -> str:
    depth = result.marks_m[..., 2]
    figures = []
    for side in ('left', 'right'):
        share = 100 * _covered(result, side)
        figures.append(
            _figure(
                charts.coverage(result, side),
                f'{side.capitalize()} picture: marks in {share:.0f} % of its fields; dark = far.',
            )
        )
    return _section(
        'Coverage',
        f'Distortion and depth are known where marks were seen: {depth.min():.3g} to'
        f' {depth.max():.3g} m.',
        *figures,
    )


def _residuals(result: CalibrationResult) -> str:
    figures = []
    for side in ('left', 'right'):
        picture, factor = charts.residual_vectors(result, side)
        figures.append(
            _figure(picture, f'{side.capitalize()} picture, {factor:g} times enlarged.')
        )
    return _section(
        'Residuals after adjustment',
        'Arrows in all directions are noise; a pattern would mean distortion that the model does'
        ' not have.',
        *figures,
    )


def _next_boards(result: CalibrationResult) -> str:
    if not result.advice:
        return ''
    items = ''.join(f'<li>{escape(str(advice))}</li>' for advice in result.advice)
    return _section(
        'What to capture next',
        'Of all places in view, these boards would lower the depth sigma most, each given those'
        ' before it.',
        f'<ol class="advice">{items}</ol>',
    )


def _numbers(result: CalibrationResult) -> str:
    calibration, sigma = result.calibration, result.sigma
    K = {'left': calibration.K_left, 'right': calibration.K_right}
    D = {'left': calibration.D_left, 'right': calibration.D_right}
    rows = []
    for name, place in (('fx', (0, 0)), ('fy', (1, 1)), ('cx', (0, 2)), ('cy', (1, 2))):
        values = (f'{K[s][place]:.3f} ± {sigma[f"{name}_{s}_px"]:.2g} px' for s in K)
        rows.append((name, *values))
    for i, name in enumerate(('k1', 'k2', 'p1', 'p2', 'k3', 'k4', 'k5', 'k6')):
        if f'{name}_left' in sigma:
            values = (f'{D[s][i]:.6f} ± {sigma[f"{name}_{s}"]:.1g}' for s in D)
            rows.append((name, *values))
    pose = [
        (f'T {axis}', f'{1e3 * calibration.T[i]:.3f} ± {1e3 * sigma[f"T_{axis}_m"]:.2g} mm')
        for i, axis in enumerate('xyz')
    ]
    evidence = [
        (
            f'<b>{escape(e.model)}</b>' if e.model == result.model else escape(e.model),
            f'{e.parameters}',
            f'{e.chi2:.0f}',
            f'{e.bic:+.0f}',
        )
        for e in result.evidence
    ]
    return _section(
        'Numbers',
        'Values with one standard deviation. Distortion models are compared by the Bayesian'
        ' information criterion (lower is better); a larger model than k1 k2 p1 p2 is taken only'
        ' on strong evidence.',
        _table(('', 'left', 'right'), rows),
        _table(('pose', 'right from left'), pose),
        _table(('distortion model', 'parameters', 'misfit (chi²)', 'BIC'), evidence),
    )


def _covered(result: CalibrationResult, side: str) -> float:
    """Return the share of the fields of a picture that hold a mark."""
    uv = slice(0, 2) if side == 'left' else slice(2, 4)
    pixels = result.estimate.problem.observed_px[..., uv].reshape(-1, 2)
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    width, height = result.calibration.image_size
    columns, rows = (pixels / [width / _FIELDS[0], height / _FIELDS[1]]).astype(int).T
    return len(set(zip(columns, rows, strict=True))) / (_FIELDS[0] * _FIELDS[1])


def _working_depth(result: CalibrationResult) -> float:
    """Return a round distance near the far end of the boards, m."""
    return float(f'{np.quantile(result.marks_m[..., 2], 0.9):.2g}')


def _change(value: float, reference: float) -> str:
    return f'{round(100 * (value / reference - 1)):+d} %'


def _section(title: str, words: str, *content: str) -> str:
    return (
        f'<section><h2>{title}</h2><p>{words}</p><div class="content">{"".join(content)}</div>'
        '</section>'
    )


def _figure(picture: str, caption: str, *, wide: bool = False) -> str:
    kind = ' class="wide"' if wide else ''
    return f'<figure{kind}>{picture}<figcaption>{caption}</figcaption></figure>'


def _legend(*entries: tuple[str, str]) -> str:
    return ' '.join(
        f'<span class="key"><i style="background:{color}"></i>{escape(name)}</span>'
        for name, color in entries
    )


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], *, kind: str = '') -> str:
    top = ''.join(f'<th>{escape(name)}</th>' for name in head)
    body = ''.join('<tr>' + ''.join(f'<td>{cell}</td>' for cell in row) + '</tr>' for row in rows)
    return f'<table class="{kind}"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>'


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Stereo calibration</title>
<style>$style</style>
</head>
<body>
<header><h1>Stereo calibration</h1></header>
<main>
$sections
</main>
<footer>binocular_recon $version. Uncertainties are one standard deviation.</footer>
</body>
</html>
""")

_STYLE = """
:root { color: #22313f; font: 16px/1.5 system-ui, 'Segoe UI', Helvetica, Arial, sans-serif; }
body { margin: 0; background: #f3f5f7; }
header { background: #0a3d4a; color: white; padding: 1.6rem max(1rem, calc(50% - 31rem)); }
h1 { margin: 0; font-weight: 600; font-size: 1.7rem; }
main, footer { max-width: 64rem; margin: 0 auto; padding: 1rem; }
footer { color: #71808f; font-size: .85rem; }
section, .notes, .good { background: white; border-radius: 6px; padding: 1.2rem 1.5rem;
  margin: 1.2rem 0; box-shadow: 0 1px 2px #0002; }
.notes { border-left: 5px solid #e0a13a; padding-left: 2.4rem; }
.good { border-left: 5px solid #0b7a75; }
h2 { margin: 0 0 .3rem; font-size: 1.2rem; }
section > p { margin: 0 0 1rem; color: #4a5a68; max-width: 48rem; }
.cards { list-style: none; display: grid; gap: .8rem;
  grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); padding: 0; margin: 1.2rem 0; }
.cards li { background: white; border-radius: 6px; padding: .9rem 1.1rem;
  border-top: 4px solid #0b7a75; box-shadow: 0 1px 2px #0002; }
.cards b { display: block; font-size: 1.35rem; font-weight: 600; white-space: nowrap; }
.cards span { color: #71808f; font-size: .85rem; line-height: 1.3; display: block; }
.content { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(27rem, 100%), 1fr));
  gap: 1.2rem 1.5rem; align-items: start; }
figure { margin: 0; }
.wide { grid-column: 1 / -1; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { font-size: .85rem; color: #4a5a68; margin-top: .3rem; }
.key { margin-right: 1rem; white-space: nowrap; }
.key i { display: inline-block; width: .8em; height: .8em; border-radius: 2px;
  margin-right: .35em; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums;
  width: 100%; }
th { text-align: right; font-weight: 600; border-bottom: 2px solid #22313f;
  padding: .25rem .6rem; }
td { text-align: right; border-bottom: 1px solid #e4e9ee; padding: .22rem .6rem; }
th:first-child, td:first-child { text-align: left; }
.total tbody tr:last-child td { font-weight: 600; border-top: 2px solid #22313f; }
.advice { grid-column: 1 / -1; margin: 0; padding-left: 1.3rem; }
@media print { body { background: white; } section { break-inside: avoid; box-shadow: none; } }
"""
