# SPDX-License-Identifier: Apache-2.0
"""The estimated parameters of a calibration as tables of its report."""

from __future__ import annotations

from html import escape

from binocular_recon.calibration.result import CalibrationResult
from binocular_recon.drawing.page import section, table
from binocular_recon.number_text import significant


def parameters(result: CalibrationResult) -> str:
    """Return both cameras, their pose and the distortion models that were compared."""
    calibration, sigma = result.calibration, result.sigma
    K = {'left': result.rig.left.K, 'right': result.rig.right.K}
    D = {'left': calibration.D_left, 'right': calibration.D_right}
    rows = []
    for name, place in (('fx', (0, 0)), ('fy', (1, 1)), ('cx', (0, 2)), ('cy', (1, 2))):
        values = (f'{K[s][place]:.3f} ± {significant(sigma[f"{name}_{s}_px"], 2)} px' for s in K)
        rows.append((name, *values))
    for i, name in enumerate(calibration.lens_model.COEFFICIENTS):
        if f'{name}_left' in sigma:
            values = (f'{D[s][i]:.6f} ± {significant(sigma[f"{name}_{s}"], 1)}' for s in D)
            rows.append((name, *values))
    pose = [
        (
            f'T {axis}',
            f'{1e3 * calibration.T[i]:.3f} ± {significant(1e3 * sigma[f"T_{axis}_m"], 2)} mm',
        )
        for i, axis in enumerate('xyz')
    ]
    halves, found = result.halves, result.estimate
    apart = [
        (
            words,
            f'{significant(one.depth_m, 3)} m',
            f'{significant(1e3 * one.found_m, 3)} mm',
            f'{significant(1e3 * one.stated_m, 3)} mm',
        )
        for words, comparison in (('by lot', halves.by_lot), ('in order', halves.in_order))
        if comparison
        for one in comparison.differences
    ]
    bent = [
        (f'along {axis}', f'{1e3 * warp:+.3f} ± {significant(1e3 * one_sigma, 2)} mm')
        for axis, warp, one_sigma in zip(
            'xy', found.state.warp_m, found.warp_sigma_m, strict=False
        )
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
    return section(
        'Estimated parameters',
        'Values with one standard deviation. Distortion models are compared by the Bayesian'
        f' information criterion (lower is better); a larger model than'
        f' {calibration.lens_model.default_model} is chosen only on strong evidence.'
        f' {_sentence(str(halves))}',
        table(('', 'left', 'right'), rows),
        table(('pose', 'right from left'), pose),
        table(('warp of the board', 'its middle stands out'), bent) if bent else '',
        table(('halves', 'distance', 'differ by', 'expected'), apart) if apart else '',
        table(('distortion model', 'parameters', 'misfit (chi²)', 'BIC'), evidence),
    )


def _sentence(words: str) -> str:
    return f'{words[0].upper()}{words[1:]}.'
