# SPDX-License-Identifier: Apache-2.0
"""Tables of where errors come from, and of measured and filled pixels, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from binocular_recon.evaluation.accuracy.error_classes import CLASSES
from binocular_recon.evaluation.accuracy.parts import FLYING_PX, SIGMAS, Part
from binocular_recon.evaluation.accuracy.scoring import SceneScores
from binocular_recon.evaluation.tables import markdown_table
from binocular_recon.number_text import fixed


def part_table(scenes: Sequence[SceneScores]) -> str:
    """Return each method's pixels, measured and filled apart, a mean over scenes.

    Shares of pixels are of those with ground truth; the last columns are the shares of the errors
    within multiples of sigma.
    """
    header = ['mean over scenes', 'pixels', 'pixels %', 'bad-1.0 %', 'bad-2.0 %', 'mean error px']
    header += [f'flying (> {FLYING_PX:g} px) %', *(f'within {k} sigma %' for k in SIGMAS)]
    rows = []
    for i, score in enumerate(scenes[0].scores):
        finished = [scene.scores[i].parts for scene in scenes]
        finished = [parts for parts in finished if parts['all'].accuracy.pixels]
        for name in dict.fromkeys(name for parts in finished for name in parts):
            figures = [_figures(parts[name], parts['all']) for parts in finished if name in parts]
            rows.append([score.method, name, *map(_mean, zip(*figures, strict=True), _DECIMALS)])
    return markdown_table(header, rows) if rows else ''


_DECIMALS = (1, 1, 1, 2, 2, *(1 for _ in SIGMAS))


def _figures(part: Part, whole: Part) -> tuple[float, ...]:
    """Return the columns of a part on one scene."""
    accuracy = part.accuracy
    return (
        100.0 * accuracy.pixels / whole.accuracy.pixels,
        *accuracy.bad_percent[:2],
        accuracy.measured_error_px,
        part.flying_percent,
        *part.within_percent,
    )


def _mean(values: Sequence[float], decimals: int) -> str:
    """Return the mean over the scenes that have a figure."""
    known = [value for value in values if np.isfinite(value)]
    return fixed(float(np.mean(known)) if known else None, decimals)


def class_table(scenes: Sequence[SceneScores]) -> str:
    """Return each method's bad-2.0 by what makes the pixels hard, a mean over scenes.

    The classes of a row add up to its bad-2.0; the first row is their share of the pixels. Empty
    if no scene knows what both cameras see.
    """
    rows: list[list[str]] = []
    for i, score in enumerate(scenes[0].scores):
        known = [scene.scores[i].classes for scene in scenes if scene.scores[i].classes]
        if not known:
            continue
        if not rows:
            shares = np.mean([[one.pixels_percent for one in found] for found in known], axis=0)
            rows.append(['all pixels %', *(fixed(float(x)) for x in shares), ''])
        points = np.mean([[one.bad_points for one in found] for found in known], axis=0)
        rows.append([score.method, *(fixed(float(x), 2) for x in (*points, points.sum()))])
    header = ['bad-2.0 by class, points', *CLASSES, 'sum']
    return markdown_table(header, rows) if rows else ''
